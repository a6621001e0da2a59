"""The page of the edits by text: a table for each task, and pictures of each edit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from diga3d_warp.bench.ablation.page import known_cell
from diga3d_warp.bench.captures import Captures
from diga3d_warp.bench.page import pictures, require_plots, write_page
from diga3d_warp.bench.prompts.edits import TRUTHS, UNEDITED, Task, methods_of
from diga3d_warp.bench.prompts.measure import Cell, Figures
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.tables import Table
from diga3d_warp.priors.named import load_prior, reads_prompts
from diga3d_warp.priors.protocol import DiffusionPrior
from diga3d_warp.state import read_picture

COLUMNS: Mapping[str, tuple[Callable[[Figures], float | None], str]] = {
    "PSNR masked [dB]": (lambda found: found["psnr"], ".2f"),
    "SSIM masked": (lambda found: found["ssim"], ".3f"),
    "PSNR against the photographs [dB]": (lambda found: found["before"], ".2f"),
    "nearer to the prompt [%]": (lambda found: 100 * found["nearer"], ".0f"),
}
"""Figures by head, and how they are written."""

SHOWN = 3
"""Captures in the picture, the first ones."""


def bench_prompts(out: Path, work: Path, captures: Captures, prior: str) -> list[Table]:
    """Measure, and write `prompts_PRIOR.md` and its picture.

    Args:
        out: Folder of the page.
        work: Folder of captures and figures; what it holds is not measured again.
        captures: What is edited.
        prior: A network, as `priors.named.load_prior` takes it.

    Returns:
        A table for each task.

    Raises:
        InputError: the plots' package is missing, the prior is no network or cannot be loaded, a folder
            cannot be written, or `work` holds figures of other settings.
    """
    require_plots()
    if not reads_prompts(prior):
        raise InputError(f"prior {prior} reads no prompts: give a network, such as sd-inpainting or a folder")
    network = load_prior(prior, controls=("edges", "depth"))
    assert isinstance(network, DiffusionPrior), "all that read prompts are"
    captures.hold_to(work)
    methods = methods_of(network.name)
    cells = [Cell(captures, *place, work, network) for place in captures.cells]
    results: dict[Task, list[dict[str, Figures]]] = {task: [] for task in TRUTHS}
    for each in cells:
        for task in TRUTHS:
            results[task].append(each.figures(task, methods))
        each.clean()
    tables = [table(task, [UNEDITED, *methods], found) for task, found in results.items()]
    name = page_name(network.name)
    draw(out / f"{name}.png", cells[:SHOWN], [UNEDITED, *methods])
    command = (
        f"diga3d bench prompts --prior {prior} --situations {','.join(captures.situations)} "
        f"--seeds {captures.seeds} --out {out}"
    )
    write_page(out / f"{name}.md", f"Prompts: {network.name}", command, tables, [f"{name}.png"], notes(cells))
    return tables


def page_name(prior: str) -> str:
    """Name of a prior's page without its ending."""
    return f"prompts_{Path(prior).name}"


def notes(cells: Sequence[Cell]) -> str:
    """Notes of the page."""
    captures = cells[0].captures
    words = "\n".join(
        f"| {each.situation} {each.seed} | {each.prompts.retexture} | {each.prompts.replace} |"
        for each in cells
    )
    return f"""\
The object of synthetic [situations](../situations.md) is given the material, or replaced by the object, that
a prompt names; the generator knows what that looks like. **masked**: held-out views of the edited splat
within the widened masks, against that truth; a cell is the mean over {len(cells)} captures and their sample
deviation. **against the photographs**: the same views against what was there before. **nearer to the
prompt**: share of the held-out views that are nearer to the truth of the prompt than to the photograph.
Texture, shape and shadow of a truth are only one way in which a prompt can be met: an edit that is as good
has a low PSNR. "built-in words" paints a procedural material, or places a solid, where the prompt's words are
in its vocabulary. The captures have {captures.width} x {captures.height} px and {captures.views} views.

| capture | retexture | replace |
|---|---|---|
{words}

The picture shows, by columns, a held-out view of the first {min(SHOWN, len(cells))} captures, a retexture and
a replacement of each.
"""


def table(task: Task, names: Sequence[str], found: Sequence[Mapping[str, Figures]]) -> Table:
    """One row for each method; its number of captures is that which its words allow."""
    rows = []
    for name in names:
        figures = [each[name] for each in found if name in each]
        cells = [known_cell([of(each) for each in figures], form) for of, form in COLUMNS.values()]
        rows.append([f"{name} ({len(figures)})", *cells])
    return Table(task, ["method (captures)", *COLUMNS], rows)


def draw(path: Path, cells: Sequence[Cell], names: Sequence[str]) -> None:
    """A stack of pictures for the truth and for each method; the photograph where its words allow no edit."""
    order = [(each, task) for each in cells for task in TRUTHS]
    stacks = {"truth": [read_picture(each.folder / f"{task}-truth.png") for each, task in order]}
    for name in names:
        files = [each.path(task, name, "png") for each, task in order]
        unedited = [each.path(task, UNEDITED, "png") for each, task in order]
        stacks[name] = [
            read_picture(file if file.exists() else other)
            for file, other in zip(files, unedited, strict=True)
        ]
    pictures(path, stacks, columns=len(stacks))
