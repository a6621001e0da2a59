"""Cases of the field's data sets: photographs without the object in their own places."""

from __future__ import annotations

from pathlib import Path

from expectations import Reads, case
from field_room import FieldRoom

from diga3d_warp.scene.scene import Scene


def without_object(scene: Scene, room: FieldRoom) -> None:
    """The first two views are those without the object."""
    assert scene.ground_truth
    assert [view.name.removeprefix("test_") for view in scene.test_views] == room.names[:2]


def with_masks(scene: Scene, room: FieldRoom) -> None:
    without_object(scene, room)
    assert all(view.mask is not None and view.mask.any() for view in scene.views)


@case(Reads(notes=("the layout of 360-USID: test views are those of test_images",), also=with_masks))
def data_set_360_usid(room: FieldRoom, folder: Path) -> Path:
    room.colmap(folder)
    (folder / "test_images").mkdir()
    for name in room.names[:2]:
        (folder / "images" / f"{name}.jpg").rename(folder / "test_images" / f"{name}.jpg")
    room.write_masks(folder / "object_masks")
    for name in room.names[:2]:
        (folder / "object_masks" / f"{name}.png").unlink()
    return folder


@case(Reads(notes=("the layout of Inpaint360GS: test views are those called test_*",), also=without_object))
def data_set_inpaint360gs(room: FieldRoom, folder: Path) -> Path:
    room.colmap_text(folder)
    images = folder / "sparse" / "0" / "images.txt"
    for name in room.names[:2]:
        (folder / "images" / f"{name}.jpg").rename(folder / "images" / f"test_{name}.jpg")
        text = images.read_text(encoding="utf-8")
        images.write_text(text.replace(f"{name}.jpg", f"test_{name}.jpg"), encoding="utf-8")
    return folder
