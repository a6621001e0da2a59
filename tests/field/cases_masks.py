"""Cases of masks, orientation and photographs."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from expectations import Reads, Refuses, case
from field_room import FieldRoom, write_picture
from PIL import Image

from diga3d_warp.scene.scene import Scene

REMOVE = ("remove", "--iterations", "2")


def masks_of(scene: Scene) -> dict[str, np.ndarray | None]:
    return {view.name: view.mask for view in [*scene.views, *scene.test_views]}


def the_object(tolerance: float = 0.004) -> Callable[[Scene, FieldRoom], None]:
    """The masks are those of the room, but for a part of the pixels."""

    def check(scene: Scene, room: FieldRoom) -> None:
        for name, mask in masks_of(scene).items():
            assert mask is not None, name
            assert (off := (mask != room.masks[name]).mean()) <= tolerance, (name, off)

    return check


def no_masks(scene: Scene, room: FieldRoom) -> None:
    assert all(mask is None for mask in masks_of(scene).values())


def with_masks(
    room: FieldRoom, folder: Path, change: Callable[[np.ndarray], np.ndarray], suffix=".png"
) -> Path:
    """The room in COLMAP's form, with masks 0 and 255 that are changed before they are stored."""
    room.colmap(folder)
    for name, mask in room.masks.items():
        write_picture(folder / "masks" / f"{name}{suffix}", change(mask.astype(np.uint8) * 255))
    return folder


def numbers(mask: np.ndarray) -> np.ndarray:
    """The object as number 2, beside two more."""
    plane = np.where(mask > 0, 2, 0).astype(np.uint8)
    plane[2:14, 2:20] = np.where(plane[2:14, 2:20] > 0, 2, 1)
    plane[-14:-2, -20:-2] = np.where(plane[-14:-2, -20:-2] > 0, 2, 3)
    return plane


def all_three(scene: Scene, room: FieldRoom) -> None:
    for name, mask in masks_of(scene).items():
        np.testing.assert_array_equal(mask, numbers(room.masks[name]) > 0)


SEVERAL = ("the masks hold objects 1 (", ", 2 (", ", 3 (", "choose with --mask-ids")


@case(Reads(notes=SEVERAL, also=all_three))
def masks_of_several_objects(room: FieldRoom, folder: Path) -> Path:
    return with_masks(room, folder, numbers)


@case(Reads(load={"mask_ids": (2,)}, also=the_object(0.0)))
def masks_of_several_objects_and_a_choice(room: FieldRoom, folder: Path) -> Path:
    return with_masks(room, folder, numbers)


@case(Refuses(("no mask holds object 9: the masks hold 1 (",), (*REMOVE, "--mask-ids", "2,9")))
def masks_of_several_objects_and_a_wrong_choice(room: FieldRoom, folder: Path) -> Path:
    return with_masks(room, folder, numbers)


@case(Reads(notes=("label 255 is taken for pixels to ignore",), also=the_object(0.0)))
def masks_with_255_to_ignore(room: FieldRoom, folder: Path) -> Path:
    def change(mask: np.ndarray) -> np.ndarray:
        plane = np.where(mask > 0, 1, 0).astype(np.uint8)
        plane[:4] = np.where(plane[:4] > 0, 1, 255)
        return plane

    return with_masks(room, folder, change)


