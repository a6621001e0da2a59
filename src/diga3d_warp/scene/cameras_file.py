"""Cameras of a run as JSON: the file that 3DGS viewers read, with a few keys more so that nothing is lost.

The original 3DGS writes one entry an image: id, img_name, width, height, position (camera centre), rotation
(camera to world, rows), fx, fy. Added here: cx, cy, distortion and split ("train" or "test"). A file without
them is read as pinhole training cameras with a centred principal point.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.files import read_json, write_json
from diga3d_warp.scene.camera import Camera, Distortion
from diga3d_warp.scene.scene import Scene


@dataclass(frozen=True)
class CameraSet:
    """Cameras by image name without ending.

    Attributes:
        train: Cameras of the fitted views.
        test: Cameras of the held-out views.
    """

    train: Mapping[str, Camera]
    test: Mapping[str, Camera] = field(default_factory=dict)

    @classmethod
    def of(cls, scene: Scene) -> CameraSet:
        """The cameras of a scene's views."""
        return cls(
            {view.name: view.camera for view in scene.views},
            {view.name: view.camera for view in scene.test_views},
        )


def save_cameras(path: Path, cameras: CameraSet) -> None:
    """Write the file, whole or not at all."""
    entries: list[dict[str, Any]] = []
    for split, group in (("train", cameras.train), ("test", cameras.test)):
        for name, camera in group.items():
            entries.append({"id": len(entries), "img_name": name, **_entry(camera), "split": split})
    write_json(path, entries)


def load_cameras(path: Path) -> CameraSet:
    """Read the file, or one written by 3DGS itself.

    Raises:
        InputError: the file is absent, not JSON, or an entry lacks a key or describes no camera.
    """
    remedy = "write it again with `diga3d fit`, or take the one that 3DGS training wrote"
    entries = read_json(path, remedy)
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{path} holds no list of cameras: {remedy}")
    groups: dict[str, dict[str, Camera]] = {"train": {}, "test": {}}
    for index, entry in enumerate(entries):
        try:
            groups[entry.get("split", "train")][str(entry["img_name"])] = _camera(entry)
        except KeyError as error:
            raise InputError(f"{path}, entry {index}: {error} is missing or unknown: {remedy}") from error
        except (TypeError, ValueError, AttributeError) as error:
            raise InputError(f"{path}, entry {index} is not a camera ({error}): {remedy}") from error
    return CameraSet(**groups)


def _entry(camera: Camera) -> dict[str, Any]:
    lens = camera.distortion
    return {
        "width": camera.width,
        "height": camera.height,
        "position": camera.center.tolist(),
        "rotation": camera.pose[:3, :3].T.tolist(),
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "distortion": lens and {"kind": lens.kind, "coefficients": list(lens.coefficients)},
    }


def _camera(entry: dict[str, Any]) -> Camera:
    rotation = np.asarray(entry["rotation"], np.float64).T
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ np.asarray(entry["position"], np.float64)
    lens = entry.get("distortion")
    width, height = int(entry["width"]), int(entry["height"])
    return Camera(
        width=width,
        height=height,
        fx=float(entry["fx"]),
        fy=float(entry["fy"]),
        cx=float(entry.get("cx", width / 2)),
        cy=float(entry.get("cy", height / 2)),
        world_to_camera=torch.from_numpy(pose),
        distortion=Distortion(lens["kind"], tuple(lens["coefficients"])) if lens else None,
    )
