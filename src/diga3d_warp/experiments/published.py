"""Published figures that stand beside measured ones, each with its source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

PAPER = "DiGA3D, arXiv 2507.00429"


@dataclass(frozen=True)
class Published:
    """A row of a published table.

    Attributes:
        method: The method.
        source: Where the figures are from; a method may be reported by another one's paper.
        cells: Figures as published, by the heads of our columns.
    """

    method: str
    source: str
    cells: Mapping[str, str]


def _rows(source: str, heads: tuple[str, ...], rows: Mapping[str, tuple[str, ...]]) -> tuple[Published, ...]:
    return tuple(
        Published(method, source, dict(zip(heads, cells, strict=True))) for method, cells in rows.items()
    )


TABLE1 = _rows(
    f"{PAPER}, Table 1",
    ("PSNR ↑", "SSIM ↑", "LPIPS ↓", "masked PSNR ↑", "masked SSIM ↑", "masked LPIPS ↓"),
    {
        "SPIn-NeRF": ("20.32", "0.48", "0.41", "15.45", "0.22", "0.56"),
        "NeRFiller": ("17.31", "0.28", "0.43", "15.48", "0.24", "0.65"),
        "MVIP-NeRF": ("20.60", "0.49", "0.44", "10.00", "0.24", "0.60"),
        "GScream": ("20.49", "0.58", "0.28", "15.84", "0.21", "0.54"),
        "DiGA3D": ("20.71", "0.58", "0.28", "17.22", "0.26", "0.56"),
    },
)

TABLE2 = _rows(
    f"{PAPER}, Table 2",
    ("re-texturing CLIP_dir ↑", "re-texturing user study [%]", "replacement CLIP_dir ↑"),
    {
        "Instruct-NeRF2NeRF": ("0.0572", "1.85", "0.0354"),
        "GaussianEditor": ("0.0702", "1.85", "0.0908"),
        "GaussCtrl": ("0.0742", "12.97", "0.1097"),
        "DiGA3D": ("0.1751", "83.33", "0.2247"),
    },
)

TABLE3 = _rows(
    f"{PAPER}, Table 3",
    ("PSNR ↑", "SSIM ↑", "LPIPS ↓"),
    {
        "DiGA3D, full model": ("20.71", "0.58", "0.28"),
        "DiGA3D, w/o TG-SDS": ("20.66", "0.57", "0.29"),
        "DiGA3D, w/o AFP and TG-SDS": ("20.45", "0.57", "0.30"),
    },
)

TABLE4 = _rows(
    f"{PAPER}, Table 4 (one A6000)",
    ("PSNR ↑", "SSIM ↑", "LPIPS ↓", "memory", "size [px]"),
    {
        "DiGA3D, K = 1": ("19.87", "0.4670", "0.3350", "41 GB", "904 x 512"),
        "DiGA3D, K = 2": ("19.89", "0.4665", "0.3412", "46 GB", "904 x 512"),
        "DiGA3D, K = 3": ("19.94", "0.4676", "0.3330", "47 GB", "904 x 512"),
    },
)

TABLE5 = _rows(
    f"{PAPER}, appendix",
    ("removal MUSIQ ↑", "removal Corrs ↑", "replacement MUSIQ ↑", "replacement Corrs ↑"),
    {
        "NeRFiller": ("65.55", "7343", "65.25", "7223"),
        "DiGA3D": ("68.89", "7421", "68.70", "7512"),
    },
)