@case(Reads(also=the_object(0.02)))
def masks_dim_and_soft_as_jpeg(room: FieldRoom, folder: Path) -> Path:
    return with_masks(room, folder, lambda mask: cv2.GaussianBlur(mask, (0, 0), 1.5) // 5 * 2, ".jpg")


@case(Reads(also=the_object(0.0)))
def masks_as_alpha(room: FieldRoom, folder: Path) -> Path:
    room.colmap(folder)
    for name, mask in room.masks.items():
        planes = np.dstack([room.pixels[name][..., ::-1], mask.astype(np.uint8) * 255])
        (folder / "masks").mkdir(exist_ok=True)
        (folder / "masks" / f"{name}.png").write_bytes(cv2.imencode(".png", planes)[1].tobytes())
    return folder


@case(Reads(also=the_object(0.0)))
def masks_of_one_bit(room: FieldRoom, folder: Path) -> Path:
    room.colmap(folder)
    (folder / "masks").mkdir()
    for name, mask in room.masks.items():
        Image.fromarray(mask).convert("1").save(folder / "masks" / f"{name}.png")
    return folder


@case(Reads(also=the_object(0.03)))
def masks_of_another_size(room: FieldRoom, folder: Path) -> Path:
    return with_masks(room, folder, lambda mask: cv2.resize(mask, (144, 109)))


def painted(room: FieldRoom, folder: Path) -> Path:
    room.colmap(folder)
    for name, mask in room.masks.items():
        over = np.where(mask[..., None], np.array([255, 0, 0], np.uint8), room.pixels[name])
        write_picture(folder / "masks" / f"{name}.jpg", over)
    return folder


@case(Refuses(("view_000.jpg: not a mask but a picture", "an overlay"), REMOVE))
def masks_painted_over_photographs(room: FieldRoom, folder: Path) -> Path:
    return painted(room, folder)


@case(Reads(notes=("masks are not used: ", "not a mask but a picture"), also=no_masks))
def masks_painted_over_photographs_to_fit(room: FieldRoom, folder: Path) -> Path:
    return painted(room, folder)


@case(Refuses(("as if inverted; make the object white",), REMOVE))
def masks_inverted(room: FieldRoom, folder: Path) -> Path:
    return with_masks(room, folder, lambda mask: 255 - mask)


@case(Reads(notes=("masks are not used: ", "as if inverted"), also=no_masks))
def masks_nearly_white_to_fit(room: FieldRoom, folder: Path) -> Path:
    def change(mask: np.ndarray) -> np.ndarray:
        plane = np.full_like(mask, 255)
        plane[30:36, 40:46] = 0
        return plane

    return with_masks(room, folder, change)


@case(Reads(notes=("there are no mask images in this folder",), also=no_masks))
def masks_folder_empty_to_fit(room: FieldRoom, folder: Path) -> Path:
    (folder / "masks").mkdir()
    return room.colmap(folder)


@case(Refuses(("masks: there are no mask images in this folder",), REMOVE))
def masks_folder_empty(room: FieldRoom, folder: Path) -> Path:
    (folder / "masks").mkdir()
    return room.colmap(folder)


@case(Reads(notes=("masks are matched by a part of their names",), also=the_object(0.0)))
def masks_with_an_addition_to_their_names(room: FieldRoom, folder: Path) -> Path:
    with_masks(room, folder, lambda mask: mask)
    for file in sorted((folder / "masks").iterdir()):
        file.rename(file.with_name(f"{file.stem}_mask.png"))
    return folder


@case(Reads(notes=("masks are not used: ", "no mask has the name of an image"), also=no_masks))
def masks_of_other_names_to_fit(room: FieldRoom, folder: Path) -> Path:
    with_masks(room, folder, lambda mask: mask)
    for number, file in enumerate(sorted((folder / "masks").iterdir())):
        file.rename(file.with_name(f"object {number}.png"))
    return folder


def in_two_folders(room: FieldRoom, folder: Path, masks: Callable[[int], str]) -> Path:
    """The room as front/000000 and so on and back/000000 and so on; masks named by their number."""
    from diga3d_warp.scene.colmap.reconstruction import write_colmap

    half = len(room.names) // 2
    named = {name: f"{'front' if i < half else 'back'}/{i % half:06d}" for i, name in enumerate(room.names)}
    for name, path in named.items():
        write_picture(folder / "images" / f"{path}.jpg", room.pixels[name])
    write_colmap(folder, {named[name]: room.cameras[name] for name in room.names}, room.points, suffix=".jpg")
    for number, name in enumerate(room.names):
        write_picture(folder / "masks" / f"{masks(number)}.png", room.masks[name].astype(np.uint8) * 255)
    return folder


@case(Refuses(("000000.png: the images back/000000 and front/000000 both have the name",), REMOVE))
def masks_by_basename_of_photographs_in_folders(room: FieldRoom, folder: Path) -> Path:
    return in_two_folders(room, folder, lambda number: f"{number % (len(room.names) // 2):06d}")


@case(Reads(also=the_object(0.0)))
def masks_named_by_transforms(room: FieldRoom, folder: Path) -> Path:
    contents = room.transforms()
    for frame in contents["frames"]:
        frame["mask_path"] = frame["file_path"].replace("images/", "segmentation/").replace(".jpg", ".png")
    room.write_masks(folder / "segmentation")
    return room.nerfstudio(folder, contents)


@case(Refuses(("as if inverted",), REMOVE))
def masks_named_by_transforms_for_training(room: FieldRoom, folder: Path) -> Path:
    """nerfstudio's masks are black on what training leaves out."""
    contents = room.transforms()
    for frame in contents["frames"]:
        frame["mask_path"] = frame["file_path"].replace("images/", "masks/").replace(".jpg", ".png")
    for name, mask in room.masks.items():
        write_picture(folder / "masks" / f"{name}.png", np.where(mask, 0, 255).astype(np.uint8))
    return room.nerfstudio(folder, contents)


def write_turned(path: Path, pixels: np.ndarray, orientation: int) -> None:
    """A JPEG that viewers turn by an EXIF orientation."""
    image = Image.fromarray(np.ascontiguousarray(pixels))
    exif = image.getexif()
    exif[0x0112] = orientation
    path.parent.mkdir(parents=True, exist_ok=True)
    buffer = io.BytesIO()
    image.save(buffer, format="JPEG", quality=95, exif=exif)
    path.write_bytes(buffer.getvalue())


def exif(room: FieldRoom, folder: Path, orientation: int, *, upright: bool, masks: bool = False) -> Path:
    """The room with an EXIF orientation: stored turned and calibrated upright, or calibrated as stored."""
    room.colmap(folder, masks=masks)
    for name, pixels in room.pixels.items():
        stored = np.rot90(pixels, {1: 0, 3: 2, 6: 1, 8: -1}[orientation]) if upright else pixels
        write_turned(folder / "images" / f"{name}.jpg", stored, orientation)
    return folder


@case(Reads(notes=("8 photographs are turned upright by their EXIF orientation, as the sparse points ask",)))
def exif_180_calibrated_upright(room: FieldRoom, folder: Path) -> Path:
    return exif(room, folder, 3, upright=True)


@case(Reads())
def exif_180_calibrated_as_stored(room: FieldRoom, folder: Path) -> Path:
    return exif(room, folder, 3, upright=False)


@case(Reads(notes=("as the size of their calibration asks",), also=the_object(0.0)))
def exif_90_calibrated_upright(room: FieldRoom, folder: Path) -> Path:
    return exif(room, folder, 6, upright=True, masks=True)


@case(Reads(also=the_object(0.0)))
def exif_90_calibrated_as_stored(room: FieldRoom, folder: Path) -> Path:
    return exif(room, folder, 8, upright=False, masks=True)


@case(Reads(also=the_object(0.0)))
def exif_90_with_masks_made_upright(room: FieldRoom, folder: Path) -> Path:
    exif(room, folder, 6, upright=False)
    for name, mask in room.masks.items():
        write_picture(folder / "masks" / f"{name}.png", np.rot90(mask, -1).astype(np.uint8) * 255)
    return folder


@case(
    Reads(
        notes=("their masks are taken to be made on them as shown: so their outlines fit",),
        also=the_object(0.0),
    )
)
def exif_180_with_masks_made_upright(room: FieldRoom, folder: Path) -> Path:
    exif(room, folder, 3, upright=False)
    for name, mask in room.masks.items():
        write_picture(folder / "masks" / f"{name}.png", np.rot90(mask, 2).astype(np.uint8) * 255)
    return folder


@case(Reads(also=the_object(0.0)))
def exif_180_with_masks_as_stored(room: FieldRoom, folder: Path) -> Path:
    return exif(room, folder, 3, upright=False, masks=True)


@case(Refuses(("view_000: 96 x 72 px as read, also turned by its EXIF orientation 6",)))
def exif_90_with_another_calibration(room: FieldRoom, folder: Path) -> Path:
    contents = room.transforms()
    for frame in contents["frames"]:
        frame["w"], frame["h"] = 90, 90
    room.nerfstudio(folder, contents)
    for name, pixels in room.pixels.items():
        write_turned(folder / "images" / f"{name}.jpg", pixels, 6)
    return folder


@case(Reads(views=7, notes=("left out: ", "30000 x 30000 px; images of more than 250 million pixels")))
def photograph_that_is_a_decompression_bomb(room: FieldRoom, folder: Path) -> Path:
    import struct
    import zlib

    contents = room.transforms()
    contents["frames"][2]["file_path"] = "images/bomb.png"
    room.nerfstudio(folder, contents)
    parts = [b"\x89PNG\r\n\x1a\n"]
    head = struct.pack(">IIBBBBB", 30000, 30000, 8, 2, 0, 0, 0)
    for kind, data in ((b"IHDR", head), (b"IDAT", zlib.compress(bytes(1000))), (b"IEND", b"")):
        parts.append(struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)))
    (folder / "images" / "bomb.png").write_bytes(b"".join(parts))
    return folder


