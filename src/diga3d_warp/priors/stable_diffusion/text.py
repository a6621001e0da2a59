"""Prompts as CLIP text embeddings."""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import Any

import torch

from diga3d_warp.errors import InputError
from diga3d_warp.priors.conditioning import Prompts
from diga3d_warp.priors.protocol import Task

WORDS = "words.json"
"""File beside the tokenizer of a model that was trained on few words: the list of them."""


class TextEncoder:
    """CLIP's tokenizer and text model.

    Args:
        tokenizer: `transformers.CLIPTokenizer`.
        model: `transformers.CLIPTextModel`.
        words: All that the model was trained on, if they are few; None for a model that knows any text.
    """

    def __init__(self, tokenizer: Any, model: Any, words: Collection[str] | None = None) -> None:
        self.tokenizer = tokenizer
        self.model = model
        self.words = words

    @torch.no_grad()
    def encode(self, prompt: str) -> torch.Tensor:
        """Embeddings of all tokens, shape (1, tokens, width), float32.

        Raises:
            InputError: words that the model never saw, which it would read as anything; or more tokens than
                it reads. Cut off silently, the prompt's end would be ignored.
        """
        self._check_words(prompt)
        most = self.tokenizer.model_max_length
        count = len(self.tokenizer(prompt).input_ids)
        if count > most:
            raise InputError(
                f"the prompt {prompt[:40]!r}... has {count} tokens, the model reads {most}: shorten it"
            )
        ids = self.tokenizer(prompt, padding="max_length", max_length=most, return_tensors="pt").input_ids
        return self.model(ids.to(self.model.device))[0].float()

    def _check_words(self, prompt: str) -> None:
        if self.words is None:
            return
        unknown = [w for w in re.findall(r"[^\W\d_]+|\d+", prompt.lower()) if w not in self.words]
        if unknown:
            listed = ", ".join(repr(word) for word in dict.fromkeys(unknown))
            raise InputError(
                f"the prior was never taught {listed}: use its words only, {' '.join(sorted(self.words))}"
            )


def plain_prompts(encoder: TextEncoder, positive: str, negative: str, task: Task) -> Prompts:
    """Both prompts as they are; the task does not matter."""
    return Prompts(encoder.encode(positive), encoder.encode(negative))
