"""What attention propagation costs for K = 1, 3, 5 references, and that memory does not grow with the views.

python benchmarks/afp_cost.py --out docs/benchmarks/afp_cost.md

Counted: floating-point operations and the size of the bank in Stable Diffusion 1.5's UNet, without computing.
Measured: a narrower UNet with random weights, on this machine's cores, with as many tokens as the real one.
"""

import argparse
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from diga3d_warp.process import tune_process

tune_process()

import torch  # noqa: E402
from random_diffusion import CROSS, WIDTH, random_prior, unet_config  # noqa: E402

from diga3d_warp.files import write_text  # noqa: E402
from diga3d_warp.priors.attention import AttentionBank  # noqa: E402
from diga3d_warp.priors.conditioning import (  # noqa: E402
    Conditioning,
    Guidance,
    Prompts,
)
from diga3d_warp.priors.plan import plan_sampling  # noqa: E402
from diga3d_warp.priors.sampling import ViewLatents, sample_views  # noqa: E402
from diga3d_warp.priors.settings import SamplingSettings  # noqa: E402
from diga3d_warp.priors.stable_diffusion import processor  # noqa: E402

COUNTS = (1, 3, 5)
SIZES = {"512 x 512": (64, 64), "512 x 904": (64, 113)}
NARROW = 64
"""Width of the measured UNet: a fraction of the real one's operations, the same number of tokens."""

VIEWS = ((8, 4), (32, 4), (128, 4), (128, 125))
"""Numbers of views and sizes of batches; the last, in one batch, shows that the measurement sees growth."""


def counted(rows: int, columns: int) -> list[tuple[int, float, float]]:
    """K, operations relative to none, and size of the bank in float16 with guidance [MiB]."""
    from diffusers import UNet2DConditionModel
    from torch.utils.flop_counter import FlopCounterMode

    with torch.device("meta"):
        unet = UNet2DConditionModel(**unet_config(WIDTH, 9)).half()
        z = torch.empty(1, 9, rows, columns, dtype=torch.half)
        text = torch.empty(1, 77, CROSS, dtype=torch.half)

    def operations() -> int:
        with FlopCounterMode(display=False) as counter, torch.no_grad():
            unet(z, torch.zeros((), device="meta"), encoder_hidden_states=text)
        return counter.get_total_flops()

    plain, found, bank = operations(), [], AttentionBank()
    processor.install(unet, bank)
    for count in range(1, max(COUNTS) + 1):
        with bank.writing():
            operations()
        if count in COUNTS:
            with bank.reading():
                found.append((count, operations() / plain, 2 * bank.size / 2**20))
    return found


def measured(repeats: int) -> list[tuple[int, float, float, float]]:
    """K, processor seconds of an estimate alone and while reading, and their ratio; each the least of some.

    Processor time of all threads: on a machine that others use, too, the clock tells little.
    """
    prior = random_prior(NARROW, "cpu")
    generator = torch.Generator().manual_seed(1)
    text = torch.randn(1, 77, CROSS, generator=generator)
    views = _views(1, (64, 64), generator)

    def estimate() -> float:
        start = time.process_time()
        prior.predict_noise(views.start, 500, text, views.cond)
        return time.process_time() - start

    found, bank = [], AttentionBank()
    prior.install_attention(bank)
    for count in range(1, max(COUNTS) + 1):
        with bank.writing():
            estimate()
        if count in COUNTS:
            own, reading = [], []
            for _ in range(repeats):
                own.append(estimate())
                with bank.reading():
                    reading.append(estimate())
            found.append((count, min(own), min(reading), min(reading) / min(own)))
    return found


def peak_of(count: int, batch: int) -> None:
    """Print how much more memory so many views take than 8, the bank, and the latents of all [MiB]."""
    prior = random_prior(32, "cpu")
    generator = torch.Generator().manual_seed(1)
    guidance = Guidance(Prompts(*torch.randn(2, 1, 77, CROSS, generator=generator).unbind()), scale=1.0)
    few, many = (_views(size, (16, 16), generator) for size in (8, count))
    for _ in range(2):  # the allocator keeps what the first sampling freed
        reference = _peak_while(lambda: sample_views(prior, few, guidance, _one_step(4), references=range(3)))
    peak = _peak_while(lambda: sample_views(prior, many, guidance, _one_step(batch), references=range(3)))
    plan = plan_sampling(prior, many, guidance, _one_step(batch), range(3))
    print(peak - reference, plan.bank_bytes / 2**20, plan.host_bytes / 2**20)


def _one_step(batch: int) -> SamplingSettings:
    return SamplingSettings(steps=1, batch=batch)


def _peak_while(work: Callable[[], object]) -> float:
    """Most memory that the process has while it works [MiB]; Linux forgets the peak when asked to."""
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    work()
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024


def _views(count: int, size: tuple[int, int], generator: torch.Generator) -> ViewLatents:
    z, latent = torch.randn(2, count, 4, *size, generator=generator)
    mask = torch.ones(count, 1, *size)
    return ViewLatents(z, Conditioning(latent, mask, torch.cat([mask, latent], 1)))


def table(repeats: int) -> str:
    """All three measurements as Markdown."""
    lines = ["# What attention propagation costs", "", "`python benchmarks/afp_cost.py`", ""]
    lines += [
        "Counted for Stable Diffusion 1.5's inpainting UNet: operations of one noise estimate relative to",
        "one without propagation, and keys and values of all references in float16, both halves of guidance.",
        "",
        "| image | K | operations | bank |",
        "|---|---:|---:|---:|",
    ]
    for name, size in SIZES.items():
        for count, ratio, bank in counted(*size):
            lines.append(f"| {name} | {count} | x {ratio:.2f} | {bank:.0f} MiB |")
    lines += [
        "",
        f"Measured on a UNet of width {NARROW} instead of {WIDTH}, random weights, 512 x 512, float32: "
        f"processor seconds of {torch.get_num_threads()} threads on",
        f"{_processor()}, least of {repeats}, load average {os.getloadavg()[0]:.0f}. Attention",
        "is a larger share of it than of the real one, for which the operations above tell more.",
        "",
        "| K | without | reading | ratio |",
        "|---:|---:|---:|---:|",
    ]
    lines += [
        f"| {count} | {own:.2f} s | {reading:.2f} s | x {ratio:.2f} |"
        for count, own, reading, ratio in measured(repeats)
    ]
    lines += [
        "",
        "How much higher the process's memory rises than with 8 views: K = 3, a small UNet, no guidance,",
        "each in a process of its own. Latents of all views wait on the host. The last row takes the views",
        "in one batch, to show that the measurement sees growth where there is some.",
        "",
        "| views | batch | higher | bank | latents and masks |",
        "|---:|---:|---:|---:|---:|",
    ]
    for count, batch in VIEWS:
        command = [sys.executable, __file__, "--peak-of", str(count), str(batch)]
        higher, bank, host = map(float, subprocess.check_output(command, text=True).split())
        lines.append(f"| {count} | {batch} | {higher:.1f} MiB | {bank:.1f} MiB | {host:.1f} MiB |")
    return "\n".join(lines) + "\n"


def _processor() -> str:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--peak-of", type=int, nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.peak_of:
        peak_of(*options.peak_of)
    else:
        text = table(options.repeats)
        print(text)
        if options.out is not None:
            write_text(options.out, text)
