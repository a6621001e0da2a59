"""Cases of views that the user filled in another program."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from expectations import Refuses, case
from field_room import FieldRoom, write_picture

Change = Callable[[np.ndarray], np.ndarray]


def fills(*options: str) -> tuple[str, ...]:
    return ("remove", "--iterations", "2", *options)


FOLDER = ("--fill", "{scene}/fills")


def filled(room: FieldRoom, folder: Path, change: Change, *, suffix: str = ".png", like: int = 1) -> Path:
    """The room with masks, and a filled training view: the photograph `like`, grain in its mask, changed."""
    room.colmap(folder, masks=True)
    name, other = room.names[1], room.names[like]
    wood = np.random.default_rng(1).integers(80, 160, room.pixels[other].shape).astype(np.uint8)
    pixels = np.where(room.masks[other][..., None], wood, room.pixels[other])
    write_picture(folder / "fills" / f"{name}{suffix}", np.ascontiguousarray(change(pixels)))
    return folder


def same(pixels: np.ndarray) -> np.ndarray:
    return pixels


@case(Refuses(("is black; export the filled image again",), fills(*FOLDER)))
def fill_that_is_black(room: FieldRoom, folder: Path) -> Path:
    return filled(room, folder, np.zeros_like)


@case(Refuses(("turned by 180 degrees; turn it back",), fills(*FOLDER)))
def fill_that_stands_on_its_head(room: FieldRoom, folder: Path) -> Path:
    return filled(room, folder, lambda pixels: np.rot90(pixels, 2))


@case(Refuses(("72 x 96 px, which is turned by 90 degrees, but",), fills(*FOLDER)))
def fill_that_lies_on_its_side(room: FieldRoom, folder: Path) -> Path:
    return filled(room, folder, np.rot90)


@case(Refuses(("mirrored left to right; mirror it back",), fills(*FOLDER)))
def fill_that_is_mirrored(room: FieldRoom, folder: Path) -> Path:
    return filled(room, folder, lambda pixels: pixels[:, ::-1])


@case(Refuses(("name it after the view that it shows",), fills(*FOLDER)))
def fill_of_another_view(room: FieldRoom, folder: Path) -> Path:
    return filled(room, folder, same, like=4)


@case(Refuses(("192 x 144 px, but", "export it at that size"), fills(*FOLDER)))
def fill_at_twice_the_size(room: FieldRoom, folder: Path) -> Path:
    return filled(room, folder, lambda pixels: cv2.resize(pixels, None, fx=2.0, fy=2.0))


@case(Refuses(("levels of red, green and blue; export it without changing them",), fills(*FOLDER)))
def fill_with_another_white_balance(room: FieldRoom, folder: Path) -> Path:
    def warm(pixels: np.ndarray) -> np.ndarray:
        return np.clip(pixels * np.array([0.8, 0.8, 0.5]) + 20.0, 0, 255).astype(np.uint8)

    return filled(room, folder, warm)


@case(Refuses(("differs from", "only pixels inside the mask may change"), fills(*FOLDER)))
def fill_that_was_painted_all_over(room: FieldRoom, folder: Path) -> Path:
    """As an image generator returns it: the same room, every pixel new."""

    def repainted(pixels: np.ndarray) -> np.ndarray:
        noise = np.random.default_rng(0).normal(0.0, 90.0, (9, 12, 3)).astype(np.float32)
        return np.clip(pixels + cv2.resize(noise, pixels.shape[1::-1]), 0, 255).astype(np.uint8)

    return filled(room, folder, repainted)


@case(Refuses(("fills", "holds no images"), fills(*FOLDER)))
def fills_in_an_empty_folder(room: FieldRoom, folder: Path) -> Path:
    (room.colmap(folder, masks=True) / "fills").mkdir()
    return folder


@case(Refuses(("mine.png: there is no view mine",), fills(*FOLDER)))
def fill_of_no_view(room: FieldRoom, folder: Path) -> Path:
    path = next((filled(room, folder, same) / "fills").iterdir())
    path.rename(path.with_name("mine.png"))
    return folder


@case(Refuses(("broken.png",), fills("--fill", "{scene}/fills/broken.png")))
def fill_without_the_name_of_a_view(room: FieldRoom, folder: Path) -> Path:
    room.colmap(folder, masks=True)
    write_picture(folder / "fills" / "broken.png", np.zeros((72, 96, 3), np.uint8))
    return folder


@case(Refuses((".png",), fills(*FOLDER)))
def fill_that_is_cut_short(room: FieldRoom, folder: Path) -> Path:
    path = next((filled(room, folder, same) / "fills").iterdir())
    path.write_bytes(path.read_bytes()[:400])
    return folder


@case(Refuses(("is filled twice",), fills(*FOLDER, "--fill", "{scene}/again")))
def view_that_is_filled_twice(room: FieldRoom, folder: Path) -> Path:
    filled(room, folder, same)
    write_picture(folder / "again" / f"{room.names[1]}.png", room.pixels[room.names[1]])
    return folder


@case(Refuses(("with the object still there; give the image without it",), fills(*FOLDER)))
def fill_that_is_the_photograph(room: FieldRoom, folder: Path) -> Path:
    return filled(room, folder, lambda _: room.pixels[room.names[1]], suffix=".jpg")


@case(Refuses(("one colour fills its mask; give the image with the hole filled",), fills(*FOLDER)))
def fill_with_a_black_hole(room: FieldRoom, folder: Path) -> Path:
    mask = room.masks[room.names[1]]
    return filled(room, folder, lambda pixels: np.where(mask[..., None], np.uint8(0), pixels))
