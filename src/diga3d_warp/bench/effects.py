"""Cost of each effect where it is on; the compiled kernels show that it is zero where it is off.

An effect that is off is not in the kernels: they are compiled for each choice of effects, and no argument or
branch refers to an effect that was not chosen. So the page compares the source given to the compiler, with
every effect off and with one of them on. A kernel that an effect does not touch has the same hash in both;
the others have more statements.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import warp as wp

from diga3d_warp.bench.garden import Garden
from diga3d_warp.bench.page import bars, pictures, require_plots, write_page
from diga3d_warp.bench.still_life import still_life, still_life_camera
from diga3d_warp.config import TILE, Accuracy, Effects
from diga3d_warp.effects.prices import PRICED, fastest, toggled, training_step
from diga3d_warp.evaluation.tables import Table
from diga3d_warp.gaussians.exposure import exposed
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.kernels import gaussian_lanes, ordering, pixel_lanes
from diga3d_warp.kernels.blending import Blending
from diga3d_warp.kernels.compositing import forward_kernel
from diga3d_warp.kernels.compositing_adjoint import adjoint_kernel
from diga3d_warp.kernels.footprint import Projecting
from diga3d_warp.kernels.harmonics import harmonics_kernel
from diga3d_warp.kernels.normals import normals_kernel
from diga3d_warp.kernels.projection import projection_kernel
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.render import render

LEAN = Effects(sh_degree=0, lens=False, depth=False, background=False)
"""Every effect off: one colour a gaussian, pinholes, nothing but colour."""

ALL = (*PRICED, "pixel_order")
"""Every effect that changes what a step computes."""

OUTSIDE = ("exposure", "background")
"""Effects that torch applies to the finished image: no kernel depends on them."""

TIMED = Garden(count=30_000, width=324, height=210)
"""A quarter of the garden-like scene: a step takes some 30 ms, so that many repeats fit into a minute."""

SECONDS = 60.0
"""Most time that the repeats take; the kernels are compiled before."""

SHOWN_EXPOSURE = torch.tensor([[1.25, 0.0, 0.0, 0.02], [0.0, 1.1, 0.0, 0.0], [0.0, 0.0, 0.85, 0.0]])
"""The exposure of the picture: a warm one."""

SHOWN_BACKGROUND = (0.35, 0.55, 0.8)
"""The background of the picture: a sky."""


@dataclass(frozen=True)
class Source:
    """Source of one kernel as given to the compiler.

    Attributes:
        digest: Warp's hash of the kernel's code with all that it calls and its options, hexadecimal.
        statements: Statements of the generated C++.
    """

    digest: str
    statements: int


def kernels_of(effects: Effects, lens_kind: str) -> dict[str, wp.Kernel]:
    """The kernels that a rendering with its gradient runs, without binning, which depends on no effect.

    Args:
        effects: Effects to simulate.
        lens_kind: The camera's lens, "brown" or "fisheye".
    """
    accuracy = Accuracy.STANDARD
    blending = Blending.of(accuracy, effects, normals=effects.normals, median=effects.median_depth)
    projecting = Projecting.of(lens_kind if effects.lens else "none", accuracy, effects)
    degree = 3 if effects.sh_degree is None else effects.sh_degree
    kernels = {
        "project": projection_kernel(projecting, gaussian_lanes.CPU_LANES),
        "shade": harmonics_kernel(degree, gaussian_lanes.CPU_LANES),
        "blend": forward_kernel(blending, pixel_lanes.CPU_LANES),
        "blend, adjoint": adjoint_kernel(blending, pixel_lanes.CPU_LANES),
    }
    if effects.pixel_order:
        kernels["blend"] = ordering.ordered_kernel(blending)
        kernels["blend, adjoint"] = ordering.ordered_adjoint_kernel(blending, TILE)
    if effects.normals:
        kernels["orient"] = normals_kernel(gaussian_lanes.CPU_LANES)
    return kernels


def source_of(kernel: wp.Kernel) -> Source:
    """Hash and size of the code of a kernel, which is compiled if necessary."""
    module = kernel.module
    wp.load_module(module, device="cpu")
    (loaded,) = module.execs.values()
    text = next(Path(loaded.binary_path).parent.glob("*.cpp")).read_text(encoding="utf-8")
    return Source(loaded.module_hash.hex(), text.count(";"))


def bench_effects(out: Path, repeats: int, garden: Garden = TIMED) -> list[Table]:
    """Measure, and write `effects.md`, `effects.png` and `effects-pictures.png`.

    Args:
        out: Folder of the page.
        repeats: Times that each step is run; the fastest counts.
        garden: The scene that is timed.

    Returns:
        The tables of the page.

    Raises:
        InputError: the plots' package is missing, or the folder cannot be written.
    """
    require_plots()
    seconds = measure(garden, repeats)
    tables = [cost_table(garden, seconds), source_table()]
    added = {
        _label(name): [1e3 * seconds[""], 1e3 * max(0.0, seconds[name] - seconds[""])]
        for name in PRICED
        if name in seconds
    }
    parts = ["every effect off", "with this one on"]
    bars(out / "effects.png", "processor time of a step [ms]", parts, added)
    draw_pictures(out / "effects-pictures.png")
    write_page(
        out / "effects.md", "What effects cost", "diga3d bench effects --out docs/benchmarks", tables,
        ["effects.png", "effects-pictures.png"], NOTES,
    )  # fmt: skip
    return tables


NOTES = f"""\
A step is a rendering with its gradient. An effect that is off is not in the kernels: they are compiled for
each choice of effects. The second table compares what the compiler is given, by statements of the generated
C++. "same" is the very kernel, by its hash, that runs with every effect off; where a number stands, the
effect is in that kernel. Pixel order has a blending of its own. {" and ".join(OUTSIDE).capitalize()} are
added to the finished image, and in no kernel at all. The pictures show each effect off, above, and on, below.

