"""Cases of layouts and names: which file is read."""

from __future__ import annotations

import json
import shutil
import unicodedata
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from expectations import Reads, Refuses, case
from field_room import FieldRoom, write_picture

from diga3d_warp.scene.scene import Scene


def silent(scene: Scene, room: FieldRoom) -> None:
    """Nothing was guessed or left out."""
    assert scene.notes == ()


def tests_are(*places: int) -> Callable[[Scene, FieldRoom], None]:
    """The views of these places in sorted order are held out, and no others."""

    def check(scene: Scene, room: FieldRoom) -> None:
        assert [view.name for view in scene.test_views] == [room.names[place] for place in places]

    return check


def rename_in(path: Path, names: dict[bytes, bytes]) -> None:
    """Other image names of the same length in an images.bin."""
    data = path.read_bytes()
    for old, new in names.items():
        assert len(old) == len(new) and data.count(old) == 1
        data = data.replace(old, new)
    path.write_bytes(data)


def rename_images(room: FieldRoom, folder: Path, name: Callable[[str], str]) -> None:
    """Other names in images.txt, by the names without ending."""
    path = folder / "sparse" / "0" / "images.txt"
    text = path.read_text(encoding="utf-8")
    for old in room.names:
        text = text.replace(f"{old}.jpg", name(old))
    path.write_text(text, encoding="utf-8")


def two_models(room: FieldRoom, folder: Path) -> Path:
    """sparse/1 as it is, and a sparse/0 that lacks all images but three."""
    room.colmap_text(folder)
    whole, part = folder / "sparse" / "1", folder / "sparse" / "0"
    part.rename(whole)
    shutil.copytree(whole, part)
    lines = (part / "images.txt").read_text().splitlines()
    images = [line for line in lines if line.endswith(".jpg")]
    (part / "images.txt").write_text("".join(f"{line}\n\n" for line in images[:3]))
    return folder


def nerfstudio_names(room: FieldRoom, folder: Path, name: Callable[[str], str], **entries) -> Path:
    """A transforms.json with other names of images."""
    contents = {**room.transforms(), **entries}
    for frame, stem in zip(contents["frames"], room.names, strict=True):
        frame["file_path"] = name(stem)
    return room.nerfstudio(folder, contents)


@case(Reads(also=silent))
def colmap_binary(room: FieldRoom, folder: Path) -> Path:
    return room.colmap(folder)


@case(Reads(also=silent))
def colmap_text(room: FieldRoom, folder: Path) -> Path:
    return room.colmap_text(folder)


@case(Reads(also=silent))
def nerfstudio(room: FieldRoom, folder: Path) -> Path:
    return room.nerfstudio(folder)


@case(Reads(points=False, also=silent))
def splat_with_cameras(room: FieldRoom, folder: Path) -> Path:
    return room.splat(folder)


@case(Refuses(("no such file",)))
def missing_folder(room: FieldRoom, folder: Path) -> Path:
    return folder / "absent"


# Names of images.


@case(Reads(notes=("8 images have no pose and are left out",)))
def depth_of_the_same_name_beside_the_photographs(room: FieldRoom, folder: Path) -> Path:
    room.colmap(folder)
    for name, pixels in room.pixels.items():
        write_picture(folder / "images" / f"{name}.png", 255 - pixels)
    return folder


@case(Reads(notes=("8 images have another ending",)))
def photographs_converted_after_calibration(room: FieldRoom, folder: Path) -> Path:
    return nerfstudio_names(room, folder, lambda stem: f"images/{stem}.HEIC")


@case(Reads(notes=("named without an ending, and several files fit",)))
def names_without_ending_and_masks_beside(room: FieldRoom, folder: Path) -> Path:
    nerfstudio_names(room, folder, lambda stem: f"./images/{stem}")
    for name, mask in room.masks.items():
        write_picture(folder / "images" / f"{name}.png", mask.astype(np.uint8) * 255)
    return folder


