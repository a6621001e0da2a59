"""A small capture of a synthetic room, and its files in the layouts that people bring."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from diga3d_warp.gaussians.initialise import initialise
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.colmap.reconstruction import write_colmap
from diga3d_warp.scene.layouts.cameras_file import CameraSet, save_cameras
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.scene import Points
from diga3d_warp.scene.synthetic.generate import SyntheticScene, generate

VIEWS, WIDTH, HEIGHT = 8, 96, 72
POINTS = 600


@dataclass(frozen=True, eq=False)
class FieldRoom:
    """What is true of the capture, in metres, and writers of its files.

    Attributes:
        cameras: Pinhole cameras by image name without ending, in sorted order.
        pixels: Photographs, (H, W, 3), uint8 RGB.
        masks: True on the object, (H, W).
        points: Sparse points.
    """

    cameras: Mapping[str, Camera]
    pixels: Mapping[str, np.ndarray]
    masks: Mapping[str, np.ndarray]
    points: Points

    @property
    def names(self) -> list[str]:
        return list(self.cameras)

    def write_images(self, folder: Path, suffix: str = ".jpg") -> None:
        """The photographs as `folder`/NAME`suffix`."""
        for name, pixels in self.pixels.items():
            write_picture(folder / f"{name}{suffix}", pixels)

    def write_masks(self, folder: Path) -> None:
        """The masks as `folder`/NAME.png, 255 on the object."""
        for name, mask in self.masks.items():
            write_picture(folder / f"{name}.png", mask.astype(np.uint8) * 255)

    def colmap(self, folder: Path, *, masks: bool = False) -> Path:
        """images/*.jpg and sparse/0 in COLMAP's binary form."""
        self.write_images(folder / "images")
        write_colmap(folder, self.cameras, self.points, suffix=".jpg")
        if masks:
            self.write_masks(folder / "masks")
        return folder

    def colmap_text(self, folder: Path, sparse: str = "sparse/0", *, masks: bool = False) -> Path:
        """images/*.jpg and a reconstruction in COLMAP's text form, in the folder `sparse`."""
        import pycolmap

        self.colmap(folder, masks=masks)
        binary = folder / "sparse" / "0"
        reconstruction = pycolmap.Reconstruction(binary)
        for file in binary.iterdir():
            file.unlink()
        target = folder / sparse
        target.mkdir(parents=True, exist_ok=True)
        reconstruction.write_text(target)
        for extra in (target / "rigs.txt", target / "frames.txt"):
            extra.unlink(missing_ok=True)
        for empty in (binary, binary.parent):
            if empty.is_dir() and not any(empty.iterdir()):
                empty.rmdir()
        return folder

    def transforms(self) -> dict[str, Any]:
        """The contents of nerfstudio's transforms.json, intrinsics in each frame."""
        frames = []
        for name, camera in self.cameras.items():
            pose = np.linalg.inv(np.asarray(camera.pose)) @ np.diag([1.0, -1.0, -1.0, 1.0])
            size = {"w": camera.width, "h": camera.height}
            lens = {"fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy}
            file = {"file_path": f"images/{name}.jpg", "transform_matrix": pose.tolist()}
            frames.append({**file, **size, **lens})
        return {"frames": frames, "ply_file_path": "sparse_pc.ply"}

    def nerfstudio(self, folder: Path, contents: Mapping[str, Any] | None = None) -> Path:
        """images/*.jpg, transforms.json and sparse_pc.ply; other `contents` of transforms.json if given."""
        import trimesh

        self.write_images(folder / "images")
        trimesh.PointCloud(self.points.positions, self.points.colors).export(folder / "sparse_pc.ply")
        (folder / "transforms.json").write_text(json.dumps(contents or self.transforms()), encoding="utf-8")
        return folder

    def splat(self, folder: Path) -> Path:
        """images/*.jpg, cameras.json and point_cloud.ply: the points as gaussians."""
        self.write_images(folder / "images")
        initialise(self.points).save_ply(folder / "point_cloud.ply")
        save_cameras(folder / "cameras.json", CameraSet(self.cameras))
        return folder


def write_picture(path: Path, pixels: np.ndarray) -> None:
    """An image file of any format that OpenCV writes, its folder made if missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    encoded, data = cv2.imencode(path.suffix, pixels[..., ::-1] if pixels.ndim == 3 else pixels)
    assert encoded
    path.write_bytes(data.tobytes())  # imwrite takes no path beyond ASCII on every system


def make_room(folder: Path) -> FieldRoom:
    """Render the room once; `folder` is scratch space."""
    capture = generate(SyntheticScene(width=WIDTH, height=HEIGHT, views=VIEWS), folder / "room")
    scene = load_scene(capture, hold_out=0)
    chosen = np.linspace(0, len(scene.points) - 1, POINTS).astype(int)
    points = Points(scene.points.positions[chosen], scene.points.colors[chosen])
    views = {view.name: view for view in scene.views}
    return FieldRoom(
        cameras={name: view.camera for name, view in views.items()},
        pixels={name: view.pixels for name, view in views.items()},
        masks={name: view.mask for name, view in views.items() if view.mask is not None},
        points=points,
    )