A background lies behind cut-out things, where photographs have an alpha channel. Each step of a fit puts
another colour behind photograph and rendering, black or white in each channel: over one colour, gaussians of
that colour would cost nothing where there is nothing. Whatever is shown or measured is over white.

Times are of the processor, all cores together, and the least of several: others may share the machine. Pixel
order would not fit into the first plot. An effect may save time because it changes what is drawn:
anti-aliasing makes small gaussians fainter, and this lens all of them smaller; a tenth less is blended.
"""


def measure(garden: Garden, repeats: int) -> dict[str, float]:
    """Processor time of a step with every effect off, under "", and with each alone on [s]."""
    gaussians = garden.gaussians()
    bent = replace(garden.camera, distortion=still_life_camera().distortion)
    steps = {"": training_step(gaussians, bent, LEAN)}
    steps |= {name: training_step(gaussians, bent, toggled(LEAN, name)) for name in ALL}
    return fastest(steps, repeats, SECONDS)


def cost_table(garden: Garden, seconds: dict[str, float]) -> Table:
    """What each effect adds to a step."""
    lean = seconds[""]
    rows = [["every effect off", f"{1e3 * lean:.1f}", "", ""]]
    for name in ALL:
        if name in seconds:
            more = seconds[name] - lean
            rows.append(
                [
                    _label(name),
                    f"{1e3 * seconds[name]:.1f}",
                    f"{1e3 * more:+.1f}",
                    f"{100 * more / lean:+.0f} %",
                ]
            )
    title = f"A step with {garden.count} gaussians at {garden.width} x {garden.height} px, each effect alone"
    return Table(title, ["effect", "step [ms]", "added [ms]", "added"], rows)


def source_table() -> Table:
    """Statements that each effect adds to each kernel."""
    lens = still_life_camera().distortion
    assert lens is not None
    lean = {name: source_of(kernel) for name, kernel in kernels_of(LEAN, lens.kind).items()}
    columns = [*lean, "orient"]
    rows = [["every effect off", *(str(lean[name].statements) for name in lean), "not there"]]
    for effect in ALL:
        kernels = kernels_of(toggled(LEAN, effect), lens.kind)
        found = {name: source_of(kernel) for name, kernel in kernels.items()}
        rows.append([_label(effect), *(_difference(lean.get(name), found.get(name)) for name in columns)])
    return Table(
        "Statements of each kernel's source, and those that one effect adds", ["effect", *columns], rows
    )


def _difference(lean: Source | None, found: Source | None) -> str:
    if found is None:
        return "not there"
    if lean is None:
        return f"+{found.statements}"
    return "same" if found.digest == lean.digest else f"{found.statements - lean.statements:+d}"


def _label(name: str) -> str:
    return "harmonics of degree 3" if name == "sh_degree" else name.replace("_", " ")


def draw_pictures(path: Path) -> None:
    """Draw a still life with each effect off, and below it on."""
    gaussians, camera = still_life(), still_life_camera()
    pictures(
        path,
        {_label(name): (_picture(gaussians, camera, name, False), _picture(gaussians, camera, name, True))
         for name in ALL},
    )  # fmt: skip


def _picture(gaussians: Gaussians, camera: Camera, name: str, on: bool) -> np.ndarray:
    """The still life with one effect off or on, RGB (H, W, 3); what is no colour is shown as one."""
    shown = replace(LEAN, sh_degree=1)
    if name == "sh_degree":
        effects = replace(shown, sh_degree=1 if on else 0)
    else:
        effects = replace(shown, **{name: on})
    with torch.no_grad():
        rendering = render(gaussians, camera, effects=effects, background=SHOWN_BACKGROUND)
    color = exposed(rendering.color, SHOWN_EXPOSURE) if effects.exposure else rendering.color
    if effects.normals and rendering.normals is not None:
        color = 0.5 - 0.5 * rendering.normals * (rendering.alpha > 0.5)[..., None]
    depth = rendering.median_depth if effects.median_depth else rendering.depth
    if (effects.depth or effects.median_depth) and depth is not None:
        color = torch.where(depth > 0, 1.5 / depth.clamp_min(1.5), 0.0)[..., None].expand(-1, -1, 3)
    return color.clamp(0.0, 1.0).numpy()
