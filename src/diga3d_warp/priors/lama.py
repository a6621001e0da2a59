"""LaMa: inpainting of large masks by Fourier convolutions (Suvorov et al. 2022, arXiv 2109.07161), from ONNX.

It reconstructs rather than invents: the same surroundings give the same fill, so fills of neighbouring views
agree better than those of diffusion models (arXiv 2605.30987). The weights are the user's.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from diga3d_warp.checkpoints import Checkpoint, locate
from diga3d_warp.errors import InputError
from diga3d_warp.priors.protocol import check_fill
from diga3d_warp.priors.surroundings import separate, stretch

if TYPE_CHECKING:
    import onnxruntime

LAMA = Checkpoint("Carve/LaMa-ONNX", 0.2, ("lama_fp32.onnx",))
"""Big-LaMa, trained on Places: 208 MB."""


@dataclass(frozen=True)
class LamaSettings:
    """How a view is shown to the network.

    Attributes:
        around: Side of the window around a hole [sides of the hole]. At 2 a hole covers at most a quarter of
            what LaMa sees.
        side_max: Longer side of a window that is given at full size to a network of any size [px]. It was
            trained at 256 and keeps its quality to about 512; larger windows are reduced.
        multiple: Sides are multiples of this [px]: three halvings and the Fourier units; exports of any size
            ask for 32.
        apart: Holes closer than this are filled together [px].
        rim: Width of the bands on both sides of a hole's rim whose tones are compared [px]: texture averages
            out over several pixels.
        seam: Distance from the rim over which a difference of tone fades out [sides of the hole's window].
    """

    around: float = 2.0
    side_max: int = 512
    multiple: int = 32
    apart: int = 16
    rim: float = 3.0
    seam: float = 0.05


class LamaPrior:
    """A LaMa network in one of its two published forms.

    Either two inputs, an image (1, 3, H, W) and a mask (1, 1, H, W), or one of both (1, 4, H, W), the image
    black where masked. Colours go in as [0, 1] and come out as [0, 1] or [0, 255].

    Args:
        path: The .onnx file.

    Raises:
        InputError: onnxruntime is not installed, or the file is no network of such a form.
    """

    name = "lama"

    def __init__(self, path: Path, settings: LamaSettings | None = None) -> None:
        self.settings = settings or LamaSettings()
        self.session = _session(path)
        self.size = _fixed_size(self.session, path)
        self.unit = self._output_unit(path)

    def fill(
        self, image: torch.Tensor, mask: torch.Tensor, *, seed: int = 0, depth: torch.Tensor | None = None
    ) -> torch.Tensor:
        """Fill the masked pixels; see `Prior.fill`. Seed and depth change nothing."""
        check_fill(image, mask)
        pixels, holes = image.cpu().numpy().astype(np.float32), mask.cpu().numpy().astype(bool)
        remaining = holes.copy()
        for hole in separate(holes, self.settings.apart):
            window = self._window(hole)
            filled = self._fill_window(pixels[window], remaining[window])
            pixels = pixels.copy()
            pixels[window] = np.where(hole[window][..., None], filled, pixels[window])
            remaining &= ~hole
        return torch.where(mask[..., None], torch.from_numpy(pixels).to(image), image)

    def _window(self, hole: np.ndarray) -> tuple[slice, slice]:
        """Rows and columns around a hole, about square, as far as the image reaches."""
        spans = [np.flatnonzero(hole.any(1 - axis)) for axis in (0, 1)]
        side = int(self.settings.around * max(span[-1] + 1 - span[0] for span in spans))
        rows, columns = (
            stretch(int(span[0]), int(span[-1]) + 1, max(side, min(self.settings.side_max, length)), length)
            for span, length in zip(spans, hole.shape, strict=True)
        )
        return rows, columns

    def _fill_window(self, pixels: np.ndarray, missing: np.ndarray) -> np.ndarray:
        """A window with its hole filled at the network's size, in the tone of its rim."""
        import cv2

        height, width = missing.shape
        shrink = min(1.0, min(self._most()) / max(height, width))
        size = max(1, round(width * shrink)), max(1, round(height * shrink))
        if shrink < 1.0:
            known = cv2.resize((~missing).astype(np.float32), size, interpolation=cv2.INTER_AREA)
            shown = cv2.resize(
                np.where(missing[..., None], 0.0, pixels).astype(np.float32),
                size,
                interpolation=cv2.INTER_AREA,
            )
            # What the hole would mix into a reduced pixel is left out of it.
            shown = shown / np.maximum(known, 1e-6)[..., None]
            reduced = self._run(shown, known < 1.0)
            filled = cv2.resize(reduced, (width, height), interpolation=cv2.INTER_CUBIC)
        else:
            filled = self._run(pixels, missing)
        return _in_tone(filled, pixels, missing, self.settings)

    def _most(self) -> tuple[int, int]:
        """Largest height and width that the network is given [px]."""
        return self.size or (self.settings.side_max, self.settings.side_max)

    def _run(self, pixels: np.ndarray, missing: np.ndarray) -> np.ndarray:
        """What the network makes of a window (H, W, 3) that fits into it, padded by its mirror image."""
        import cv2

        height, width = missing.shape
        step = self.settings.multiple
        rows, columns = self.size or (-height % step + height, -width % step + width)
        below, right = rows - height, columns - width
        image = cv2.copyMakeBorder(pixels.astype(np.float32), 0, below, 0, right, cv2.BORDER_REFLECT)
        holes = cv2.copyMakeBorder(missing.astype(np.float32), 0, below, 0, right, cv2.BORDER_REFLECT)
        filled = self._infer(image, holes) / self.unit
        if not np.isfinite(filled).all():
            raise InputError("LaMa gives numbers that are not finite: download its weights again")
        return filled.clip(0.0, 1.0)[:height, :width]

    def _infer(self, image: np.ndarray, holes: np.ndarray) -> np.ndarray:
        mask = holes[None, None]
        planes = image.transpose(2, 0, 1)[None] * (1.0 - mask)
        by_channels = {4: np.concatenate([planes, mask], axis=1), 3: planes, 1: mask}
        given = {
            each.name: np.ascontiguousarray(by_channels[each.shape[1]], np.float32)
            for each in self.session.get_inputs()
        }
        (output,) = self.session.run(None, given)
        return output[0].transpose(1, 2, 0)

    def _output_unit(self, path: Path) -> float:
        """The output's value of white, 1 or 255: what is not masked must come out as it went in.

        Raises:
            InputError: it does neither way.
        """
        side = self.settings.multiple
        height, width = self.size or (2 * side, 2 * side)
        ramp = np.linspace(0.2, 0.8, width, dtype=np.float32)
        image = np.broadcast_to(ramp[None, :, None], (height, width, 3))
        holes = np.zeros((height, width), np.float32)
        holes[height // 2 :, width // 2 :] = 1.0
        known = holes == 0.0
        try:
            output = self._infer(image, holes)
        except Exception as error:  # onnxruntime's exceptions have no public base
            reason = str(error).split("\n")[0]
            raise InputError(f"{path}: the network does not run ({reason}); download it again") from error
        for unit in (1.0, 255.0):
            if output.shape == image.shape and np.abs(output / unit - image)[known].mean() < 0.05:
                return unit
        raise InputError(f"{path}: does not give back what is not masked; give an inpainting network, LaMa")


def load_lama(name: str | Path = "lama") -> LamaPrior:
    """LaMa from a file, or from the Hugging Face cache.

    Args:
        name: Path of an .onnx file; "lama" for `LAMA` as downloaded.

    Raises:
        InputError: the weights are not on this machine, the file is no LaMa, or onnxruntime is missing.
    """
    if str(name) != "lama":
        return LamaPrior(Path(name).expanduser())
    return LamaPrior(locate(LAMA) / LAMA.include[0])


def _session(path: Path) -> onnxruntime.InferenceSession:
    if find_spec("onnxruntime") is None:
        raise InputError("onnxruntime is not installed: pip install 'diga3d-warp[lama]'")
    import onnxruntime

    if not path.is_file():
        raise InputError(f"{path}: no such file; give a LaMa network as .onnx, or: {LAMA.command}")
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4  # what it says of the file is in our own error
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's exceptions have no public base
        reason = str(error).split("\n")[0]
        raise InputError(f"{path}: no ONNX network ({reason}); download it again: {LAMA.command}") from error


def _fixed_size(session: Any, path: Path) -> tuple[int, int] | None:
    """Height and width that a LaMa network takes [px]; None if it takes any.

    Raises:
        InputError: the network is of neither form of LaMa.
    """
    inputs = session.get_inputs()
    channels = sorted(given.shape[1] for given in inputs if len(given.shape) == 4)
    if channels not in ([4], [1, 3]) or len(inputs) != len(channels) or len(session.get_outputs()) != 1:
        shapes = ", ".join(f"{given.name} {given.shape}" for given in inputs)
        raise InputError(
            f"{path}: takes {shapes}; LaMa takes an image (1, 3, H, W) and a mask (1, 1, H, W), or both in "
            "one"
        )
    height, width = inputs[0].shape[2:]
    fixed = isinstance(height, int) and isinstance(width, int)
    return (height, width) if fixed else None


def _in_tone(
    filled: np.ndarray, pixels: np.ndarray, missing: np.ndarray, settings: LamaSettings
) -> np.ndarray:
    """The fill in the tone of the pixels at its rim, a correction that fades inwards.

    The network gives back the known pixels as they are, so tones are compared on both sides of the rim.
    """
    import cv2

    inward, outward = (
        cv2.distanceTransform(side.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        for side in (missing, ~missing)
    )
    sigma = max(settings.seam * max(missing.shape), 1.0)

    def tone(image: np.ndarray, band: np.ndarray) -> np.ndarray:
        """Mean colour of a band near each pixel."""
        weight = band.astype(np.float32)
        total = cv2.GaussianBlur(weight[..., None] * image.astype(np.float32), (0, 0), sigma)
        return total / np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma), 1e-6)[..., None]

    inside = missing & (inward <= settings.rim)
    outside = ~missing & (outward <= settings.rim)
    if not outside.any():
        return filled
    difference = tone(pixels, outside) - tone(filled, inside)
    return (filled + np.exp(-inward / sigma)[..., None] * difference).clip(0.0, 1.0)
