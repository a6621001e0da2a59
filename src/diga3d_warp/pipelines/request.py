"""Requests: all options of a run, from the command line or from Python, and the result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from diga3d_warp.config import ACCURACIES, Accuracy
from diga3d_warp.effects.overrides import format_overrides
from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.scaffold.settings import SCAFFOLD, ScaffoldSettings
from diga3d_warp.pipelines.choices import Choices
from diga3d_warp.pipelines.marking import Marks, read_marks
from diga3d_warp.pipelines.method import Method
from diga3d_warp.pipelines.run import Run
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.scene import Reading, Scene

REPRESENTATIONS = ("gaussians", "scaffold")
"""What a scene can be fitted with."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FitRequest:
    """A fit: the capture, the run folder, and what is common to all runs.

    Attributes:
        scene: Folder or file of a capture, or a scene from `load_scene`.
        out: Run folder, a new one unless `resume` is set.
        masks: Folder with a mask for each image; None looks for one in the capture.
        mask_ids: Numbers of the objects that are meant, where masks hold several; all if empty.
        image_scale: Size of the images relative to the largest of the capture, in (0, 1].
        hold_out: Every such view is kept for testing; 0 keeps none.
        iterations: Steps of the fit; None chooses by the scene.
        representation: "gaussians", or "scaffold" for anchors that decode to gaussians (Scaffold-GS).
        accuracy: "draft", "standard" or "exact": accuracy of the fitted renderings.
        effects: Effects to force on or off by name, or the SH degree; the others are chosen from the scene.
        seed: The same scene, request and seed give the same bytes.
        resume: Continue an interrupted run in `out`.
    """

    scene: str | Path | Scene
    out: str | Path
    masks: str | Path | None = None
    mask_ids: Sequence[int] = ()
    image_scale: float = Reading.image_scale
    hold_out: int = Reading.hold_out
    iterations: int | None = None
    representation: str = "gaussians"
    accuracy: str = "standard"
    effects: Mapping[str, bool | int] = field(default_factory=dict)
    seed: int = 0
    resume: bool = False

    def __post_init__(self) -> None:
        for each in fields(self):
            if "Path" in str(each.type) and getattr(self, each.name) == "":
                raise InputError(f"{each.name} is empty: give a path")
        if self.accuracy not in ACCURACIES:
            raise InputError(f"accuracy {self.accuracy!r} is unknown: use one of {', '.join(ACCURACIES)}")
        if self.representation not in REPRESENTATIONS:
            raise InputError(
                f"representation {self.representation!r} is unknown: use one of {', '.join(REPRESENTATIONS)}"
            )
        asked = Reading(self.image_scale, optional_path(self.masks), self.hold_out, tuple(self.mask_ids))
        if isinstance(self.scene, Scene) and asked not in (Reading(), self.scene.reading):
            raise InputError(
                "image_scale, masks, mask_ids and hold_out say how a capture is read: give them to "
                "load_scene, or give the path of the capture"
            )

    @property
    def knobs(self) -> Accuracy:
        """The settings that `accuracy` names."""
        return ACCURACIES[self.accuracy]

    @property
    def scaffold(self) -> ScaffoldSettings | None:
        """Settings of anchors, if the scene is to be fitted with these."""
        return SCAFFOLD if self.representation == "scaffold" else None

    def load(self) -> Scene:
        """Read the scene, unless it was given as a scene.

        Raises:
            InputError: see `load_scene`.
        """
        if isinstance(self.scene, Scene):
            return self.scene
        return load_scene(
            self.scene,
            image_scale=self.image_scale,
            masks=self.masks,
            mask_ids=self.mask_ids,
            hold_out=self.hold_out,
            progress=True,
        )

    def open_run(self, command: str, scene: Scene, iterations: int, **further: Any) -> Run:
        """Open the run folder, and check on resuming that nothing that the result depends on has changed.

        Args:
            command: Name of the subcommand.
            scene: From `load`.
            iterations: Steps of the fit.
            further: Further options that the result depends on, as JSON data.

        Raises:
            InputError: see `Run`.
        """
        settings = {
            "scene": scene.path,
            "masks": scene.reading.masks,
            "mask_ids": scene.reading.mask_ids,
            "image_scale": scene.reading.image_scale,
            "hold_out": scene.reading.hold_out,
            "seed": self.seed,
            "iterations": iterations,
            "accuracy": self.accuracy,
            "effects": format_overrides(self.effects),
            **further,
        }
        if self.scaffold is not None:
            settings["representation"] = self.representation
        return Run(Path(self.out), command, settings, resume=self.resume)


@dataclass(frozen=True, kw_only=True, eq=False)
class EditRequest(FitRequest, Choices):
    """An edit: a fit, marks of the object, the new material or object, and the method (see `Choices`).

    Attributes:
        mask_boxes: Boxes (view, left, top, right, bottom) [px] around the object in up to three views, in
            place of masks.
        mask_prompt: Prompt that names the object, in place of masks.
        mask_models: Folder with the weights for `mask_prompt`; None for the Hugging Face cache.
        prompt: The new material of `retexture`, the new object of `replace`, what a network shall show behind
            the object of `remove`.
        exemplar: A picture of the material, in place of the one in the prompt.
        asset: A mesh or splat that `replace` puts in the object's place.
        fill: Reference views as filled by another program: each VIEW=IMAGE, or a folder of images named after
            views.
    """

    mask_boxes: Sequence[Sequence[str | int]] = ()
    mask_prompt: str | None = None
    mask_models: str | Path | None = None
    prompt: str | None = None
    exemplar: str | Path | None = None
    asset: str | Path | None = None
    fill: Sequence[str | Path] = ()

    def marks(self) -> Marks:
        """The marks of the object.

        Raises:
            InputError: see `read_marks`.
        """
        read = self.scene.reading if isinstance(self.scene, Scene) else self
        boxes = [[str(part) for part in box] for box in self.mask_boxes]
        models = optional_path(self.mask_models)
        return read_marks(optional_path(read.masks), boxes, self.mask_prompt, models, read.mask_ids)

    def open_edit(
        self, command: str, scene: Scene, iterations: int, marks: Marks, method: Method, **further: Any
    ) -> Run:
        """As `open_run`; marks and method must not change on resuming either."""
        method_settings = {"prior": self.prior_name, "negative": self.negative, **method.summary()}
        return self.open_run(command, scene, iterations, **marks.settings(), **method_settings, **further)

    def refuse(self, command: str, *names: str) -> None:
        """Refuse attributes that a command would ignore.

        Raises:
            InputError: one of them is set.
        """
        unread = [name for name in names if getattr(self, name) not in (None, ())]
        if unread:
            raise InputError(f"{command} does not take {' and '.join(unread)}: leave it out")


@dataclass(frozen=True, eq=False)
class RunResult:
    """Result of a run.

    Attributes:
        gaussians: The final splat.
        run: The run folder, with views, metrics and stages.
    """

    gaussians: Gaussians
    run: Run


@dataclass(frozen=True, eq=False)
class EditResult(RunResult):
    """Result of an edit.

    Attributes:
        source: The splat before the edit.
    """

    source: Gaussians


def optional_path(name: str | Path | None) -> Path | None:
    """A path, if one is named."""
    return None if name is None else Path(name)
