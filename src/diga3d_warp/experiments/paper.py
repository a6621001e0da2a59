"""The paper's experiments: which jobs each needs, and what its table holds.

table1    removal, with the figures of the whole image and of the mask
table2    re-texturing and replacement, by the edits of a file: CLIP_dir and the user study
table3    components: without TG-SDS, without AFP and TG-SDS
table4    number K of references, on one scene at 512 px
table5    the appendix' figures without a reference image: MUSIQ and correspondences
accuracy  accuracy settings of the renderer
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypedDict

from diga3d_warp.errors import InputError
from diga3d_warp.experiments import published
from diga3d_warp.experiments.job import Command, Job, Size
from diga3d_warp.experiments.options import checked_options, in_scene
from diga3d_warp.experiments.scenes import find_scenes
from diga3d_warp.experiments.sheet import COSTS, SIZE, Column, Row, Sheet
from diga3d_warp.experiments.yaml_file import read_yaml, refuse_unknown

NAMES = ("table1", "table2", "table3", "table4", "table5", "accuracy")

EDITS = "edits.yaml"
"""File of the edits of table2, in the data folder unless another one is named."""

TABLE4_SCENE = "1"
TABLE4_SIDE = 512
"""Short side of the images [px]. The paper's 512 x 904 are 512 x 910 px, cut to a multiple of 8."""

OURS = "diga3d-warp"

ACCURACY, REPRESENTATION = "standard", "gaussians"
"""What runs have by default."""

PSNR, SSIM = Column("PSNR ↑", "PSNR"), Column("SSIM ↑", "SSIM", digits=4)
LPIPS = Column("LPIPS ↓", "LPIPS (VGG)", digits=4)
QUALITY = (PSNR, SSIM, LPIPS)
MASKED = (
    Column("masked PSNR ↑", "PSNR", "masked"),
    Column("masked SSIM ↑", "SSIM", "masked", 4),
    Column("masked LPIPS ↓", "LPIPS (VGG)", "masked", 4),
)
BOX = (Column("box PSNR ↑", "PSNR", "box"), Column("box LPIPS ↓", "LPIPS (VGG)", "box", 4))
FID = Column("FID ↓", "FID")

NOT_COMPARABLE = (
    "Published rows are copied from the papers named; figures of one data set in different papers do not "
    "compare unless one program measured them."
)


class EditEntry(TypedDict, total=False):
    """An edit of table2."""

    scene: str | int
    command: Literal["retexture", "replace"]
    options: dict[str, Any]
    source_prompt: str
    edit_prompt: str


class EditsFile(TypedDict):
    """The edits of table2."""

    edits: list[EditEntry]


