"""Masks from a few words: GroundingDINO finds boxes, SAM cuts out what stands in them.

What the paper calls Lang SAM (its mask prompt T_m).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F

from diga3d_warp.checkpoints import (
    Checkpoint,
    best_device,
    load_model,
    load_tokenizer,
    locate,
    require_diffusion,
)
from diga3d_warp.errors import InputError

DETECTOR = Checkpoint("IDEA-Research/grounding-dino-tiny", 0.7)
CUTTER = Checkpoint("facebook/sam-vit-base", 0.4)

MEAN = (0.485, 0.456, 0.406)
STD = (0.229, 0.224, 0.225)
"""Mean and standard deviation of ImageNet, with which both models were trained."""


@dataclass(frozen=True)
class SegmentationSettings:
    """Thresholds of a detection.

    Attributes:
        score_min: Least score of a box [1]. GroundingDINO's demo: 0.35; Lang SAM: 0.3.
        short: Short side of what the detector is given [px] (GroundingDINO).
        long: Longest side of what the detector is given [px] (GroundingDINO).
    """

    score_min: float = 0.3
    short: int = 800
    long: int = 1333


@dataclass(frozen=True, eq=False)
class Boxes:
    """Detections of an image.

    Attributes:
        corners: x0, y0, x1, y1, shape (N, 4) [px].
        scores: Falling, shape (N,).
    """

    corners: torch.Tensor
    scores: torch.Tensor


def mask_words(prompt: str) -> str:
    """A prompt as the detector reads it, but for the full stop at its end.

    Raises:
        InputError: it is empty.
    """
    words = prompt.strip().lower().rstrip(" .")
    if not words:
        raise InputError("the mask prompt is empty: say what to mask, such as 'a watering can'")
    return words


def locate_models(models: Path | None) -> tuple[Path, Path]:
    """Folders of detector and cutter.

    Args:
        models: Holds both, as `detector` and `cutter`; None for the Hugging Face cache.

    Raises:
        InputError: one is missing.
    """
    if models is None:
        return locate(DETECTOR), locate(CUTTER)
    return locate(DETECTOR, models / "detector"), locate(CUTTER, models / "cutter")


class TextSegmenter:
    """GroundingDINO and SAM.

    Args:
        detector: `transformers.GroundingDinoForObjectDetection`.
        tokenizer: Of the detector's text model.
        cutter: `transformers.SamModel`.
        settings: Thresholds of a detection.
    """

    def __init__(
        self, detector: Any, tokenizer: Any, cutter: Any, settings: SegmentationSettings | None = None
    ) -> None:
        self.detector = detector
        self.tokenizer = tokenizer
        self.cutter = cutter
        self.settings = settings or SegmentationSettings()

    @staticmethod
    def load(
        detector: str | Path | None = None,
        cutter: str | Path | None = None,
        device: str = "auto",
        settings: SegmentationSettings | None = None,
    ) -> TextSegmenter:
        """Both models, from folders or from the Hugging Face cache.

        Raises:
            InputError: the weights or the libraries are missing, or broken.
        """
        require_diffusion()
        device = best_device(device)
        from transformers import AutoTokenizer, GroundingDinoForObjectDetection, SamModel

        folder = locate(DETECTOR, detector)
        found = load_model(GroundingDinoForObjectDetection, folder).to(device)
        tokenizer = load_tokenizer(AutoTokenizer, folder)
        cut = load_model(SamModel, locate(CUTTER, cutter)).to(device)
        return TextSegmenter(found, tokenizer, cut, settings)

    @torch.no_grad()
    def boxes(self, image: torch.Tensor, prompt: str) -> Boxes:
        """Detect the objects of a prompt.

        Args:
            image: RGB in [0, 1], shape (H, W, 3).
            prompt: Names of objects; several are separated by full stops.

        Raises:
            InputError: the prompt is empty or too long.
        """
        words = mask_words(prompt)
        text = self.tokenizer(words + ".", return_tensors="pt").to(self.detector.device)
        most = int(self.detector.config.max_text_len)
        if text.input_ids.shape[1] > most:
            raise InputError(
                f"the mask prompt {words[:40]!r}... has {text.input_ids.shape[1]} tokens, "
                f"the detector reads {most}: shorten it"
            )
        height, width = image.shape[:2]
        scale = min(self.settings.short / min(height, width), self.settings.long / max(height, width))
        pixels = _normalised(image, (round(height * scale), round(width * scale)))
        output = self.detector(
            pixel_values=pixels.to(self.detector.device),
            input_ids=text.input_ids,
            attention_mask=text.attention_mask,
            token_type_ids=torch.zeros_like(text.input_ids),
        )
        scores = output.logits[0].sigmoid().amax(-1)
        order = scores.argsort(descending=True)
        order = order[scores[order] > self.settings.score_min]
        centre, extent = output.pred_boxes[0, order].split(2, -1)
        corners = torch.cat([centre - extent / 2, centre + extent / 2], -1).clamp(0.0, 1.0)
        size = corners.new_tensor([width, height, width, height])
        return Boxes((corners * size).cpu(), scores[order].cpu())

    @torch.no_grad()
    def cut_out(self, image: torch.Tensor, corners: torch.Tensor) -> torch.Tensor:
        """Segment the objects in boxes.

        Args:
            image: RGB in [0, 1], shape (H, W, 3).
            corners: Boxes x0, y0, x1, y1, shape (N, 4) [px].

        Returns:
            The union of their masks, shape (H, W), bool, on the host; empty without boxes.
        """
        height, width = image.shape[:2]
        if not len(corners):
            return torch.zeros(height, width, dtype=torch.bool)
        side = int(self.cutter.config.vision_config.image_size)
        scale = side / max(height, width)
        tall, wide = int(height * scale + 0.5), int(width * scale + 0.5)
        pixels = F.pad(_normalised(image, (tall, wide)), (0, side - wide, 0, side - tall))
        stretch = corners.new_tensor([wide / width, tall / height] * 2)
        output = self.cutter(
            pixel_values=pixels.to(self.cutter.device),
            input_boxes=(corners * stretch)[None].to(self.cutter.device),
            multimask_output=False,
        )
        logits = F.interpolate(output.pred_masks[0].float(), (side, side), mode="bilinear")[..., :tall, :wide]
        return (F.interpolate(logits, (height, width), mode="bilinear") > 0.0).any(1).any(0).cpu()

    def mask(self, image: torch.Tensor, prompt: str) -> torch.Tensor:
        """Mask of the objects of a prompt, shape (H, W), bool, on the host; empty without a detection.

        Raises:
            InputError: the prompt is empty or too long.
        """
        return self.cut_out(image, self.boxes(image, prompt).corners)


def _normalised(image: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    """Image (H, W, 3) as both models take it, shape (1, 3, height, width)."""
    pixels = F.interpolate(image.permute(2, 0, 1)[None], size, mode="bilinear", antialias=True)
    mean, std = (torch.tensor(part).view(1, 3, 1, 1).to(pixels) for part in (MEAN, STD))
    return (pixels - mean) / std