@case(Reads(also=silent))
def names_without_ending_of_upper_case_files(room: FieldRoom, folder: Path) -> Path:
    nerfstudio_names(room, folder, lambda stem: f"images/{stem}")
    for path in (folder / "images").iterdir():
        path.rename(path.with_suffix(".JPG"))
    return folder


@case(Reads(also=silent))
def names_in_other_case(room: FieldRoom, folder: Path) -> Path:
    room.colmap(folder)
    for path in (folder / "images").iterdir():
        path.rename(path.with_name(path.name.upper()))
    return folder


@case(Reads(also=silent))
def folder_with_characters_of_patterns(room: FieldRoom, folder: Path) -> Path:
    inner = folder / "room [1] {a,b}*?"
    nerfstudio_names(room, inner, lambda stem: f"photos [1]/{stem}.jpg")
    (inner / "images").rename(inner / "photos [1]")
    return inner


@case(Reads(also=silent))
def accents_apart_in_file_names(room: FieldRoom, folder: Path) -> Path:
    """macOS unpacks names with accents apart (NFD); calibrations write them composed."""
    room.colmap_text(folder)
    rename_images(room, folder, lambda stem: f"Büro é {stem}.jpg")
    for path in (folder / "images").iterdir():
        path.rename(path.with_name(unicodedata.normalize("NFD", f"Büro é {path.name}")))
    return folder


def in_code_page(scene: Scene, room: FieldRoom) -> None:
    assert all(view.name.startswith("Büro_") for view in scene.views)


@case(Reads(notes=("image names that are not UTF-8 are read as cp1252",), also=in_code_page))
def names_in_a_windows_code_page(room: FieldRoom, folder: Path) -> Path:
    room.colmap_text(folder)
    rename_images(room, folder, lambda stem: f"Büro_{stem}.jpg")
    path = folder / "sparse" / "0" / "images.txt"
    path.write_bytes(path.read_text(encoding="utf-8").encode("cp1252"))
    for file in (folder / "images").iterdir():
        file.rename(file.with_name(f"Büro_{file.name}"))
    return folder


@case(Refuses(("8 images are missing", "names in the calibration are not UTF-8")))
def names_in_a_code_page_of_absent_files(room: FieldRoom, folder: Path) -> Path:
    room.colmap(folder)
    path = folder / "sparse" / "0" / "images.bin"
    rename_in(path, {f"{name}.jpg".encode(): b"\xfc" + f"{name}.jpg".encode()[1:] for name in room.names})
    for number, file in enumerate(sorted((folder / "images").iterdir())):
        file.rename(file.with_name(f"other{number}.jpg"))
    return folder


@case(Reads(notes=("8 paths lead out of the scene and are taken by their ends",)))
def absolute_paths_of_another_machine(room: FieldRoom, folder: Path) -> Path:
    return nerfstudio_names(room, folder, lambda stem: f"/home/someone/room/images/{stem}.jpg")


@case(Reads(notes=("8 paths lead out of the scene and are taken by their ends",)))
def absolute_paths_of_windows(room: FieldRoom, folder: Path) -> Path:
    return nerfstudio_names(room, folder, lambda stem: rf"C:\Users\someone\room\images\{stem}.jpg")


@case(Refuses(("leaves the scene folder",)))
def colmap_names_outside_the_scene(room: FieldRoom, folder: Path) -> Path:
    room.colmap_text(folder)
    rename_images(room, folder, lambda stem: f"../../{stem}.jpg")
    shutil.move(folder / "images", folder / "pictures")
    for path in sorted((folder / "pictures").iterdir())[1:]:
        path.rename(folder.parent / path.name)
    return folder


@case(Refuses(("cameras.json", "leaves the scene folder")))
def splat_names_outside_the_scene(room: FieldRoom, folder: Path) -> Path:
    room.splat(folder)
    path = folder / "cameras.json"
    path.write_text(path.read_text().replace(f'"{room.names[3]}"', '"../../../etc/hostname"'))
    return folder


