"""Cameras of a run as JSON: the cameras.json of 3DGS viewers, with further keys for lens, centre and split.

The original 3DGS writes one entry an image: id, img_name, width, height, position (camera centre), rotation
(camera to world, rows), fx, fy. Added here: cx, cy, distortion, near (the near plane) and split ("train" or
"test"). A file without them is read as pinhole training cameras with a centred principal point.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from diga3d_warp.config import SPLATTING
from diga3d_warp.errors import InputError
from diga3d_warp.files import read_json, write_json
from diga3d_warp.scene.camera import Camera, Distortion
from diga3d_warp.scene.layouts.entries import Entries, abridged
from diga3d_warp.scene.poses import world_to_camera
from diga3d_warp.scene.scene import Scene

# Lens coefficients as other programs name them; here a lens is an entry of its own.
_COEFFICIENTS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")


@dataclass(frozen=True)
class CameraSet:
    """Cameras by image name without ending.

    Attributes:
        train: Cameras of the fitted views.
        test: Cameras of the held-out views.
        split: Whether it is known which views were held out; files of 3DGS itself do not say.
    """

    train: Mapping[str, Camera]
    test: Mapping[str, Camera] = field(default_factory=dict)
    split: bool = True

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
            if not isinstance(entry, dict):
                raise InputError(f"it is {abridged(entry)}")
            name, split, camera = _camera(Entries(entry))
        except InputError as error:
            raise InputError(f"{path}, entry {index} is not a camera ({error}): {remedy}") from error
        if any(name in group for group in groups.values()):
            raise InputError(
                f"{path}: two cameras are called {name}: 3DGS leaves out folders; write the path of each "
                "image below the image folder as its img_name"
            )
        groups[split][name] = camera
    return CameraSet(**groups, split=any(entry.get("split") is not None for entry in entries))


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
        "near": camera.near,
        "distortion": lens and {"kind": lens.kind, "coefficients": list(lens.coefficients)},
    }


def _camera(entry: Entries) -> tuple[str, str, Camera]:
    """Name, split and camera of an entry."""
    name = entry.get("img_name")
    if isinstance(name, bool) or not isinstance(name, (str, int)) or name == "":
        raise InputError(f"img_name is {abridged(name)}, not a name")
    split = entry.text("split") or "train"
    if split not in ("train", "test"):
        raise InputError(f"split is {abridged(split)}, neither 'train' nor 'test'")
    rotation, position = entry.table("rotation"), entry.table("position")
    if rotation.shape not in ((3, 3), (9,)) or position.shape != (3,):
        raise InputError(f"rotation and position have shapes {rotation.shape} and {position.shape}")
    for coefficient in _COEFFICIENTS:
        if entry.number(coefficient):
            raise InputError(f"{coefficient} is {entry.number(coefficient):g}, but 3DGS cameras have no lens")
    width, height = round(entry.needed("width")), round(entry.needed("height"))
    cx, cy, near = (entry.number(key) for key in ("cx", "cy", "near"))
    camera = Camera(
        width=width,
        height=height,
        fx=entry.needed("fx"),
        fy=entry.needed("fy"),
        cx=width / 2 if cx is None else cx,
        cy=height / 2 if cy is None else cy,
        world_to_camera=torch.from_numpy(world_to_camera(rotation.reshape(3, 3), position)),
        distortion=_lens(entry.get("distortion")),
        near=SPLATTING.near if near is None else near,
    )
    return str(name), split, camera


def _lens(lens: Any) -> Distortion | None:
    if lens is None:
        return None
    if not isinstance(lens, dict):
        raise InputError(f"distortion is {abridged(lens)}, not a kind with coefficients")
    entries = Entries(lens)
    kind: Any = entries.text("kind")
    return Distortion(kind, tuple(entries.table("coefficients").ravel().tolist()))
