"""Cases of camera files: lens, poses, sizes, text."""

from __future__ import annotations

import codecs
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from expectations import Reads, Refuses, case
from field_room import FieldRoom

from diga3d_warp.scene.camera import Distortion
from diga3d_warp.scene.scene import Scene


def has_lens(*lenses: Distortion | None) -> Callable[[Scene, FieldRoom], None]:
    """The assertion that each view has one of some lenses, and that all of them occur."""

    def check(scene: Scene, room: FieldRoom) -> None:
        assert {view.camera.distortion for view in [*scene.views, *scene.test_views]} == set(lenses)

    return check


def with_entries(room: FieldRoom, folder: Path, **entries: Any) -> Path:
    """transforms.json with further entries for all frames; those that are ... are taken out of the frames."""
    contents = room.transforms()
    for name, value in entries.items():
        if value is ...:
            for frame in contents["frames"]:
                frame.pop(name, None)
        else:
            contents[name] = value
    return room.nerfstudio(folder, contents)


def of_each(room: FieldRoom, folder: Path, change: Callable[[dict], None]) -> Path:
    """transforms.json with each frame changed."""
    contents = room.transforms()
    for frame in contents["frames"]:
        change(frame)
    return room.nerfstudio(folder, contents)


@case(Reads(also=has_lens(Distortion("fisheye", (-0.003, 0.001, 0.0, 0.0)))))
def ngp_fisheye(room: FieldRoom, folder: Path) -> Path:
    return with_entries(room, folder, is_fisheye=True, k1=-0.003, k2=0.001, k3=0.0, k4=0.0)


@case(Reads(also=has_lens(Distortion("fisheye", (0.001, 0.0, 0.001, 0.001)))))
def ngp_fisheye_with_k3_and_k4(room: FieldRoom, folder: Path) -> Path:
    return with_entries(room, folder, is_fisheye=True, k1=0.001, k2=0, k3=0.001, k4=0.001)


@case(Reads(notes=("lens coefficients are given though camera_model is PINHOLE",),
            also=has_lens(Distortion("brown", (-0.002, 0.0, 0.0, 0.0)))))  # fmt: skip
def pinhole_with_k1(room: FieldRoom, folder: Path) -> Path:
    return with_entries(room, folder, camera_model="PINHOLE", k1=-0.002)


@case(Reads(also=has_lens(Distortion("brown5", (0.001, -0.002, 0.0, 0.0, 0.001)))))
def metashape_transforms_with_k3(room: FieldRoom, folder: Path) -> Path:
    lens = {"k1": 0.001, "k2": -0.002, "k3": 0.001, "k4": 0.0, "p1": 0.0, "p2": 0.0}
    return with_entries(room, folder, camera_model="OPENCV", **lens)


@case(Reads(also=has_lens(Distortion("brown", (0.001, 0.0, 0.0, 0.0)), Distortion("fisheye", (0.0,) * 4))))
def camera_model_of_each_frame(room: FieldRoom, folder: Path) -> Path:
    contents = room.transforms()
    for number, frame in enumerate(contents["frames"]):
        frame |= {"camera_model": "FISHEYE"} if number % 2 else {"camera_model": "OPENCV", "k1": 0.001}
    return room.nerfstudio(folder, contents)


@case(Refuses(("transforms.json", "k4 is supported for fisheye lenses only", "undistort")))
def opencv_with_k4(room: FieldRoom, folder: Path) -> Path:
    return with_entries(room, folder, camera_model="OPENCV", k1=0.1, k4=0.05)


@case(Refuses(("transforms.json", "b2 is 1.5", "undistort")))
def metashape_skew(room: FieldRoom, folder: Path) -> Path:
    return with_entries(room, folder, k1=0.01, b1=0.0, b2=1.5)


@case(Refuses(("transforms.json", "'EQUIRECTANGULAR' is not supported")))
def panoramas(room: FieldRoom, folder: Path) -> Path:
    return with_entries(room, folder, camera_model="EQUIRECTANGULAR")


