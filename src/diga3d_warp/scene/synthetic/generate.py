"""A synthetic capture with ground truth: an ordinary COLMAP folder of a small room, rendered from a seed."""

from __future__ import annotations

import json
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from diga3d_warp.errors import InputError
from diga3d_warp.scene.colmap.reconstruction import write_colmap
from diga3d_warp.scene.scene import Points
from diga3d_warp.scene.synthetic.arc import arc_cameras
from diga3d_warp.scene.synthetic.room import room_scenery
from diga3d_warp.scene.synthetic.shots import Shot, set_stage, take


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

    Raises:
        InputError: a size or a number is too small to make a capture.
    """

    width: int = 320
    height: int = 240
    views: int = 24
    shadows: bool = True
    seed: int = 0
    supersampling: int = 2

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


def generate(settings: SyntheticScene, folder: Path | str, progress: bool = False) -> Path:
    """Write a synthetic capture with its ground truth.

    Layout: images/*.png, masks/*.png (255 = object) and sparse/0 (COLMAP); in ground_truth/ the same views as
    without_object/*.png, other_object/*.png (a golden ball), other_material/*.png (marble), depth/*.npy and
    depth_without_object/*.npy (z depth [m], float32); scene.json with the settings.

    Args:
        settings: What to make.
        folder: Where to; it appears once everything is written.
        progress: Show a progress bar.

    Returns:
        `folder`.

    Raises:
        InputError: the folder exists and holds something, or cannot be written.
    """
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} exists already: give another folder or delete it")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as partial:
            _write_capture(settings, Path(partial) / "capture", progress)
            (Path(partial) / "capture").replace(folder)
    except OSError as error:
        raise InputError(f"{folder} cannot be written ({error.strerror}): give another folder") from error
    return folder


def _write_capture(settings: SyntheticScene, folder: Path, progress: bool) -> None:
    cameras = arc_cameras(settings.width, settings.height, settings.views, settings.seed)
    rng = np.random.default_rng([settings.seed, 3])
    stage = set_stage(room_scenery(settings.seed), settings.seed, settings.shadows)
    points = []
    for name, camera in tqdm(cameras.items(), "rendering", unit="view", disable=not progress):
        shot = take(stage, camera, settings.supersampling, rng)
        _write_shot(shot, folder, name)
        points.append(shot.points)
    positions = np.concatenate([part.positions for part in points])
    colors = np.concatenate([part.colors for part in points])
    write_colmap(folder, cameras, Points(positions, colors), suffix=".png")
    (folder / "scene.json").write_text(json.dumps(asdict(settings), indent=2) + "\n")


def _write_shot(shot: Shot, folder: Path, name: str) -> None:
    import cv2

    truth = folder / "ground_truth"
    pictures = {
        folder / "images": shot.image,
        folder / "masks": shot.mask[..., None] * np.uint8(255),
        truth / "without_object": shot.without_object,
        truth / "other_object": shot.other_object,
        truth / "other_material": shot.other_material,
    }
    depths = {truth / "depth": shot.depth, truth / "depth_without_object": shot.depth_without_object}
    for place in (*pictures, *depths):
        place.mkdir(parents=True, exist_ok=True)
    for place, picture in pictures.items():
        ok, png = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))
        assert ok
        (place / f"{name}.png").write_bytes(png.tobytes())
    for place, depth in depths.items():
        np.save(place / f"{name}.npy", depth)
