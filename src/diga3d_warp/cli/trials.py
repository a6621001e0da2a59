"""Commands that need no capture: doctor, synthetic and demo."""

from __future__ import annotations

from pathlib import Path

from diga3d_warp.cli.parsing import Commands, path, positive_int, seed, share
from diga3d_warp.scene.synthetic.situations.catalogue import SITUATIONS


def add_trials(commands: Commands) -> None:
    """doctor, synthetic and demo."""
    commands.add("doctor", _doctor, "check that everything is in place on this machine", "diga3d doctor")

    synthetic = commands.add(
        "synthetic",
        _synthetic,
        "write a synthetic capture with ground truth",
        "diga3d synthetic run/tiles --situation tiles --seed 3",
        "Write a synthetic capture with ground truth: without the object, in another material, with another "
        "object, and depth.",
    )
    synthetic.add_argument("out", type=path, metavar="OUT", help="a new folder")
    synthetic.add_argument(
        "--situation",
        choices=SITUATIONS,
        metavar="NAME",
        help=f"in place of the demo's room: {', '.join(SITUATIONS)}",
    )
    synthetic.add_argument("--width", type=positive_int, default=320, metavar="PX")
    synthetic.add_argument("--height", type=positive_int, default=240, metavar="PX")
    synthetic.add_argument("--views", type=positive_int, default=24, metavar="N")
    synthetic.add_argument("--no-shadows", action="store_true", help="the object casts no shadow")
    synthetic.add_argument(
        "--gloss",
        type=share,
        metavar="R",
        help="reflectance of what the object stands on, seen from above: it mirrors the object",
    )
    synthetic.add_argument("--seed", type=seed, default=0, metavar="N")
    synthetic.add_argument(
        "--layout",
        choices=["colmap", "spin-nerf"],
        default="colmap",
        help="spin-nerf: test views without the object in place of the ground truth (default colmap)",
    )

    demo = commands.add(
        "demo", _demo, "edit the object of a synthetic room and compare", "diga3d demo --out run/demo"
    )
    demo.add_argument("--out", type=path, default=Path("run/demo"), metavar="DIR", help="(default run/demo)")


def _doctor() -> int:
    from diga3d_warp.doctor import examine

    return examine()


def _synthetic(
    out: Path,
    situation: str | None,
    width: int,
    height: int,
    views: int,
    no_shadows: bool,
    gloss: float | None,
    seed: int,
    layout: str,
) -> int:
    from diga3d_warp.scene.synthetic.generate import SyntheticScene, generate
    from diga3d_warp.scene.synthetic.spin_nerf import generate_spin_nerf

    settings = SyntheticScene(
        width=width,
        height=height,
        views=views,
        shadows=not no_shadows,
        seed=seed,
        situation=situation,
        gloss=gloss,
    )
    write = generate_spin_nerf if layout == "spin-nerf" else generate
    print(write(settings, out, progress=True))
    return 0


def _demo(out: Path) -> int:
    from diga3d_warp.pipelines.demo import run_demo

    run_demo(out)
    return 0
