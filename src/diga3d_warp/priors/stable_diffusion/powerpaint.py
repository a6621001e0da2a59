"""PowerPaint's task prompts (Zhuang et al. 2023, "A task is worth one word", version 1).

The loop is that of any inpainting UNet. What differs are learned words at the prompt's end that say what the
hole shall hold: context, an object, or an object in the shape of the mask.
"""

from __future__ import annotations

from typing import Any

from diga3d_warp.errors import InputError
from diga3d_warp.priors.conditioning import Prompts
from diga3d_warp.priors.protocol import Task
from diga3d_warp.priors.stable_diffusion.text import TextEncoder

TASK_WORDS = ("P_ctxt", "P_shape", "P_obj")
VECTORS = 10
"""Learned vectors of each task word; the tokenizer knows them as P_ctxt_0 to P_ctxt_9."""

SHAPE_FIT = 0.8
"""How closely a re-textured object fills its mask [1]. PowerPaint: 0.5 to 0.6 loosely, 0.8 to 0.95 tightly;
masks of objects that keep their shape are tight."""

QUALITY = "worst quality, low quality, normal quality, bad quality, blurry"
"""What PowerPaint's authors add to the negative prompt of all tasks but removal."""


def knows_task_words(tokenizer: Any) -> bool:
    """Whether a tokenizer has PowerPaint's words, which plain Stable Diffusion lacks."""
    return f"{TASK_WORDS[0]}_0" in tokenizer.get_vocab()


def task_prompts(encoder: TextEncoder, positive: str, negative: str, task: Task) -> Prompts:
    """Prompts with the words of a task.

    Removal asks for context and steers away from objects; replacement asks for an object; re-texturing asks
    for an object in the shape of the mask, mixed with context by `SHAPE_FIT`.

    Raises:
        InputError: the tokenizer does not know the words, or the prompt is too long.
    """
    if not knows_task_words(encoder.tokenizer):
        raise InputError(
            "the tokenizer does not know PowerPaint's task words (P_ctxt_0, ...): "
            "give a folder of Sanster/PowerPaint-V1-stable-diffusion-inpainting"
        )
    if task == "remove":
        return Prompts(
            _encode(encoder, "empty scene blur", positive, "P_ctxt"), _encode(encoder, negative, "P_obj")
        )
    against = f"{negative}, {QUALITY}" if negative else QUALITY
    if task == "replace":
        return Prompts(_encode(encoder, positive, "P_obj"), _encode(encoder, against, "P_obj"))
    shape, context = (
        [_encode(encoder, prompt, word) for prompt in (positive, against)] for word in ("P_shape", "P_ctxt")
    )
    halves = (SHAPE_FIT * s + (1.0 - SHAPE_FIT) * c for s, c in zip(shape, context, strict=True))
    return Prompts(*halves)


def _encode(encoder: TextEncoder, *parts: str) -> Any:
    """Embeddings of the parts joined by spaces, the task word at the end spelled out as its tokens."""
    *words, task_word = (part for part in parts if part)
    vectors = [f"{task_word}_{k}" for k in range(VECTORS)]
    return encoder.encode(" ".join([*words, *vectors]))
