"""A synthetic capture with ground truth: an ordinary COLMAP folder, rendered from a seed."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from diga3d_warp.errors import InputError, cannot_write
from diga3d_warp.files import write_json
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.colmap.reconstruction import write_colmap
from diga3d_warp.scene.layouts.cameras_file import CameraSet, save_cameras
from diga3d_warp.scene.scene import Points
from diga3d_warp.scene.synthetic.arc import arc_cameras
from diga3d_warp.scene.synthetic.room import room_scenery
from diga3d_warp.scene.synthetic.shots import Shot, Stage, set_stage, take, take_alone
from diga3d_warp.scene.synthetic.situations.catalogue import SITUATIONS, build_situation

UNEVEN = ("lawn",)
"""Situations whose support is not level."""

TEST_VIEWS = 6
"""Views of a situation without the object, from elsewhere."""


@dataclass(frozen=True)
class SyntheticScene:
    """What `generate` makes.

    Attributes:
        width, height: Image size [px].
        views: Number of views on the arc.
        shadows: Whether the object darkens and colours its surroundings. Without, the images with and
            without the object differ inside the masks only.
        seed: Of textures, small things in the room, camera positions and sampling noise.
        supersampling: Rays per pixel and axis.
        situation: One of `SITUATIONS`; None for the room with a vase.
        gloss: Reflectance of the floor, table top or board that the object stands on, seen from straight
            above, in [0, 1]: it mirrors the object, within no mask. None for a matte one.

    Raises:
        InputError: a size or a number is too small to make a capture, or no situation has that name.
    """

    width: int = 320
    height: int = 240
    views: int = 24
    shadows: bool = True
    seed: int = 0
    supersampling: int = 2
    situation: str | None = None
    gloss: float | None = None

    def __post_init__(self) -> None:
        if self.width < 16 or self.height < 16:
            raise InputError(
                f"synthetic images of {self.width} x {self.height} px are too small: use 16 or more"
            )
        if self.views < 2:
            raise InputError(f"a synthetic capture of {self.views} views has no parallax: use 2 or more")
        if self.supersampling < 1:
            raise InputError(f"supersampling {self.supersampling} casts no ray: use 1 or more")
        if self.seed < 0:
            raise InputError(f"seed {self.seed} is negative: use 0 or more")
        if self.situation is not None and self.situation not in SITUATIONS:
            raise InputError(f"no situation is called {self.situation!r}: use one of {', '.join(SITUATIONS)}")
        if self.gloss is not None and not 0.0 <= self.gloss <= 1.0:
            raise InputError(f"gloss {self.gloss} is no reflectance: use 0 to 1")
        if self.gloss is not None and self.situation in UNEVEN:
            raise InputError(f"{self.situation} has no level support that could mirror: leave out the gloss")


def generate(settings: SyntheticScene, folder: Path | str, progress: bool = False) -> Path:
    """Write a synthetic capture with its ground truth.

    Layout: images/*.png, masks/*.png (255 = object) and sparse/0 (COLMAP); in ground_truth/ the same views as
    without_object/*.png, other_object/*.png (a golden ball), other_material/*.png (marble), depth/*.npy and
    depth_without_object/*.npy (z depth [m], float32); scene.json with the settings. Of a situation also
    captions.json, what the images show in words, and ground_truth/elsewhere/: views without the object from
    other places, as images/*.png, depth/*.npy and views.json (cameras, in the form of cameras.json).

    Args:
        settings: What to make.
        folder: Where to; it appears once everything is written.
        progress: Show a progress bar.

    Returns:
        `folder`.

    Raises:
        InputError: the folder exists and holds something, or cannot be written.
    """
    with appearing(Path(folder)) as partial:
        _write_capture(settings, partial, progress)
    return Path(folder)


@contextmanager
def appearing(folder: Path) -> Iterator[Path]:
    """A folder to write to, which takes its place once everything is written.

    Raises:
        InputError: there is something already, or nothing can be written there.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} exists already: give another folder or delete it")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as partial:
            yield Path(partial) / "capture"
            (Path(partial) / "capture").replace(folder)
    except OSError as error:
        raise cannot_write(folder, error) from error


def _write_capture(settings: SyntheticScene, folder: Path, progress: bool) -> None:
    rng = np.random.default_rng([settings.seed, 3])
    size = settings.width, settings.height
    if settings.situation is None:
        situation, scenery = None, room_scenery(settings.seed)
        cameras = arc_cameras(*size, settings.views, settings.seed)
    else:
        situation = build_situation(settings.situation, settings.seed)
        scenery, paths = situation.scenery, np.random.default_rng([settings.seed, 2])
        cameras = situation.orbit.cameras(*size, settings.views, paths)
    stage = set_stage(scenery, settings.seed, settings.shadows, settings.gloss)
    points = []
    for name, camera in tqdm(cameras.items(), "rendering", unit="view", disable=not progress):
        shot = take(stage, camera, settings.supersampling, rng)
        _write_shot(shot, folder, name)
        points.append(shot.points)
    positions = np.concatenate([part.positions for part in points])
    colors = np.concatenate([part.colors for part in points])
    write_colmap(folder, cameras, Points(positions, colors), suffix=".png")
    described = {key: value for key, value in asdict(settings).items() if value is not None}
    write_json(folder / "scene.json", described)
    if situation is not None:
        write_json(folder / "captions.json", asdict(situation.captions))
        elsewhere = situation.orbit.elsewhere(*size, TEST_VIEWS, paths)
        _write_test_views(stage, elsewhere, settings.supersampling, folder / "ground_truth" / "elsewhere")


def _write_test_views(stage: Stage, cameras: Mapping[str, Camera], supersampling: int, folder: Path) -> None:
    """Views from other places without the object: images/, depth/, and their cameras in views.json."""
    for name, camera in cameras.items():
        image, depth = take_alone(stage, camera, supersampling)
        _write_png(folder / "images" / f"{name}.png", image)
        _write_npy(folder / "depth" / f"{name}.npy", depth)
    save_cameras(folder / "views.json", CameraSet({}, cameras))


def _write_shot(shot: Shot, folder: Path, name: str) -> None:
    truth = folder / "ground_truth"
    pictures = {
        folder / "images": shot.image,
        folder / "masks": shot.mask[..., None] * np.uint8(255),
        truth / "without_object": shot.without_object,
        truth / "other_object": shot.other_object,
        truth / "other_material": shot.other_material,
    }
    for place, picture in pictures.items():
        _write_png(place / f"{name}.png", picture)
    _write_npy(truth / "depth" / f"{name}.npy", shot.depth)
    _write_npy(truth / "depth_without_object" / f"{name}.npy", shot.depth_without_object)


def _write_png(path: Path, picture: np.ndarray) -> None:
    import cv2

    path.parent.mkdir(parents=True, exist_ok=True)
    ok, png = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))
    assert ok
    path.write_bytes(png.tobytes())


def _write_npy(path: Path, array: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, array)
