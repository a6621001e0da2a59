"""Monocular depth, aligned to the scene (paper Sec. 3.5), and depth as a ControlNet takes it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F

from diga3d_warp.checkpoints import Checkpoint, check_model, load_model, locate, require_diffusion
from diga3d_warp.errors import InputError
from diga3d_warp.perception.resampling import resize_images

DPT = Checkpoint("Intel/dpt-large", 1.4)

VALID_MIN = 16
"""Least number of pixels that scale and shift are fitted to."""


@dataclass(frozen=True)
class Alignment:
    """Scale and shift from estimated to true inverse depth.

    Attributes:
        scale: [1 / scene unit]
        shift: [1 / scene unit]
        farthest: Largest true depth that the fit saw [scene units].
    """

    scale: float
    shift: float
    farthest: float

    def depth(self, disparity: torch.Tensor) -> torch.Tensor:
        """Depth of estimated disparity, shape (H, W) [scene units].

        What the alignment would put at or behind infinity is given twice the farthest depth that was seen.
        """
        inverse = disparity * self.scale + self.shift
        return 1.0 / inverse.clamp(min=0.5 / self.farthest)


def align_disparity(disparity: torch.Tensor, depth: torch.Tensor, valid: torch.Tensor) -> Alignment:
    """Closed-form least squares for scale and shift, in inverse depth.

    Monocular estimators such as DPT give inverse depth up to scale and shift; in depth itself no scale and
    shift would fit.

    Args:
        disparity: Estimate, shape (H, W), larger is nearer.
        depth: z along the camera axis, rendered from the splat, shape (H, W) [scene units].
        valid: Where the rendered depth can be trusted: outside the masks, shape (H, W), bool. Pixels without
            finite positive depth are left out as well.

    Raises:
        InputError: too few valid pixels, or an estimate that says nothing of their depth.
    """
    valid = valid & depth.isfinite() & (depth > 0.0) & disparity.isfinite()
    if int(valid.sum()) < VALID_MIN:
        raise InputError("fewer than 16 pixels outside the mask have depth: give a smaller mask")
    x, true = disparity[valid].double(), depth[valid].double()
    y = 1.0 / true
    centred = x - x.mean()
    variance = centred.square().mean()
    scale = float((centred * (y - y.mean())).mean() / variance) if variance > 0.0 else 0.0
    if scale <= 0.0:
        raise InputError("the estimated depth contradicts the rendered depth: check cameras and depth model")
    return Alignment(scale, float(y.mean() - scale * x.mean()), float(true.max()))


def depth_control(
    depth: torch.Tensor, valid: torch.Tensor | None = None, size: Sequence[int] | None = None
) -> torch.Tensor:
    """Depth as ControlNet was trained on it: inverse, from 0 (farthest) to 1 (nearest).

    Args:
        depth: Of all that the network is shown, no more: what lies outside must not take part of the range.
            Shape (H, W) [scene units].
        valid: False where a warped depth map has a hole, shape (H, W), bool. Holes become 0.
        size: Height and width of the result [px]; those of the depth if None.

    Returns:
        Shape (*size), float32 in [0, 1]; zeros if all depths are the same.
    """
    usable = depth.isfinite() & (depth > 0.0)
    if valid is not None:
        usable &= valid
    inverse = torch.where(usable, 1.0 / torch.where(usable, depth, 1.0), 0.0)
    if size is not None:
        # Means over the known part of each pixel: a hole is no depth, and must not blend in as far away.
        sums, share = resize_images(torch.stack([inverse, usable.to(inverse)], -1)[None], size)[0].unbind(-1)
        usable = share > 0.5
        inverse = torch.where(usable, sums / share.clamp(min=0.5), 0.0)
    if not bool(usable.any()):
        return torch.zeros_like(inverse)
    nearest, farthest = inverse[usable].max(), inverse[usable].min()
    spread = (inverse - farthest) / (nearest - farthest).clamp(min=1e-12)
    return torch.where(usable, spread, 0.0).clamp(0.0, 1.0)


class DepthEstimator:
    """DPT (Ranftl et al. 2021), which the paper uses, through transformers; read when it is first asked.

    Args:
        folder: Of a `transformers.DPTForDepthEstimation`.
        device: As torch names it.
    """

    def __init__(self, folder: Path, device: str = "cpu") -> None:
        self.folder = folder
        self.device = device

    @cached_property
    def model(self) -> Any:
        """The network, on its device.

        Raises:
            InputError: its weights are incomplete or do not fit.
        """
        from transformers import DPTForDepthEstimation

        return load_model(DPTForDepthEstimation, self.folder).to(self.device)

    @staticmethod
    def load(folder: str | Path | None = None, device: str = "cpu") -> DepthEstimator:
        """DPT-Large from the Hugging Face cache, or any DPT from a folder.

        Raises:
            InputError: the weights or the libraries are missing, or broken.
        """
        require_diffusion()
        found = locate(DPT, folder)
        check_model(found)
        return DepthEstimator(found, device)

    @staticmethod
    def if_downloaded() -> DepthEstimator | None:
        """DPT-Large, or None where the Hugging Face cache does not hold it, or the libraries are missing.

        Raises:
            InputError: the weights are broken.
        """
        try:
            require_diffusion()
            locate(DPT)
        except InputError:
            return None
        return DepthEstimator.load()

    @torch.no_grad()
    def disparity(self, image: torch.Tensor) -> torch.Tensor:
        """Inverse depth up to scale and shift, larger is nearer.

        Args:
            image: RGB in [0, 1], shape (H, W, 3).

        Returns:
            Shape (H, W), float32, on the image's device.
        """
        # transformers' DPT takes squares only, and its own processor stretches images to one
        square = 2 * (int(self.model.config.image_size),)
        pixels = F.interpolate(image.permute(2, 0, 1)[None], square, mode="bicubic", antialias=True)
        estimate = self.model((pixels.clamp(0.0, 1.0) * 2.0 - 1.0).to(self.model.device)).predicted_depth
        whole = F.interpolate(estimate[:, None], image.shape[:2], mode="bicubic", align_corners=False)
        return whole[0, 0].to(image.device)

    def aligned(self, image: torch.Tensor, depth: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
        """z of an image, aligned to known depth around what is estimated (paper Sec. 3.5).

        Args:
            image: RGB in [0, 1], shape (H, W, 3).
            depth, valid: As in `align_disparity`.

        Returns:
            Shape (H, W) [scene units], positive.

        Raises:
            InputError: see `align_disparity`.
        """
        disparity = self.disparity(image)
        return align_disparity(disparity, depth, valid).depth(disparity)
