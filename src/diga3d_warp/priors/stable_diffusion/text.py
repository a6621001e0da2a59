"""Prompts as CLIP text embeddings."""

from __future__ import annotations

from typing import Any

import torch

from diga3d_warp.errors import InputError
from diga3d_warp.priors.conditioning import Prompts
from diga3d_warp.priors.protocol import Task


class TextEncoder:
    """CLIP's tokenizer and text model.

    Args:
        tokenizer: `transformers.CLIPTokenizer`.
        model: `transformers.CLIPTextModel`.
    """

    def __init__(self, tokenizer: Any, model: Any) -> None:
        self.tokenizer = tokenizer
        self.model = model

    @torch.no_grad()
    def encode(self, prompt: str) -> torch.Tensor:
        """Embeddings of all tokens, shape (1, tokens, width), float32.

        Raises:
            InputError: more tokens than the model reads. Cut off silently, the prompt's end would be ignored.
        """
        most = self.tokenizer.model_max_length
        count = len(self.tokenizer(prompt).input_ids)
        if count > most:
            raise InputError(
                f"the prompt {prompt[:40]!r}... has {count} tokens, the model reads {most}: shorten it"
            )
        ids = self.tokenizer(prompt, padding="max_length", max_length=most, return_tensors="pt").input_ids
        return self.model(ids.to(self.model.device))[0].float()


def plain_prompts(encoder: TextEncoder, positive: str, negative: str, task: Task) -> Prompts:
    """Both prompts as they are; the task does not matter."""
    return Prompts(encoder.encode(positive), encoder.encode(negative))