@case(Reads(notes=("6 images have no pose",), views=2, load={"hold_out": 0}))
def extra_photographs(room: FieldRoom, folder: Path) -> Path:
    room.colmap_text(folder)
    path = folder / "sparse" / "0" / "images.txt"
    kept = [line for line in path.read_text().splitlines() if line.endswith(".jpg")][:2]
    path.write_text("".join(f"{line}\n\n" for line in kept))
    return folder


@case(Reads(also=silent))
def names_with_spaces_html_and_quotes(room: FieldRoom, folder: Path) -> Path:
    def odd(stem: str) -> str:
        return f"<b onclick='a'>\"room\" & {stem}.jpg"

    room.colmap_text(folder)
    rename_images(room, folder, odd)
    for name in room.names:
        (folder / "images" / f"{name}.jpg").rename(folder / "images" / odd(name))
    return folder


# Links.


@case(Reads(also=silent))
def linked_image_folder(room: FieldRoom, folder: Path) -> Path:
    room.colmap(folder)
    (folder / "images").rename(folder.parent / "disk")
    (folder / "images").symlink_to(folder.parent / "disk", target_is_directory=True)
    return folder


@case(Reads(also=silent))
def linked_folders_below_the_images(room: FieldRoom, folder: Path) -> Path:
    """With a link back to the folder itself, which must not be followed for ever."""
    room.colmap_text(folder)
    rename_images(room, folder, lambda stem: f"front/{stem}.jpg")
    (folder / "images").rename(folder.parent / "disk")
    (folder / "images").mkdir()
    (folder / "images" / "front").symlink_to(folder.parent / "disk", target_is_directory=True)
    (folder / "images" / "loop").symlink_to(folder / "images", target_is_directory=True)
    return folder


@case(Reads(also=silent))
def linked_images(room: FieldRoom, folder: Path) -> Path:
    room.colmap(folder)
    (folder / "images").rename(folder.parent / "disk")
    (folder / "images").mkdir()
    for path in (folder.parent / "disk").iterdir():
        (folder / "images" / path.name).symlink_to(path)
    return folder


# COLMAP's layouts.


@case(Reads(notes=("sparse/1 is read, with 8 images the largest model: sparse/0 has 3",)))
def several_models(room: FieldRoom, folder: Path) -> Path:
    return two_models(room, folder)


@case(Reads(views=3, load={"hold_out": 0}))
def the_model_that_is_named(room: FieldRoom, folder: Path) -> Path:
    return two_models(room, folder) / "sparse" / "0" / "cameras.txt"


@case(Reads(also=silent))
def only_a_second_model(room: FieldRoom, folder: Path) -> Path:
    return room.colmap_text(folder, "sparse/1")


@case(Reads(also=silent))
def model_folder_named(room: FieldRoom, folder: Path) -> Path:
    return room.colmap(folder) / "sparse" / "0"


@case(Reads(also=silent))
def sparse_folder_named(room: FieldRoom, folder: Path) -> Path:
    return room.colmap(folder) / "sparse"


@case(Reads(notes=("images is a part of",)))
def image_folder_of_a_capture_named(room: FieldRoom, folder: Path) -> Path:
    """The poses beside it are not to be found anew."""
    return room.colmap(folder) / "images"


@case(Reads(also=silent))
def undistorted_by_colmap(room: FieldRoom, folder: Path) -> Path:
    room.colmap_text(folder / "dense" / "0", "sparse")
    return folder


@case(Reads(notes=("not used: distorted/sparse/0",)))
def converted_for_3dgs(room: FieldRoom, folder: Path) -> Path:
    room.colmap(folder)
    shutil.copytree(folder / "sparse" / "0", folder / "distorted" / "sparse" / "0")
    shutil.copytree(folder / "images", folder / "input")
    return folder


@case(Reads(also=silent))
def realityscan_beside_the_images(room: FieldRoom, folder: Path) -> Path:
    return room.colmap_text(folder, ".")


