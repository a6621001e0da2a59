"""The synthetic captures that benchmarks edit, and the folder that keeps what was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from diga3d_warp.bench.room import HOLD_OUT, SETTINGS
from diga3d_warp.errors import InputError
from diga3d_warp.files import read_json, write_json
from diga3d_warp.pipelines.remove import RemoveSettings
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.scene import Scene
from diga3d_warp.scene.synthetic.generate import SyntheticScene, generate

FEWEST_VIEWS = 6
"""Every 4th view is held out, and three of the others are references."""


@dataclass(frozen=True)
class Captures:
    """What is edited.

    Attributes:
        situations: Names of situations.
        seeds: Each situation is generated with the seeds 0 to `seeds` - 1.
        width, height: Image size [px].
        views: Number of views, every `HOLD_OUT`th of which is held out.
        settings: Of the removals but for their method.

    Raises:
        InputError: there are too few views to hold some out.
    """

    situations: Sequence[str]
    seeds: int = 3
    width: int = 160
    height: int = 120
    views: int = 16
    settings: RemoveSettings = field(default_factory=lambda: SETTINGS)

    def __post_init__(self) -> None:
        if self.views < FEWEST_VIEWS:
            raise InputError(
                f"{self.views} views leave too few to fit and to hold out: use {FEWEST_VIEWS} or more"
            )

    @property
    def cells(self) -> list[tuple[str, int]]:
        """Situation and seed of each capture."""
        return [(name, seed) for name in self.situations for seed in range(self.seeds)]

    def load(self, situation: str, seed: int, folder: Path) -> Scene:
        """One of the captures, with held-out views; generated if the folder lacks it."""
        if not folder.exists():
            settings = SyntheticScene(
                self.width, self.height, self.views, shadows=False, seed=seed, situation=situation
            )
            generate(settings, folder)
        return load_scene(folder, hold_out=HOLD_OUT)

    def hold_to(self, folder: Path) -> None:
        """Refuse a folder that holds figures of other settings; situations and seeds may be added.

        Raises:
            InputError: it does.
        """
        described = asdict(replace(self, situations=(), seeds=0))
        path = folder / "settings.json"
        write_json(path.with_suffix(".now"), described)
        now = read_json(path.with_suffix(".now"), "write it again")
        path.with_suffix(".now").unlink()
        if not path.exists():
            write_json(path, now)
        elif read_json(path, "delete the folder") != now:
            raise InputError(f"{folder} holds figures of other settings: delete it, or choose another --work")


class CaptureFolder:
    """One capture, and the folder that keeps what was measured of it.

    Args:
        captures: What is edited.
        situation, seed: Which of them.
        folder: Of all captures.
    """

    def __init__(self, captures: Captures, situation: str, seed: int, folder: Path) -> None:
        self.captures, self.situation, self.seed = captures, situation, seed
        self.folder = folder / f"{situation}-{seed}"

    @property
    def scene(self) -> Scene:
        """The capture, generated if the folder lacks it."""
        return self.captures.load(self.situation, self.seed, self.folder / "capture")
