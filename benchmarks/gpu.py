"""Rendering and its adjoint on a CUDA device, beside gsplat and gswarp where they are installed.

Usage: python benchmarks/gpu.py --out docs/benchmarks

Needs a CUDA device. All draw the seeded scene of `diga3d bench kernels` at 1920 x 1080 px with harmonics of
degree 3; before it is timed, each one's image is compared with ours.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import torch

from diga3d_warp.bench.garden import DEGREE, Garden
from diga3d_warp.bench.page import write_page
from diga3d_warp.config import Effects
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.tables import Table
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.render import render

COUNTS = (120_000, 1_000_000)
WIDTH, HEIGHT = 1920, 1080
WARM_UPS, REPEATS = 5, 20

NEAR, FAR = 0.01, 100.0
"""Clipping planes of gswarp's projection matrix [scene units]; the scene lies between 2 and 20."""

SAME = 0.02
"""Mean difference of two images in [0, 1] above which they do not show the same scene."""

Renderer = Callable[[Gaussians, Camera], torch.Tensor]


def ours(gaussians: Gaussians, camera: Camera) -> torch.Tensor:
    """RGB (H, W, 3)."""
    return render(gaussians, camera, effects=Effects(depth=False)).color


def gsplat_image(gaussians: Gaussians, camera: Camera) -> torch.Tensor:
    """RGB (H, W, 3) by gsplat, unpacked: with one camera that sees most gaussians, its faster mode."""
    from gsplat import rasterization

    intrinsics = torch.tensor(
        [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]], device="cuda"
    )
    colors, _, _ = rasterization(
        gaussians.means,
        gaussians.quaternions,
        gaussians.scales,
        gaussians.opacities,
        gaussians.sh,
        camera.world_to_camera.float().cuda()[None],
        intrinsics[None],
        camera.width,
        camera.height,
        sh_degree=DEGREE,
        packed=False,
    )
    return colors[0]


def gswarp_image(gaussians: Gaussians, camera: Camera) -> torch.Tensor:
    """RGB (H, W, 3) by gswarp, whose interface is 3DGS's: matrices transposed, normalised quaternions."""
    from gswarp import GaussianRasterizationSettings, GaussianRasterizer

    view = camera.world_to_camera.float().cuda()
    tangent_x, tangent_y = camera.width / (2.0 * camera.fx), camera.height / (2.0 * camera.fy)
    projection = torch.zeros(4, 4, device="cuda")
    projection[0, 0], projection[1, 1] = 1.0 / tangent_x, 1.0 / tangent_y
    projection[2, 2], projection[2, 3] = FAR / (FAR - NEAR), -FAR * NEAR / (FAR - NEAR)
    projection[3, 2] = 1.0
    settings = GaussianRasterizationSettings(
        image_height=camera.height,
        image_width=camera.width,
        tanfovx=tangent_x,
        tanfovy=tangent_y,
        bg=torch.zeros(3, device="cuda"),
        scale_modifier=1.0,
        viewmatrix=view.T.contiguous(),
        projmatrix=(projection @ view).T.contiguous(),
        sh_degree=DEGREE,
        campos=torch.linalg.inv(view)[:3, 3].contiguous(),
        prefiltered=False,
    )
    color, *_ = GaussianRasterizer(settings)(
        means3D=gaussians.means,
        means2D=torch.zeros_like(gaussians.means, requires_grad=True),
        opacities=gaussians.opacities[:, None],
        shs=gaussians.sh,
        scales=gaussians.scales,
        rotations=torch.nn.functional.normalize(gaussians.quaternions),
    )
    return color.permute(1, 2, 0)


RENDERERS: dict[str, Renderer] = {"gsplat": gsplat_image, "gswarp": gswarp_image}


def milliseconds(draw: Renderer, gaussians: Gaussians, camera: Camera) -> tuple[float, float]:
    """Median times of the image and of its adjoint [ms]."""
    leaves = gaussians.detached().requires_grad_()
    forward, backward = [], []
    for repeat in range(WARM_UPS + REPEATS):
        marks = [torch.cuda.Event(enable_timing=True) for _ in range(3)]
        marks[0].record()
        image = draw(leaves, camera)
        marks[1].record()
        image.square().mean().backward()
        marks[2].record()
        torch.cuda.synchronize()
        for _, tensor in leaves.named():
            assert tensor.grad is not None and bool(tensor.grad.any()), "the adjoint did not run"
            tensor.grad = None
        if repeat >= WARM_UPS:
            forward.append(marks[0].elapsed_time(marks[1]))
            backward.append(marks[1].elapsed_time(marks[2]))
    return tuple(float(torch.tensor(times).median()) for times in (forward, backward))


def compare(count: int) -> Table:
    """One scene drawn by all renderers that are installed."""
    garden = Garden(count=count, width=WIDTH, height=HEIGHT)
    camera, gaussians = garden.camera, garden.gaussians().to("cuda")
    with torch.no_grad():
        reference = ours(gaussians, camera)
    here = milliseconds(ours, gaussians, camera)
    rows = [("diga3d-warp", *_cells(here), "1.00", "")]
    for name, draw in RENDERERS.items():
        if find_spec(name) is None:
            rows.append((name, "not installed", "", "", "", ""))
            continue
        with torch.no_grad():
            difference = float((draw(gaussians, camera) - reference).abs().mean())
        if difference > SAME:
            raise InputError(f"{name} draws another scene (mean difference {difference:.3f}): compare setups")
        times = milliseconds(draw, gaussians, camera)
        rows.append((name, *_cells(times), f"{sum(times) / sum(here):.2f}", f"{difference:.4f}"))
    columns = ["", "forward [ms]", "backward [ms]", "both [ms]", "times ours", "mean difference"]
    return Table(f"{count:,} gaussians at {WIDTH} x {HEIGHT} px", columns, rows)


def _cells(times: tuple[float, float]) -> tuple[str, str, str]:
    return f"{times[0]:.2f}", f"{times[1]:.2f}", f"{sum(times):.2f}"


def main() -> None:
    """Compare at both sizes and write `gpu.md`."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("run/benchmarks"), metavar="DIR")
    out = parser.parse_args().out
    if not torch.cuda.is_available():
        raise SystemExit("gpu.py: no CUDA device here: run it on a machine that has one")
    tables = [compare(count) for count in COUNTS]
    notes = f"On {torch.cuda.get_device_name()}. Medians of {REPEATS} runs, timed by CUDA events.\n"
    write_page(out / "gpu.md", "Speed on a GPU", f"python benchmarks/gpu.py --out {out}", tables, [], notes)
    for table in tables:
        print(table.text())


if __name__ == "__main__":
    main()
