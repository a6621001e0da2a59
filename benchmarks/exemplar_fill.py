"""What the exemplar prior's fill is worth and costs, beside other fills without weights, one view at a time.

diga3d synthetic run/room --width 504 --height 378 --views 10 --no-shadows
python benchmarks/exemplar_fill.py run/room --views 4 --out docs/benchmarks/exemplar_fill.md

The truth is the room without the vase; the hole is the widened mask of the vase. So every method has to
invent all of it, while a removal first looks behind the object through the other views. PSNR rewards blur, so
the detail of a fill stands beside it: its mean square gradient within the mask over that of the truth.
"""

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from diga3d_warp.process import tune_process

tune_process()

import numpy as np  # noqa: E402
import torch  # noqa: E402

from diga3d_warp.evaluation.metrics import compare  # noqa: E402
from diga3d_warp.files import write_image, write_text  # noqa: E402
from diga3d_warp.kernels.launch import thread_count  # noqa: E402
from diga3d_warp.pipelines.clearing import MaskSettings, widened  # noqa: E402
from diga3d_warp.priors.classical import ClassicalPrior, mean_color_fill, telea_fill  # noqa: E402
from diga3d_warp.priors.exemplar.prior import ExemplarPrior  # noqa: E402
from diga3d_warp.priors.exemplar.settings import FILL  # noqa: E402
from diga3d_warp.scene.load import load_scene  # noqa: E402
from diga3d_warp.scene.photographs.images import read_image  # noqa: E402

Fill = Callable[[torch.Tensor, torch.Tensor, torch.Tensor], torch.Tensor]
"""Image with a hole, mask and depth behind it to a filled image."""


def methods() -> dict[str, Fill]:
    """Every fill by name."""
    one = ExemplarPrior(settings=replace(FILL, seeds=1))
    best = ExemplarPrior()
    return {
        "mean colour": lambda image, mask, depth: mean_color_fill(image, mask),
        "Telea": lambda image, mask, depth: telea_fill(image, mask),
        "classical (shift map)": lambda image, mask, depth: ClassicalPrior().fill(image, mask),
        "exemplar, one proposal": lambda image, mask, depth: one.fill(image, mask),
        f"exemplar, best of {FILL.seeds}": lambda image, mask, depth: best.fill(image, mask),
        f"exemplar, best of {FILL.seeds}, true depth": lambda image, mask, depth: best.fill(
            image, mask, depth=depth
        ),
    }


def table(capture: Path, count: int | None, pictures: Path | None) -> str:
    """Scores inside the mask and seconds, a row for each method."""
    views = load_scene(capture, hold_out=0).views[:count]
    rows: dict[str, list[tuple[float, float, float, float, float]]] = {name: [] for name in methods()}
    share = []
    for view in views:
        truth = read_image(capture / "ground_truth" / "without_object" / f"{view.name}.png")
        depth = np.load(capture / "ground_truth" / "depth_without_object" / f"{view.name}.npy")
        assert view.mask is not None, "the generator writes a mask for each view"
        mask = torch.from_numpy(widened(view.mask, MaskSettings()))
        clean = torch.from_numpy(truth).float() / 255.0
        image = torch.where(mask[..., None], 0.5, clean)
        share.append(float(mask.float().mean()))
        shown = [image]
        for name, fill in methods().items():
            if not rows[name]:
                fill(image, mask, torch.from_numpy(depth))  # compiles
            wall, cpu = time.perf_counter(), time.process_time()
            filled = fill(image, mask, torch.from_numpy(depth))
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            score = compare(filled, clean, mask)["masked"]
            detail = _roughness(filled, mask) / _roughness(clean, mask)
            rows[name].append((score.psnr, score.ssim, detail, wall, cpu))
            shown.append(filled)
        if pictures is not None:
            write_image(pictures / f"{view.name}.png", torch.cat([*shown, clean], 1))
    means = {name: np.mean(values, axis=0) for name, values in rows.items()}
    unit = means["Telea"][4]
    size = views[0].camera
    lines = [
        "# Fills without learned weights",
        "",
        f"`{' '.join(__doc__.split(chr(10))[3].split())}`",
        "",
        f"{len(views)} views of {size.width} x {size.height} px, a hole of "
        f"{100 * float(np.mean(share)):.0f} % of each, all of it invented. {thread_count()} threads, load "
        f"average {os.getloadavg()[0]:.0f} on {os.cpu_count()} cores: compare processor seconds.",
        "",
        "| fill | masked PSNR [dB] | masked SSIM | detail | seconds | processor seconds | against Telea |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    lines += [
        f"| {name} | {psnr:.2f} | {ssim:.3f} | {detail:.2f} | {wall:.2f} | {cpu:.2f} | x {cpu / unit:.0f} |"
        for name, (psnr, ssim, detail, wall, cpu) in means.items()
    ]
    return "\n".join(lines) + "\n"


def _roughness(image: torch.Tensor, mask: torch.Tensor) -> float:
    """Mean square difference of neighbouring pixels within the mask."""
    across = (image[:, 1:] - image[:, :-1])[mask[:, 1:] & mask[:, :-1]]
    down = (image[1:] - image[:-1])[mask[1:] & mask[:-1]]
    return float(torch.cat([across, down]).square().mean())


def main() -> None:
    """Print the table, and write it and pictures where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", type=Path, help="folder that `diga3d synthetic` filled")
    parser.add_argument("--out", type=Path, help="Markdown file for the table")
    parser.add_argument("--views", type=int, help="how many views, from the first (default all)")
    parser.add_argument("--pictures", type=Path, help="folder for a row of fills of each view")
    options = parser.parse_args()
    text = table(options.capture, options.views, options.pictures)
    print(text)
    if options.out is not None:
        write_text(options.out, text)


if __name__ == "__main__":
    main()
