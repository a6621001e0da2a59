"""The figures of a fill of one capture."""

from __future__ import annotations

from typing import TypedDict


class Figures(TypedDict):
    """What a method reached on a capture; None where it does not apply.

    psnr, ssim: held-out views against the truth, within the widened masks [dB, 1].
    unseen: PSNR of the filled views before any fit, where no photograph shows what is behind the object [dB].
    contrast: deviation of colours there in shares of the truth's [1].
    left: share of those pixels that no fill reached; the figures above leave them out [1].
    disagreement: of the filled views there [levels of 255].
    depth_error: median relative depth error of the rendered views there [1].
    elsewhere: PSNR of views without the object from other places, whole images [dB].
    seconds: from the choice of references to the finished splat; of a fill of each view, all views.
    """

    psnr: float
    ssim: float
    unseen: float | None
    contrast: float | None
    left: float
    disagreement: float | None
    depth_error: float | None
    elsewhere: float | None
    seconds: float