@case(Reads(also=silent))
def realityscan_among_the_images(room: FieldRoom, folder: Path) -> Path:
    room.colmap_text(folder, ".")
    for path in (folder / "images").iterdir():
        path.rename(folder / path.name)
    (folder / "images").rmdir()
    return folder


@case(Reads(also=silent))
def upper_case_everywhere(room: FieldRoom, folder: Path) -> Path:
    room.colmap_text(folder)
    for path in (folder / "sparse" / "0").iterdir():
        path.rename(path.with_name(path.name.capitalize()))
    (folder / "images").rename(folder / "Images")
    return folder


@case(Reads(also=silent))
def names_from_the_scene_folder(room: FieldRoom, folder: Path) -> Path:
    room.colmap_text(folder)
    rename_images(room, folder, lambda stem: f"images/{stem}.jpg")
    return folder


@case(Reads(notes=("photographs are read from photos",)))
def images_in_another_folder(room: FieldRoom, folder: Path) -> Path:
    room.colmap(folder)
    (folder / "images").rename(folder / "photos")
    return folder


@case(Refuses(("no photographs found; put them into",)))
def masks_without_photographs(room: FieldRoom, folder: Path) -> Path:
    """Masks have the names of the images; they are not read for them."""
    room.colmap(folder, masks=True)
    shutil.rmtree(folder / "images")
    return folder


@case(Refuses(("no capture recognised", "expected sparse/0 with cameras and images files")))
def half_a_model(room: FieldRoom, folder: Path) -> Path:
    room.colmap_text(folder)
    (folder / "sparse" / "0" / "images.txt").unlink()
    return folder


# Several sources of poses.


@case(
    Reads(
        notes=("poses are those of transforms.json; not used: colmap/sparse/0", "3 images have no pose"),
        views=5,
    )
)
def transforms_edited_beside_colmap(room: FieldRoom, folder: Path) -> Path:
    room.colmap(folder)
    (folder / "colmap").mkdir()
    (folder / "sparse").rename(folder / "colmap" / "sparse")
    contents = room.transforms()
    contents["frames"] = contents["frames"][:5]
    return room.nerfstudio(folder, contents)


@case(Reads(views=5))
def transforms_of_another_name(room: FieldRoom, folder: Path) -> Path:
    contents = room.transforms()
    contents["frames"] = contents["frames"][:5]
    path = room.nerfstudio(folder) / "transforms_edited.json"
    path.write_text(json.dumps(contents))
    return path


@case(Reads(notes=("not used: bundle.out, cameras.xml",)))
def other_programs_beside_colmap(room: FieldRoom, folder: Path) -> Path:
    (folder / "cameras.xml").write_text('<?xml version="1.0"?>\n<document version="2.0.0">\n <chunk>\n')
    (folder / "bundle.out").write_text("# Bundle file v0.3\n8 600\n")
    return room.colmap(folder)


def with_photographs(name: str, text: str):
    def build(room: FieldRoom, folder: Path) -> Path:
        room.write_images(folder / "images")
        (folder / name).write_text(text)
        return folder

    return build


for _name, _whose, _text in (
    ("cameras.xml", "Metashape", '<?xml version="1.0"?>\n<document version="2.0.0">\n <chunk>\n'),
    ("bundle.out", "Bundler", "# Bundle file v0.3\n8 600\n"),
    ("room.nvm", "VisualSFM", "NVM_V3\n\n8\n"),
    ("poses.csv", "RealityScan", "#name,x,y,alt,heading,pitch,roll\na.jpg,0,0,0,0,0,0\n"),
    ("reconstruction.json", "OpenSfM", '[{"cameras": {}, "shots": {}}]'),
    ("traj.txt", "a trajectory", "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n"),
):
    _build = with_photographs(_name, _text)
    _build.__name__ = f"photographs_with_{_whose.lower().split()[-1]}_poses"
    case(
        Refuses(
            (_name, f"poses of {_whose} are not read", "COLMAP's form", "to have the poses recovered anew")
        )
    )(_build)