@case(Reads(notes=("rolling_shutter is not followed",)))
def rolling_shutter(room: FieldRoom, folder: Path) -> Path:
    return with_entries(room, folder, rolling_shutter=[0.0, 0.0, 0.02, 0.0])


@case(Reads(notes=("entries that are not read: distortion_map",)))
def distortion_map_of_each_frame(room: FieldRoom, folder: Path) -> Path:
    return of_each(room, folder, lambda frame: frame.update(distortion_map="maps/0.npy"))


def angles(frame: dict) -> None:
    frame["camera_angle_x"] = 2 * math.atan(0.5 * frame["w"] / frame.pop("fl_x"))
    frame["camera_angle_y"] = 2 * math.atan(0.5 * frame["h"] / frame.pop("fl_y"))
    for name in ("w", "h", "cx", "cy"):
        del frame[name]


@case(Reads())
def angles_only(room: FieldRoom, folder: Path) -> Path:
    return of_each(room, folder, angles)


@case(Reads(notes=("fl_x and camera_angle_x disagree: fl_x is used",)))
def angle_that_disagrees(room: FieldRoom, folder: Path) -> Path:
    return of_each(room, folder, lambda frame: frame.update(camera_angle_x=0.3))


@case(Refuses(("4 x 3 px are too few to fit", "use --image-scale 0.15 or more"),
              command=("fit", "--iterations", "2", "--image-scale", "0.04")))  # fmt: skip
def image_scale_far_too_small(room: FieldRoom, folder: Path) -> Path:
    return room.nerfstudio(folder)


@case(Reads())
def sizes_as_text(room: FieldRoom, folder: Path) -> Path:
    return of_each(room, folder, lambda frame: frame.update(w=f"{frame['w']}.0", h=f"{frame['h']}.0"))


@case(Reads())
def principal_point_null(room: FieldRoom, folder: Path) -> Path:
    return of_each(room, folder, lambda frame: frame.update(cx=None, cy=None))


@case(Refuses(("transforms.json", "frame 0", "fl_x is 'wide', not a number")))
def focal_length_as_a_word(room: FieldRoom, folder: Path) -> Path:
    return of_each(room, folder, lambda frame: frame.update(fl_x="wide"))


@case(Reads())
def matrices_of_three_rows(room: FieldRoom, folder: Path) -> Path:
    return of_each(room, folder, lambda frame: frame["transform_matrix"].pop())


@case(Reads(notes=("the rotations of transform_matrix hold a scale",)))
def matrices_with_a_scale(room: FieldRoom, folder: Path) -> Path:
    def scale(frame: dict) -> None:
        frame["transform_matrix"] = (np.array(frame["transform_matrix"]) * [0.3, 0.3, 0.3, 1.0]).tolist()

    return of_each(room, folder, scale)


@case(Refuses(("transforms.json", "frame 0", "it is transposed")))
def matrices_transposed(room: FieldRoom, folder: Path) -> Path:
    def transpose(frame: dict) -> None:
        frame["transform_matrix"] = np.array(frame["transform_matrix"]).T.tolist()

    return of_each(room, folder, transpose)


@case(Refuses(("transforms.json", "frame 0", "mirror image")))
def matrices_mirrored(room: FieldRoom, folder: Path) -> Path:
    def mirror(frame: dict) -> None:
        frame["transform_matrix"] = (np.array(frame["transform_matrix"]) * [-1.0, 1.0, 1.0, 1.0]).tolist()

    return of_each(room, folder, mirror)


def edited(room: FieldRoom, folder: Path, stem: str, change: Callable[[str], str | bytes]) -> Path:
    """A COLMAP scene in text form with one file changed."""
    path = room.colmap_text(folder) / "sparse" / "0" / f"{stem}.txt"
    changed = change(path.read_text())
    path.write_bytes(changed if isinstance(changed, bytes) else changed.encode())
    return folder


