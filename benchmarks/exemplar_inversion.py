"""Does sampling return to the image that DDIM inversion led away from? PSNR against steps.

diga3d synthetic run/room --width 504 --height 378 --views 10 --no-shadows
python benchmarks/exemplar_inversion.py run/room --out docs/benchmarks/exemplar_inversion.md

No pixel is told to the prior. Patches come either from the image itself, as in a retexture that starts from
the object as it is, or from another view, whose patches the image is not made of.
"""

import argparse
from pathlib import Path

from diga3d_warp.process import tune_process

tune_process()

import torch  # noqa: E402

from diga3d_warp.evaluation.metrics import psnr  # noqa: E402
from diga3d_warp.files import write_text  # noqa: E402
from diga3d_warp.perception.resampling import resize_images  # noqa: E402
from diga3d_warp.priors.conditioning import Guidance, Prompts  # noqa: E402
from diga3d_warp.priors.exemplar.prior import ExemplarPrior  # noqa: E402
from diga3d_warp.priors.exemplar.prompts import PatchPrompt  # noqa: E402
from diga3d_warp.priors.inversion import invert  # noqa: E402
from diga3d_warp.priors.sampling import ViewLatents, initial_noise, sample_views  # noqa: E402
from diga3d_warp.priors.settings import SamplingSettings  # noqa: E402
from diga3d_warp.scene.load import load_scene  # noqa: E402

STEPS = (5, 10, 20, 50)
SIDE = 0.25
"""Size of the images against the capture's: inversion looks at every pixel, and entries are many."""


def returned(image: torch.Tensor, patches: torch.Tensor, steps: int, fixed_point: bool | None) -> float:
    """PSNR of the image after inversion and sampling [dB]; from plain noise if `fixed_point` is None."""
    prior = ExemplarPrior()
    everything = torch.ones(1, *image.shape[:2], dtype=torch.bool)
    cond = prior.conditioning(image[None], everything)
    text = PatchPrompt(exemplar=patches)
    if fixed_point is None:
        z = initial_noise(cond.latent.shape, 0)
    else:
        z = invert(prior, cond.latent, text, cond, steps=steps, fixed_point=fixed_point)
    settings = SamplingSettings(steps=steps, afp_weight=0.0)
    z = sample_views(prior, ViewLatents(z, cond), Guidance(Prompts(text, text), 1.0), settings)
    return psnr(prior.decode_latent(z)[0], image)


def table(capture: Path) -> str:
    """A row for each number of steps."""
    views = load_scene(capture, hold_out=0).views
    height, width = views[0].camera.height, views[0].camera.width
    size = round(height * SIDE), round(width * SIDE)
    image, other = (resize_images(views[k].image[None], size)[0] for k in (0, len(views) // 2))
    lines = [
        "# DDIM inversion and back, exemplar prior",
        "",
        f"`{' '.join(__doc__.split(chr(10))[3].split())}`",
        "",
        f"One view of {size[1]} x {size[0]} px, PSNR of the whole image [dB].",
        "",
        "| steps | own patches | own, fixed point | another view's | another's, fixed point | no inversion |",
        "|---:|---:|---:|---:|---:|---:|",
    ]
    for steps in STEPS:
        figures = [
            returned(image, patches, steps, fix) for patches in (image, other) for fix in (False, True)
        ]
        figures.append(returned(image, image, steps, None))
        lines.append(f"| {steps} | " + " | ".join(f"{figure:.1f}" for figure in figures) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Print the table, and write it where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", type=Path, help="folder that `diga3d synthetic` filled")
    parser.add_argument("--out", type=Path, help="Markdown file for the table")
    options = parser.parse_args()
    text = table(options.capture)
    print(text)
    if options.out is not None:
        write_text(options.out, text)


if __name__ == "__main__":
    main()
