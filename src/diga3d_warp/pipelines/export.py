"""export_splat: the result of a run, or any splat file, in a format that other programs read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.record import RESULT, read_manifest, run_effects
from diga3d_warp.scene.formats.read import read_splat
from diga3d_warp.scene.formats.recognise import splat_format
from diga3d_warp.scene.formats.write import ENDINGS, write_splat
from diga3d_warp.scene.layouts.splat import stem


@dataclass(frozen=True)
class Exported:
    """A splat file that was written.

    Attributes:
        path: The file.
        notes: What was left out in the conversion, one line each.
    """

    path: Path
    notes: list[str]


def export_splat(source: Path, form: str, out: Path | None = None) -> Exported:
    """Write a splat in another format.

    Args:
        source: A run folder, whose result is taken, or a splat file of any format that is read.
        form: A name in `ENDINGS`.
        out: The file to write; beside the splat, with the ending of the format, if None.

    Raises:
        InputError: there is no splat, the format cannot hold it, its package is missing, or `out` cannot be
            written, ends otherwise, or is the splat itself.
    """
    splat, antialiased = source, False
    if not source.exists():
        raise InputError(
            f"{source}: no such file or folder; give a run folder, or a splat such as a 3DGS .ply"
        )
    if not source.is_file():
        antialiased = run_effects(read_manifest(source)).antialias
        splat = source / RESULT
        if not splat.is_file():
            raise InputError(f"{source} has no {RESULT}: finish the run with --resume first")
    if out is None:
        out = splat.with_name(stem(splat) + ENDINGS[form])
    _check_out(out, form, splat)
    content = read_splat(splat)
    antialiased = antialiased or content.antialiased
    notes = write_splat(out, content.rows, form, antialiased=antialiased)
    return Exported(out, [*content.notes, *notes])


def _check_out(out: Path, form: str, splat: Path) -> None:
    """Refuse an output path with the wrong ending, or one that is the input.

    Raises:
        InputError: the file ends otherwise than the format does, is a folder, or the splat itself.
    """
    if not ENDINGS[form].endswith(out.suffix.lower() or "/"):
        raise InputError(f"{out}: a file of the format {form} ends in {ENDINGS[form]}; name it so")
    if out.is_dir():
        raise InputError(f"{out} is a folder; give the name of a file with --out")
    if out.exists() and out.samefile(splat):
        same = splat_format(splat) == form
        reason = "is in that format already" if same else "would be replaced"
        raise InputError(f"{splat} {reason}; give another name with --out")