@case(Refuses(("the file is HEIC, which is not read; convert it to .jpg or .png",)))
def photographs_that_are_heic_by_content(room: FieldRoom, folder: Path) -> Path:
    room.colmap(folder)
    for file in (folder / "images").iterdir():
        file.write_bytes(b"\0\0\0\x18ftypheic\0\0\0\0mif1heic" + bytes(100))
    return folder


def as_tiff(room: FieldRoom, folder: Path, change: Callable[[np.ndarray], np.ndarray]) -> Path:
    contents = room.transforms()
    room.nerfstudio(folder, contents)
    for frame in contents["frames"]:
        old = folder / frame["file_path"]
        old.unlink()
        frame["file_path"] = frame["file_path"].replace(".jpg", ".tif")
        write_picture(folder / frame["file_path"], change(room.pixels[old.stem]))
    (folder / "transforms.json").write_text(json.dumps(contents))
    return folder


@case(Reads())
def photographs_as_float_tiff(room: FieldRoom, folder: Path) -> Path:
    return as_tiff(room, folder, lambda pixels: pixels.astype(np.float32) / 255)


@case(Reads())
def photographs_as_16_bit_tiff(room: FieldRoom, folder: Path) -> Path:
    return as_tiff(room, folder, lambda pixels: pixels.astype(np.uint16) * 257)


BOX = ("--mask-box", "view_001")


@case(
    Refuses(
        ("mask box 0 0 97 72 of view 'view_001' is not within its 96 x 72 px",),
        (*REMOVE, *BOX, *["0", "0", "97", "72"]),
    )
)
def mask_box_outside_of_the_photograph(room: FieldRoom, folder: Path) -> Path:
    return room.colmap(folder)


@case(Refuses(("give X0 Y0 X1 Y1 with 0 <= X0 < X1 <= 96",), (*REMOVE, *BOX, *["40", "50", "20", "10"])))
def mask_box_with_its_corners_reversed(room: FieldRoom, folder: Path) -> Path:
    return room.colmap(folder)


@case(
    Refuses(
        ("--mask-ids chooses among the objects in masks",),
        (*REMOVE, *BOX, *["1", "1", "9", "9"], "--mask-ids", "3"),
    )
)
def mask_box_and_mask_ids(room: FieldRoom, folder: Path) -> Path:
    return room.colmap(folder)