@dataclass(frozen=True)
class Experiment:
    """What is common to the experiments of one command.

    Attributes:
        data: Folder of the scenes.
        scenes: Names of the scenes to take; all if empty.
        priors, representations: A row of each table for each prior with each representation.
        options: Options of all jobs, as attributes of `EditRequest`.
        size: Image size of all jobs but table4's.
        weights: Folder with the weights of the metrics.
        edits: File of the edits of table2; `EDITS` in the data folder if None.
        votes: Files of votes for table2.
    """

    data: Path
    scenes: Sequence[str] = ()
    priors: Sequence[str] = ("exemplar",)
    representations: Sequence[str] = (REPRESENTATION,)
    options: Mapping[str, Any] = field(default_factory=dict)
    size: Size = "published"
    weights: str | None = None
    edits: Path | None = None
    votes: Sequence[Path] = ()

    def sheets(self, names: Sequence[str]) -> list[Sheet]:
        """The sheets of experiments by their names; "all" has table2 only where there is an edits file.

        Raises:
            InputError: there are no scenes, or a file is not usable.
        """
        wanted = [name for name in NAMES if name in names or "all" in names]
        if "table2" in wanted and not self.edits_file.is_file():
            if "table2" in names:
                raise InputError(
                    f"table2 needs {self.edits_file}, which names scenes and prompts: see docs/scale.md, or "
                    "name another file with --edits"
                )
            wanted.remove("table2")
        return [getattr(self, f"_{name}")() for name in wanted]

    @property
    def edits_file(self) -> Path:
        """File of the edits of table2."""
        return self.data / EDITS if self.edits is None else self.edits

    @property
    def methods(self) -> dict[str, Mapping[str, Any]]:
        """Options of each prior with each representation, by their name in tables."""
        found: dict[str, Mapping[str, Any]] = {}
        for prior in self.priors:
            for representation in self.representations:
                name, options = Path(prior).name or prior, {"prior": prior}
                if representation != REPRESENTATION:
                    name, options = f"{name}, {representation}", {**options, "representation": representation}
                found[name] = options
        return found

    def _removal(self, scene: Path, method: Mapping[str, Any], size: Size = None, **options: Any) -> Job:
        chosen = {**self.options, **method, **options}
        if chosen.get("accuracy") == ACCURACY:  # said or not, it is the same job
            del chosen["accuracy"]
        return Job(
            "remove", str(scene), chosen, size or self.size,
            weights=self.weights,
        )  # fmt: skip

    def _rows(
        self, variants: Mapping[str, Mapping[str, Any]], scenes: Sequence[Path], size: Size = None
    ) -> list[Row]:
        return [
            Row(
                f"{OURS}, {label}{name and ', '}{name}",
                [self._removal(scene, method, size, **options) for scene in scenes],
            )
            for label, method in self.methods.items()
            for name, options in variants.items()
        ]

    def _table1(self) -> Sheet:
        columns = (*QUALITY, *MASKED, *BOX, FID)
        rows = self._rows({"": {}}, find_scenes(self.data, self.scenes))
        return Sheet("table1", "Object removal (Table 1)", columns, rows, published.TABLE1, [NOT_COMPARABLE])

    def _table2(self) -> Sheet:
        columns = (
            Column("re-texturing CLIP_dir ↑", "CLIP_dir", digits=4, command="retexture"),
            Column("re-texturing user study [%]", "user study", command="retexture"),
            Column("replacement CLIP_dir ↑", "CLIP_dir", digits=4, command="replace"),
        )
        further, shares = self._study()
        rows = [
            Row(
                f"{OURS}, {label}",
                self._edits(method),
                {columns[1].head: shares[label]} if label in shares else None,
            )
            for label, method in self.methods.items()
        ]
        notes = [
            NOT_COMPARABLE,
            "The paper does not list the prompts of its edits; these are those of the file.",
        ]
        title = "Re-texturing and replacement (Table 2)"
        return Sheet("table2", title, columns, rows, published.TABLE2, notes, further)

    def _table3(self) -> Sheet:
        """The full model is without charts, which would leave its parts little to fill."""
        full = {"propagation": "attention", "tg_sds": True, "surfaces": False}
        variants: dict[str, dict[str, Any]] = {
            "full model": full,
            "w/o TG-SDS": {**full, "tg_sds": False},
            "w/o AFP and TG-SDS": {**full, "propagation": "none", "tg_sds": False},
            "as by default": {},
        }
        rows = self._rows(variants, find_scenes(self.data, self.scenes))
        notes = [
            NOT_COMPARABLE,
            "The three variants leave out charts, which would leave the components little to fill; the "
            "last row is that of table1.",
        ]
        return Sheet("table3", "Components (Table 3)", (*QUALITY, *MASKED), rows, published.TABLE3, notes)

    def _table4(self) -> Sheet:
        scenes = find_scenes(self.data, self.scenes)
        scene = next((each for each in scenes if each.name == TABLE4_SCENE), scenes[0])
        full = {"propagation": "attention", "tg_sds": True, "surfaces": False}
        variants = {f"K = {count}": {**full, "references": count} for count in (1, 2, 3)}
        columns = (*QUALITY, *MASKED, Column("memory", COSTS), Column("size [px]", SIZE))
        rows = self._rows(variants, [scene], TABLE4_SIDE)
        notes = [NOT_COMPARABLE, "Memory and time differ from run to run and are in costs.md."]
        title = f"Number K of references, scene {scene.name} (Table 4)"
        return Sheet("table4", title, columns, rows, published.TABLE4, notes)

    def _table5(self) -> Sheet:
        halves: tuple[tuple[str, Command], ...] = (("removal", "remove"), ("replacement", "replace"))
        columns = [
            Column(f"{word} {head}", metric, command=command, digits=digits)
            for word, command in halves
            for head, metric, digits in (
                ("MUSIQ ↑", "MUSIQ", 2), ("Corrs ↑", "LoFTR matches", 0), ("SIFT ↑", "SIFT matches", 0),
            )
        ]  # fmt: skip
        scenes, edits = find_scenes(self.data, self.scenes), self.edits_file.is_file()
        rows = [
            Row(
                f"{OURS}, {label}",
                [
                    *(self._removal(scene, method) for scene in scenes),
                    *(job for job in (self._edits(method) if edits else []) if job.command == "replace"),
                ],
            )
            for label, method in self.methods.items()
        ]
        notes = [
            NOT_COMPARABLE,
            "Corrs are LoFTR matches of a pair of frames; SIFT matches need no weights and are no Corrs.",
        ]
        return Sheet("table5", "Without reference images (appendix)", columns, rows, published.TABLE5, notes)

    def _accuracy(self) -> Sheet:
        variants = {f"accuracy {name}": {"accuracy": name} for name in ("draft", "standard", "exact")}
        rows = self._rows(variants, find_scenes(self.data, self.scenes))
        columns = (*QUALITY, *MASKED, Column("time", COSTS))
        return Sheet("accuracy", "Accuracy of the renderer, removal", columns, rows)

    def _edits(self, method: Mapping[str, Any]) -> list[Job]:
        """The jobs of the edits file with a prior and a representation."""
        path = self.edits_file
        data = read_yaml(path, EditsFile)
        if not data["edits"]:
            raise InputError(f"{path}: the list of edits is empty, so there is nothing to run: give an edit")
        scenes = {scene.name: scene for scene in find_scenes(self.data)}
        jobs = []
        for number, entry in enumerate(data["edits"], 1):
            place = f"edit {number}: "
            refuse_unknown(path, entry, EditEntry.__annotations__, place)
            if "scene" not in entry or "command" not in entry:
                raise InputError(f"{path}: {place}it has no scene or no command: give both")
            name = str(entry["scene"])
            if name not in scenes:
                raise InputError(
                    f"{path}: {place}{self.data} has no scene {name!r}: it has {', '.join(scenes)}"
                )
            if self.scenes and name not in self.scenes:
                continue
            own = checked_options(path, entry["command"], entry.get("options", {}))
            if not any(own.get(key) for key in ("prompt", "exemplar", "asset")):
                raise InputError(f"{path}: {place}its options name no prompt, exemplar or asset: give one")
            options = in_scene({**self.options, **method, **own}, scenes[name])
            size = None if "image_scale" in own else self.size
            jobs.append(
                Job(
                    entry["command"], str(scenes[name]), options, size, entry.get("source_prompt"),
                    entry.get("edit_prompt"), self.weights,
                )
            )  # fmt: skip
        return jobs

    def _study(self) -> tuple[list[Any], dict[str, str]]:
        """Tables of the votes, and the share of each method by its name."""
        if not self.votes:
            return [], {}
        from diga3d_warp.pipelines.run import say
        from diga3d_warp.study.tally import tally

        result = tally(self.votes)
        for note in result.notes:
            say(f"note: {note}")
        shares = {
            name: f"{100 * share.votes / share.of:.2f}" for name, share in result.methods.items() if share.of
        }
        return list(result.tables()), shares