def image_lines(text: str) -> list[str]:
    return [line for line in text.splitlines() if line.endswith(".jpg")]


@case(Reads())
def images_txt_without_lines_of_observations(room: FieldRoom, folder: Path) -> Path:
    return edited(room, folder, "images", lambda text: "# images\n" + "\n".join(image_lines(text)))


@case(Reads())
def images_txt_with_a_blank_first_line(room: FieldRoom, folder: Path) -> Path:
    return edited(room, folder, "images", lambda text: "\n" + text)


@case(Reads())
def images_txt_with_comments_and_blank_lines_anywhere(room: FieldRoom, folder: Path) -> Path:
    return edited(room, folder, "images", lambda text: "\n# x\n\n\n".join(image_lines(text)))


@case(Refuses(("images.txt", "line 3", "cannot read")))
def images_txt_with_a_damaged_line(room: FieldRoom, folder: Path) -> Path:
    lines = ["# images", "{}", "7 0.5 what"]
    return edited(room, folder, "images", lambda text: "\n".join(lines).format(image_lines(text)[0]))


@case(Reads())
def colmap_text_with_byte_order_marks(room: FieldRoom, folder: Path) -> Path:
    for path in (room.colmap_text(folder) / "sparse" / "0").glob("*.txt"):
        path.write_bytes(codecs.BOM_UTF8 + path.read_bytes())
    return folder


@case(Reads())
def colmap_text_in_utf_16_with_windows_line_ends(room: FieldRoom, folder: Path) -> Path:
    for path in (room.colmap_text(folder) / "sparse" / "0").glob("*.txt"):
        path.write_bytes(path.read_text().replace("\n", "\r\n").encode("utf-16"))
    return folder


def with_float_colors(text: str, scale: float) -> str:
    rows = [line.split() for line in text.splitlines() if not line.startswith("#")]
    return "\n".join(
        " ".join([*row[:4], *(repr(int(c) * scale) for c in row[4:7]), *row[7:]]) for row in rows
    )


def same_colors(scene: Scene, room: FieldRoom) -> None:
    order, own = (np.lexsort(p.positions.T.round(4)) for p in (scene.points, room.points))
    np.testing.assert_allclose(scene.points.colors[order], room.points.colors[own], atol=1)


@case(Reads(also=same_colors))
def points3d_txt_with_colours_as_floats(room: FieldRoom, folder: Path) -> Path:
    return edited(room, folder, "points3D", lambda text: with_float_colors(text, 1.0))


@case(Reads(notes=("colours from 0 to 1,",), also=same_colors))
def points3d_txt_with_colours_up_to_one(room: FieldRoom, folder: Path) -> Path:
    return edited(room, folder, "points3D", lambda text: with_float_colors(text, 1 / 255))


@case(Reads())
def unused_camera_of_another_model_text(room: FieldRoom, folder: Path) -> Path:
    return edited(room, folder, "cameras", lambda text: text + "77 FOV 96 72 80 80 48 36 0.9\n")


def with_model(
    room: FieldRoom, folder: Path, model: str, lens: Sequence[float] = (), *, unused: bool = False
) -> Path:
    """A COLMAP scene in binary form whose cameras, or a further one, are of another model."""
    import pycolmap

    sparse = room.colmap(folder) / "sparse" / "0"
    reconstruction = pycolmap.Reconstruction(sparse)
    any_camera = next(iter(reconstruction.cameras.values()))
    if unused:
        camera = pycolmap.Camera(
            camera_id=99, model=model, width=96, height=72, params=[*any_camera.params, *lens]
        )
        reconstruction.add_camera_with_trivial_rig(camera)
    for camera in reconstruction.cameras.values():
        if not unused:
            fx, fy, cx, cy = camera.params
            camera.model = pycolmap.CameraModelId.__members__[model]
            camera.params = [*((fx,) if model.startswith("SIMPLE") else (fx, fy)), cx, cy, *lens]
    reconstruction.write_binary(sparse)
    return folder