def with_files_for_each_image(folder_name: str, ending: str, text: str):
    def build(room: FieldRoom, folder: Path) -> Path:
        room.write_images(folder / "images")
        (folder / folder_name).mkdir(exist_ok=True)
        for name in room.names:
            (folder / folder_name / f"{name}{ending}").write_text(text)
        return folder

    return build


for _place, _whose, _ending, _text in (
    ("images", "RealityScan", ".xmp", '<x xcr:Rotation="1 0 0 0 1 0 0 0 1"/>'),
    ("cams", "MVSNet", "_cam.txt", "extrinsic\n1 0 0 0\n"),
    ("pose", "matrices", ".txt", "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"),
    ("camera", "Nerfies", ".json", '{"orientation": [], "position": []}'),
):
    _build = with_files_for_each_image(_place, _ending, _text)
    _build.__name__ = f"photographs_with_{_whose.lower()}_files"
    case(Refuses((_place, f"poses of {_whose} are not read")))(_build)


@case(Refuses(("looks like one; give that folder",)))
def capture_one_folder_down(room: FieldRoom, folder: Path) -> Path:
    room.nerfstudio(folder / "room")
    return folder


@case(Reads(points=False))
def cameras_json_without_a_splat(room: FieldRoom, folder: Path) -> Path:
    room.splat(folder)
    (folder / "point_cloud.ply").unlink()
    return folder


@case(Reads(points=False, also=silent))
def cameras_json_named(room: FieldRoom, folder: Path) -> Path:
    return room.splat(folder) / "cameras.json"


@case(Reads(points=False))
def polycam_with_its_cameras(room: FieldRoom, folder: Path) -> Path:
    """Raw export: poses of ARKit beside images, and what is no photograph beside them."""
    frames = folder / "keyframes"
    room.write_images(frames / "images")
    write_picture(folder / "thumbnail.jpg", room.pixels[room.names[0]])
    (frames / "cameras").mkdir()
    for name, camera in room.cameras.items():
        pose = np.linalg.inv(np.asarray(camera.pose)) @ np.diag([1.0, -1.0, -1.0, 1.0])
        rows = {2: pose[0], 0: pose[1], 1: pose[2]}
        matrix = {f"t_{row}{column}": rows[row][column] for row in range(3) for column in range(4)}
        lens = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy}
        size = {"width": camera.width, "height": camera.height}
        (frames / "cameras" / f"{name}.json").write_text(json.dumps({**matrix, **lens, **size}))
        write_picture(frames / "depth" / f"{name}.png", room.masks[name].astype(np.uint8) * 200)
    return folder


# Splits.


@case(Reads(also=tests_are(1, 4)))
def test_filenames(room: FieldRoom, folder: Path) -> Path:
    names = [f"images/{name}.jpg" for name in room.names]
    apart = [names[1], names[4]]
    split = {"train_filenames": [name for name in names if name not in apart], "test_filenames": apart}
    return room.nerfstudio(folder, {**room.transforms(), **split, "val_filenames": apart})


@case(Reads(also=tests_are(2)))
def val_filenames_only(room: FieldRoom, folder: Path) -> Path:
    return room.nerfstudio(folder, {**room.transforms(), "val_filenames": [f"./images/{room.names[2]}.jpg"]})


@case(Reads(also=tests_are()))
def train_filenames_of_all(room: FieldRoom, folder: Path) -> Path:
    names = [f"images/{name}.jpg" for name in room.names]
    return room.nerfstudio(folder, {**room.transforms(), "train_filenames": names, "test_filenames": []})


@case(Reads(notes=("3 frames are neither for training nor for testing",), views=5, also=tests_are(0)))
def frames_in_no_list(room: FieldRoom, folder: Path) -> Path:
    names = [f"images/{name}.jpg" for name in room.names]
    split = {"train_filenames": names[1:5], "test_filenames": names[:1]}
    return room.nerfstudio(folder, {**room.transforms(), **split})


