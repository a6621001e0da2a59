"""Time and memory of Stable Diffusion 1.5 with two ControlNets on a CUDA device, at the paper's size.

python benchmarks/sd_gpu.py --out docs/benchmarks/sd_gpu.md

Random weights in float16: what it costs does not depend on what it knows. 60 views of 512 x 904, K = 1, 2, 3,
as in the paper's table, which gives 41, 46 and 47 GB for its whole training.
"""

import argparse
import time
from pathlib import Path

from diga3d_warp.process import tune_process

tune_process()

import torch  # noqa: E402
from random_diffusion import CROSS, WIDTH, random_prior  # noqa: E402

from diga3d_warp.files import write_text  # noqa: E402
from diga3d_warp.priors.conditioning import (  # noqa: E402
    Conditioning,
    Control,
    ControlScales,
    Guidance,
    Prompts,
)
from diga3d_warp.priors.distillation import distillation_loss  # noqa: E402
from diga3d_warp.priors.plan import plan_sampling  # noqa: E402
from diga3d_warp.priors.protocol import DiffusionPrior  # noqa: E402
from diga3d_warp.priors.sampling import ViewLatents, sample_views  # noqa: E402
from diga3d_warp.priors.settings import SamplingSettings  # noqa: E402

PAPER = {1: 41, 2: 46, 3: 47}
"""Memory that the paper reports for its training [GB]."""


def views_of(count: int, height: int, width: int) -> ViewLatents:
    """Random latents, half of each masked, with edges and depth."""
    generator = torch.Generator().manual_seed(1)
    rows, columns = height // 8, width // 8
    z, latent = torch.randn(2, count, 4, rows, columns, generator=generator)
    mask = torch.zeros(count, 1, rows, columns)
    mask[..., rows // 2 :, :] = 1.0
    edges, depth = torch.rand(2, count, height, width, generator=generator)
    scales = ControlScales()
    controls = (Control("edges", (edges > 0.9).float(), scales.edges), Control("depth", depth, scales.depth))
    return ViewLatents(z, Conditioning(latent, mask, torch.cat([mask, latent], 1)), controls)


def sampling_row(prior: DiffusionPrior, views: ViewLatents, count: int, settings: SamplingSettings) -> str:
    """One row of the table of sampling: K references."""
    guidance = _guidance()
    plan = plan_sampling(prior, views, guidance, settings, range(count))
    start = _begin(prior.device)
    z = sample_views(prior, views, guidance, settings, references=range(count))
    seconds, peak = _end(prior.device, start)
    assert z.isfinite().all()
    each = seconds / len(views) / settings.steps
    return (
        f"| {count} | {each * 1000:.0f} ms | {plan.bank_bytes / 2**20:.0f} MiB | {peak / 1e9:.1f} GB | "
        f"{PAPER.get(count, '-')} GB |"
    )


def distillation_row(prior: DiffusionPrior, views: ViewLatents, repeats: int) -> str:
    """Time and memory of one score distillation step, through the encoder."""
    _, _, height, width = (*views.cond.latent.shape[:2], *views.controls[0].image.shape[1:])
    images = torch.rand(1, height, width, 3, device=prior.device, requires_grad=True)
    masks = torch.zeros(1, height, width, dtype=torch.bool, device=prior.device)
    masks[:, height // 2 :] = True
    controls = [control.rows([0], prior.device) for control in views.controls]
    generator = torch.Generator().manual_seed(2)
    times = []
    for _ in range(repeats):
        start = _begin(prior.device)
        distillation_loss(prior, images, masks, _guidance(), controls, t=500, generator=generator).backward()
        seconds, peak = _end(prior.device, start)
        times.append(seconds)
    assert images.grad is not None and images.grad.isfinite().all()
    return f"One step of score distillation: {min(times) * 1000:.0f} ms, peak {peak / 1e9:.1f} GB."


def _guidance() -> Guidance:
    generator = torch.Generator().manual_seed(3)
    return Guidance(Prompts(*torch.randn(2, 1, 77, CROSS, generator=generator).unbind()))


def _begin(device: torch.device) -> float:
    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats(device)
        torch.cuda.synchronize(device)
    return time.perf_counter()


def _end(device: torch.device, start: float) -> tuple[float, int]:
    if device.type != "cuda":
        return time.perf_counter() - start, 0
    torch.cuda.synchronize(device)
    return time.perf_counter() - start, torch.cuda.max_memory_allocated(device)


def main() -> None:
    """Print the tables, and write them where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--views", type=int, default=60)
    parser.add_argument("--steps", type=int, default=3)
    parser.add_argument("--batch", type=int, default=4)
    parser.add_argument("--size", type=int, nargs=2, default=(512, 904), metavar=("HEIGHT", "WIDTH"))
    parser.add_argument("--width", type=int, default=WIDTH, help="of the UNet; smaller to try the script")
    parser.add_argument("--device", default="cuda")
    options = parser.parse_args()
    if options.device == "cuda" and not torch.cuda.is_available():
        raise SystemExit(
            "no CUDA device: to try the script give --device cpu --width 32 --size 64 64 --views 4"
        )
    prior = random_prior(options.width, options.device, ("edges", "depth"))
    views = views_of(options.views, *options.size)
    name = torch.cuda.get_device_name() if options.device == "cuda" else options.device
    settings = SamplingSettings(steps=options.steps, batch=options.batch)
    lines = [
        "# Stable Diffusion 1.5 with two ControlNets on a GPU",
        "",
        f"`python benchmarks/sd_gpu.py` on {name}: {options.views} views of {options.size[0]} x "
        f"{options.size[1]}, guidance 7.5, batches of {options.batch}, UNet width {options.width}.",
        "",
        "| K | a view-step | keys of the references | peak | the paper's training |",
        "|---:|---:|---:|---:|---:|",
        *(sampling_row(prior, views, count, settings) for count in PAPER if count <= options.views),
        "",
        distillation_row(prior, views, repeats=3),
        "",
    ]
    text = "\n".join(lines)
    print(text)
    if options.out is not None:
        write_text(options.out, text)


if __name__ == "__main__":
    main()