@case(Reads())
def unused_camera_of_another_model_binary(room: FieldRoom, folder: Path) -> Path:
    return with_model(room, folder, "THIN_PRISM_FISHEYE", [0.1] * 8, unused=True)


@case(Reads(also=has_lens(Distortion("fisheye", (0.0,) * 4))))
def simple_fisheye(room: FieldRoom, folder: Path) -> Path:
    return with_model(room, folder, "SIMPLE_FISHEYE")


@case(Reads(also=has_lens(Distortion("brown5", (0.001, 0.002, 0.0, 0.0, 0.003)))))
def metashape_colmap_with_k3(room: FieldRoom, folder: Path) -> Path:
    return with_model(room, folder, "FULL_OPENCV", [0.001, 0.002, 0.0, 0.0, 0.003, 0.0, 0.0, 0.0])


@case(Refuses(("cameras.bin", "FULL_OPENCV with k5 = 0.1 is not supported", "image_undistorter")))
def full_opencv_with_k5(room: FieldRoom, folder: Path) -> Path:
    return with_model(room, folder, "FULL_OPENCV", [0.001, 0.002, 0.0, 0.0, 0.003, 0.0, 0.1, 0.0])


@case(Refuses(("cameras.bin", "THIN_PRISM_FISHEYE with p1 = 0.1 is not supported")))
def thin_prism(room: FieldRoom, folder: Path) -> Path:
    return with_model(room, folder, "THIN_PRISM_FISHEYE", [0.01, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0])


@case(Refuses(("points3D.bin", "ends too early", "copy the file again")))
def colmap_binary_cut(room: FieldRoom, folder: Path) -> Path:
    path = room.colmap(folder) / "sparse" / "0" / "points3D.bin"
    path.write_bytes(path.read_bytes()[:-11])
    return folder


def cameras_json(room: FieldRoom, folder: Path, change: Callable[[list[dict]], None]) -> Path:
    """A splat with an edited cameras.json."""
    path = room.splat(folder) / "cameras.json"
    entries = json.loads(path.read_text())
    change(entries)
    path.write_text(json.dumps(entries))
    return folder


@case(Refuses(("cameras.json", "two cameras are called 0004", "3DGS leaves out folders")))
def cameras_json_with_equal_names(room: FieldRoom, folder: Path) -> Path:
    def rename(entries: list[dict]) -> None:
        for number, entry in enumerate(entries):
            entry["img_name"] = f"000{4 + number % 4}"

    return cameras_json(room, folder, rename)


@case(Refuses(("cameras.json", "entry 2", "not a rotation")))
def cameras_json_without_a_rotation(room: FieldRoom, folder: Path) -> Path:
    return cameras_json(
        room, folder, lambda entries: entries[2].update(rotation=[[1, 0, 0], [0, 1, 0], [0, 1, 0]])
    )


@case(Refuses(("cameras.json", "entry 0", "width is 'wide', not a number")))
def cameras_json_with_words(room: FieldRoom, folder: Path) -> Path:
    return cameras_json(room, folder, lambda entries: entries[0].update(width="wide"))


@case(Reads(notes=("not UTF-8 are read as cp1252",)))
def transforms_in_a_windows_code_page(room: FieldRoom, folder: Path) -> Path:
    contents = room.transforms()
    room.nerfstudio(folder)
    for name, frame in zip(room.names, contents["frames"], strict=True):
        frame["file_path"] = f"images/B\u00fcro_{name}.jpg"
        (folder / "images" / f"{name}.jpg").rename(folder / frame["file_path"])
    (folder / "transforms.json").write_bytes(json.dumps(contents, ensure_ascii=False).encode("cp1252"))
    return folder
