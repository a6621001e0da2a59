"""Where score distillation pulls a finished removal: a prior's estimates of it against the truth.

python benchmarks/distillation_pull.py run/demo --prior exemplar --out docs/benchmarks/distillation_pull.md

TG-SDS moves a rendering towards what the prior takes it for, at one noise level after another. It can only
help where that is nearer to the truth than the rendering is.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from diga3d_warp.evaluation.record import read_manifest, run_effects
from diga3d_warp.files import read_json, write_text
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.perception.resampling import resize_images
from diga3d_warp.pipelines.coarse import read_fills, targets_of
from diga3d_warp.pipelines.demo import HOLD_OUT, RUN, SCENE, TRUTH
from diga3d_warp.pipelines.fine import guided_targets
from diga3d_warp.pipelines.method import PAPER
from diga3d_warp.priors.distillation import TextureGeometryGuide
from diga3d_warp.priors.guidance import guided_noise
from diga3d_warp.priors.named import load_prior
from diga3d_warp.priors.protocol import DiffusionPrior
from diga3d_warp.propagation.references import References
from diga3d_warp.propagation.unseen import Background
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.photographs.images import read_image
from diga3d_warp.splatting.render import render
from diga3d_warp.state import read_mask, read_picture

SHARES = (0.02, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.98)
"""Timesteps [share of the schedule]: the range that score distillation draws from."""


@torch.no_grad()
def pulled(guide: TextureGeometryGuide, image: torch.Tensor, share: float, seed: int) -> torch.Tensor:
    """What the prior takes a rendering (H, W, 3) for, once noise of one level is added, shape (H, W, 3)."""
    prior, generator = guide.prior, torch.Generator().manual_seed(seed)
    t = prior.schedule.timestep(share)
    shown = image[guide.window]
    z = prior.encode_image(resize_images(shown[None], prior.native_size(*shown.shape[:2])))
    assert guide.cond is not None, "a removal conditions on its photographs"
    noisy = prior.schedule.add_noise(z, torch.randn(z.shape, generator=generator), t)
    noise = guided_noise(prior, noisy, t, guide.guidance, guide.cond, guide.controls)
    there = prior.decode_latent(prior.schedule.denoise(noisy, noise, t))
    found = image.clone()
    found[guide.window] = resize_images(there, shown.shape[:2])[0]
    return found


def cases(
    demo: Path, prior: DiffusionPrior
) -> Iterator[tuple[TextureGeometryGuide, torch.Tensor, torch.Tensor]]:
    """For each view with something unseen: its guide, its rendering and its truth."""
    scene, run = load_scene(demo / SCENE, hold_out=HOLD_OUT), demo / RUN
    stages = run / "stages"
    gaussians, effects = Gaussians.load_ply(run / "point_cloud.ply"), run_effects(read_manifest(run))
    behind = [stages / "look-behind" / view.name for view in scene.views]
    masks = [read_mask(path.with_name(f"{path.name}.unseen.png")) for path in behind]
    known = [read_picture(path.with_name(f"{path.name}.png")) for path in behind]
    chosen = read_json(stages / "references" / "references.json", "run the demo again")
    references = References(chosen["indices"], np.array(chosen["cluster"]))
    backgrounds = [Background(mask, image, ~mask) for mask, image in zip(masks, known, strict=True)]
    fills = read_fills(stages / "fill", scene.views)
    targets = guided_targets(
        gaussians, targets_of(scene.views, backgrounds, fills), masks, references, prior, prior.guidance,
        PAPER, effects, known,
    )  # fmt: skip
    for view, target in zip(scene.views, targets, strict=True):
        if isinstance(target.guide, TextureGeometryGuide):
            with torch.no_grad():
                image = render(gaussians, view.camera, effects=replace(effects, depth=False)).color
            truth = torch.from_numpy(read_image(scene.path / TRUTH / f"{view.name}.png")).float() / 255.0
            yield target.guide, image.clamp(0.0, 1.0), truth


def psnr(images: list[torch.Tensor], truths: list[torch.Tensor], masks: list[torch.Tensor]) -> float:
    """PSNR over all masked pixels together [dB]."""
    errors = [(a - b)[mask].square().flatten() for a, b, mask in zip(images, truths, masks, strict=True)]
    return -10.0 * float(torch.cat(errors).mean().log10())


def table(demo: Path, prior: DiffusionPrior) -> str:
    """PSNR where no view saw, of the renderings and of what they are pulled towards, by noise level."""
    found = list(cases(demo, prior))
    guides, images, truths = ([case[k] for case in found] for k in range(3))
    masks = [guide.mask for guide in guides]
    lines = [
        "# Where score distillation pulls",
        "",
        f"`{' '.join(__doc__.split(chr(10))[2].split())}`",
        "",
        f"The removal of `make demo`, {len(found)} views, prior {prior.name} under texture and depth of the",
        "references. PSNR where no view saw what is behind the object, against the room without it [dB].",
        f"The renderings have {psnr(images, truths, masks):.2f} dB.",
        "",
        "| timestep | noise | what they are pulled towards [dB] |",
        "|---:|---:|---:|",
    ]
    for share in SHARES:
        alpha = prior.schedule.alpha(prior.schedule.timestep(share))
        there = [pulled(guide, image, share, 0) for guide, image in zip(guides, images, strict=True)]
        noise = ((1.0 - alpha) / alpha) ** 0.5
        lines.append(f"| {share} | {noise:.2g} | {psnr(there, truths, masks):.2f} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Print the table, and write it where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("demo", type=Path, help="folder that `make demo` filled")
    parser.add_argument("--prior", default="exemplar", help="exemplar, or a network as the edits take it")
    parser.add_argument("--out", type=Path, help="Markdown file for the table")
    options = parser.parse_args()
    prior = load_prior(options.prior, controls=("edges", "depth"))
    assert isinstance(prior, DiffusionPrior), "others estimate no noise"
    text = table(options.demo, prior)
    print(text)
    if options.out is not None:
        write_text(options.out, text)


if __name__ == "__main__":
    main()
