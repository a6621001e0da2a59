"""Commands that make a run: fit, and the three edits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from diga3d_warp.cli.options import (
    add_exemplar,
    add_fill,
    add_marks,
    add_prior,
    add_run_options,
    add_surfaces,
)
from diga3d_warp.cli.parsing import Commands, path

if TYPE_CHECKING:
    from diga3d_warp.pipelines.request import RunResult


def add_edits(commands: Commands) -> None:
    """fit, remove, retexture and replace."""
    fit = commands.add("fit", _fit, "fit a splat to a capture", "diga3d fit captures/garden --out run/garden")
    add_run_options(fit)

    remove = commands.add(
        "remove",
        _remove,
        "remove the masked object from a capture",
        "diga3d remove captures/statue --out run/statue --masks captures/statue/masks",
    )
    add_run_options(remove)
    add_marks(remove)
    remove.add_argument(
        "--prompt",
        metavar="TEXT",
        help="what is behind the object, for a Stable Diffusion --prior (default: nothing said)",
    )
    add_fill(remove, "these become the references")
    add_prior(remove)
    add_surfaces(remove)

    retexture = commands.add(
        "retexture",
        _retexture,
        "give the masked object another material",
        'diga3d retexture captures/bear --prompt "white marble" --out run/bear',
    )
    add_run_options(retexture)
    add_marks(retexture)
    material = retexture.add_mutually_exclusive_group(required=True)
    material.add_argument(
        "--prompt",
        metavar="TEXT",
        help="the material: a word of the built-in vocabulary, or any text with a Stable Diffusion --prior",
    )
    add_exemplar(material, "--prompt")
    add_prior(retexture)

    replace = commands.add(
        "replace",
        _replace,
        "put another object in place of the masked one",
        'diga3d replace captures/can --prompt "a wooden cube" --out run/can',
    )
    add_run_options(replace)
    add_marks(replace)
    new = replace.add_mutually_exclusive_group(required=True)
    new.add_argument(
        "--prompt",
        metavar="TEXT",
        help='a built-in solid in a material, "a wooden cube", or any text with a Stable Diffusion --prior',
    )
    new.add_argument(
        "--asset", type=path, metavar="FILE", help="a mesh (.glb, .obj, .ply, .stl) or a splat .ply"
    )
    add_fill(new, "they show the new object")
    add_exemplar(replace, "the one in --prompt")
    add_prior(replace)
    add_surfaces(replace)


def _fit(**options: Any) -> int:
    from diga3d_warp.pipelines.fit import fit

    return _show(fit(**options))


def _remove(**options: Any) -> int:
    from diga3d_warp.pipelines.remove import remove

    return _show(remove(**options))


def _retexture(**options: Any) -> int:
    from diga3d_warp.pipelines.retexture import retexture

    return _show(retexture(**options))


def _replace(**options: Any) -> int:
    from diga3d_warp.pipelines.replace import replace

    return _show(replace(**options))


def _show(result: RunResult) -> int:
    """Print the path that a user opens next."""
    from diga3d_warp.evaluation.record import REPORT, RESULT

    print(result.run.folder / RESULT)
    print(result.run.folder / REPORT)
    return 0