@case(Reads(notes=("test_filenames names 1 images without a frame: images/absent.jpg",), also=tests_are(3)))
def test_filenames_without_frames(room: FieldRoom, folder: Path) -> Path:
    apart = [f"images/{room.names[3]}.jpg", "images/absent.jpg"]
    return room.nerfstudio(folder, {**room.transforms(), "test_filenames": apart})


@case(Reads(points=False, also=tests_are(5, 6)))
def split_of_a_cameras_json(room: FieldRoom, folder: Path) -> Path:
    room.splat(folder)
    path = folder / "cameras.json"
    entries = json.loads(path.read_text())
    for place in (5, 6):
        entries[place]["split"] = "test"
    path.write_text(json.dumps(entries))
    return folder


# What is no capture.


def file_beside_a_capture(name: str, data: bytes):
    def build(room: FieldRoom, folder: Path) -> Path:
        path = room.colmap(folder) / name
        path.write_bytes(data)
        return path

    return build


for _name, _said in (
    ("clip.mp4", "a video; extract photographs"),
    ("clip.MOV", "ffmpeg -i clip.MOV"),
    ("scene.zip", "an archive; unpack it"),
    ("scene.tar.gz", "an archive; unpack it"),
    ("IMG_0001.HEIC", "one image; give the folder"),
    ("notes.docx", "no capture; expected sparse/0"),
):
    _build = file_beside_a_capture(_name, b"\0\1\2\3" * 40)
    _build.__name__ = f"named_{_name.replace('.', '_').lower()}_beside_a_capture"
    case(Refuses((_name, _said)))(_build)


@case(Refuses(("clip.avi is a video; extract photographs", "no capture recognised")))
def folder_with_a_video_only(room: FieldRoom, folder: Path) -> Path:
    (folder / "clip.avi").write_bytes(b"RIFF" + bytes(60))
    return folder


@case(Refuses(("room.zip is an archive; unpack it",)))
def folder_with_an_archive_only(room: FieldRoom, folder: Path) -> Path:
    with zipfile.ZipFile(folder / "room.zip", "w") as archive:
        archive.writestr("images/a.jpg", b"")
    return folder


@case(Refuses(("8 are HEIC images, which are not read", "convert them to .jpg or .png")))
def photographs_in_heic(room: FieldRoom, folder: Path) -> Path:
    for name in room.names:
        (folder / f"{name}.HEIC").write_bytes(b"\0\0\0\x18ftypheic" + bytes(40))
    return folder


@case(Refuses(("no photographs found", "8 are OpenEXR images, which are not read")))
def exr_for_jpg(room: FieldRoom, folder: Path) -> Path:
    room.colmap(folder)
    for path in (folder / "images").iterdir():
        path.rename(path.with_suffix(".exr"))
    return folder


@case(Reads(notes=("2 images are missing", "2 are raw images, which are not read"), views=6))
def raw_for_some(room: FieldRoom, folder: Path) -> Path:
    room.colmap(folder)
    for name in room.names[:2]:
        (folder / "images" / f"{name}.jpg").rename(folder / "images" / f"{name}.CR3")
    return folder


# Encodings.


def in_encoding(encoding: str):
    def build(room: FieldRoom, folder: Path) -> Path:
        path = room.nerfstudio(folder) / "transforms.json"
        path.write_bytes(path.read_text(encoding="utf-8").encode(encoding))
        return folder

    return build


for _encoding in ("utf-8-sig", "utf-16"):
    _build = in_encoding(_encoding)
    _build.__name__ = f"transforms_in_{_encoding.replace('-', '_')}"
    case(Reads(also=silent))(_build)


@case(Refuses(("transforms.json", "frame 0", "not an object")))
def transforms_in_no_encoding(room: FieldRoom, folder: Path) -> Path:
    (room.nerfstudio(folder) / "transforms.json").write_bytes(b'{"frames": ["\xff\xfe\xfa"]}')
    return folder
