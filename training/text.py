"""Tokenizer and text encoder in CLIP's format, for the few hundred words of the generator."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from diga3d_warp.priors.stable_diffusion.text import WORDS
from training.recipe import Recipe, TextRecipe


def build_tokenizer(words: Sequence[str], recipe: TextRecipe) -> Any:
    """`transformers.CLIPTokenizer` that knows each word as one token, and others by their letters."""
    from tokenizers import Tokenizer, models, pre_tokenizers, trainers
    from transformers import CLIPTokenizer

    pairs = Tokenizer(models.BPE(end_of_word_suffix="</w>"))
    pairs.pre_tokenizer = pre_tokenizers.Whitespace()
    # Pairs are merged until every word is one token; with letters alone and at the end, the merges of some
    # words would otherwise break others.
    trainer = trainers.BpeTrainer(
        vocab_size=20 * len(words) + 200,
        min_frequency=1,
        special_tokens=["<|startoftext|>", "<|endoftext|>"],
        initial_alphabet=list("abcdefghijklmnopqrstuvwxyz0123456789,.'-"),
        end_of_word_suffix="</w>",
        show_progress=False,
    )
    pairs.train_from_iterator(words, trainer)
    learned = json.loads(pairs.to_str())["model"]
    tokens: dict[str, int] = learned["vocab"]
    merges: Any = [tuple(pair) for pair in learned["merges"]]
    for letter in "abcdefghijklmnopqrstuvwxyz0123456789,.'-":
        tokens.setdefault(letter + "</w>", len(tokens))
    return CLIPTokenizer(vocab=tokens, merges=merges, model_max_length=recipe.tokens)


def save_tokenizer(tokenizer: Any, words: Sequence[str], folder: Path) -> None:
    """Write a tokenizer and the list of its words."""
    tokenizer.save_pretrained(folder)
    (folder / WORDS).write_text(json.dumps(list(words)))


def build_text_encoder(tokenizer: Any, recipe: TextRecipe) -> Any:
    """Untrained `transformers.CLIPTextModel`."""
    from transformers import CLIPTextConfig, CLIPTextModel

    config = CLIPTextConfig(
        vocab_size=len(tokenizer),
        hidden_size=recipe.width,
        intermediate_size=2 * recipe.width,
        num_hidden_layers=recipe.layers,
        num_attention_heads=4,
        max_position_embeddings=recipe.tokens,
        bos_token_id=tokenizer.bos_token_id,
        eos_token_id=tokenizer.eos_token_id,
        pad_token_id=tokenizer.pad_token_id,
    )
    model = CLIPTextModel(config)
    model.set_attn_implementation("eager")  # faster to train on a CPU than the fused one
    return model


def open_tokenizer(work: Path, recipe: Recipe) -> tuple[Any, list[str]]:
    """The tokenizer of a training with its words, made on first use.

    Reading all words takes a minute.
    """
    from training.captions import vocabulary

    path = work / WORDS
    if not path.exists():
        part = path.with_suffix(".part")
        part.write_text(json.dumps(vocabulary(recipe.data)))
        part.replace(path)
    words = json.loads(path.read_text())
    return build_tokenizer(words, recipe.text), words
