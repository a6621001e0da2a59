"""Bad input at the command line: exit code 2, one line, no run folder; or left out, with a note."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from diga3d_warp import cli
from diga3d_warp.evaluation.record import read_manifest
from scenes import random_gaussians

PROC = pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="needs a folder that nobody can write to")


@pytest.fixture
def scene(room, tmp_path) -> Path:
    """A copy of the room that may be spoilt."""
    shutil.copytree(room, tmp_path / "scene", ignore=shutil.ignore_patterns("ground_truth"))
    return tmp_path / "scene"


def images(scene: Path) -> list[Path]:
    return sorted((scene / "images").iterdir())


def masks(scene: Path) -> list[Path]:
    return sorted((scene / "masks").iterdir())


def all_images_missing(scene: Path) -> None:
    shutil.rmtree(scene / "images")


def all_images_truncated(scene: Path) -> None:
    for path in images(scene):
        path.write_bytes(path.read_bytes()[:200])


def one_view(scene: Path) -> None:
    for path in images(scene)[1:]:
        path.unlink()


def masks_with_other_names(scene: Path) -> None:
    for number, path in enumerate(masks(scene)):
        path.rename(path.with_name(f"other_{number}.png"))


def mask_of_another_size(scene: Path) -> None:
    cv2.imwrite(str(masks(scene)[2]), np.full((50, 50), 255, np.uint8))


def mask_that_is_no_image(scene: Path) -> None:
    masks(scene)[2].write_text("hello")


def every_mask(value: int):
    def change(scene: Path) -> None:
        for path in masks(scene):
            cv2.imwrite(str(path), np.full((72, 96), value, np.uint8))

    return change


def no_masks(scene: Path) -> None:
    shutil.rmtree(scene / "masks")


def corrupt_bin(name: str):
    def change(scene: Path) -> None:
        path = scene / "sparse" / "0" / name
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])

    return change


def zero_points(scene: Path) -> None:
    (scene / "sparse" / "0" / "points3D.bin").write_bytes(bytes(8))
    for path in images(scene):
        cv2.imwrite(str(path), np.full((72, 96, 3), 90, np.uint8))


def path_outside(scene: Path) -> None:
    shutil.rmtree(scene / "sparse")
    frame = {"file_path": "../../secret.png", "transform_matrix": np.eye(4).tolist()}
    lens = {"w": 96, "h": 72, "fl_x": 90.0, "fl_y": 90.0, "cx": 48.0, "cy": 36.0, "camera_model": "PINHOLE"}
    (scene / "transforms.json").write_text(json.dumps({**lens, "frames": [frame, frame]}))


def splat(scene: Path, spoil=lambda gaussians: None) -> None:
    """Make the scene a splat: its cameras as 3DGS writes them, and gaussians around the origin."""
    from diga3d_warp.scene.layouts.cameras_file import CameraSet, save_cameras
    from diga3d_warp.scene.load import load_scene

    save_cameras(scene / "cameras.json", CameraSet.of(load_scene(scene)))
    shutil.rmtree(scene / "sparse")
    gaussians = random_gaussians(60)
    spoil(gaussians)
    gaussians.save_ply(scene / "splat.ply")


def nan_splat(scene: Path) -> None:
    splat(scene, lambda gaussians: gaussians.opacity_logits.fill_(float("nan")))


def zero_quaternion_splat(scene: Path) -> None:
    splat(scene, lambda gaussians: gaussians.quaternions.zero_())


def half_a_splat(scene: Path) -> None:
    splat(scene)
    os.truncate(scene / "splat.ply", (scene / "splat.ply").stat().st_size - 7)


BAD_SCENES = {
    "no such folder": (shutil.rmtree, "there is no such file or folder"),
    "missing images": (all_images_missing, "no photographs found"),
    "truncated images": (all_images_truncated, "at least two photographs"),
    "one view": (one_view, "at least two photographs"),
    "masks of other names": (masks_with_other_names, "no mask has the name of an image"),
    "mask of another size": (mask_of_another_size, "50 x 50 px for an image of 96 x 72"),
    "mask that is no image": (mask_that_is_no_image, "not readable as an image"),
    "empty masks": (every_mask(0), "every mask is empty; mark the object in white"),
    "masks over everything": (every_mask(255), "every mask covers its whole image"),
    "no masks": (no_masks, "no view has a mask"),
    "corrupt cameras.bin": (corrupt_bin("cameras.bin"), "cameras.bin"),
    "corrupt images.bin": (corrupt_bin("images.bin"), "images.bin"),
    "corrupt points3D.bin": (corrupt_bin("points3D.bin"), "points3D.bin"),
    "zero points": (zero_points, "no sparse points, and none could be triangulated"),
    "path outside the scene": (path_outside, "leaves the scene folder"),
    "splat of NaN": (nan_splat, "none of its 60 gaussians is usable"),
    "splat of zero quaternions": (zero_quaternion_splat, "none of its 60 gaussians is usable"),
    "truncated splat": (half_a_splat, "cut short or damaged"),
}


def refused(words: list[str], said: str, capfd) -> None:
    assert cli.main(words) == 2
    written = capfd.readouterr()
    lines = [line for line in written.err.replace("\r", "\n").splitlines() if line.strip()]
    assert lines[-1].startswith("diga3d: error: ") and said in lines[-1]
    assert sum("error" in line for line in lines) == 1
    assert "Traceback" not in written.err
    assert written.out == ""


@pytest.mark.parametrize("case", BAD_SCENES)
def test_bad_scenes_are_one_line_and_leave_nothing(scene, tmp_path, capfd, case):
    spoil, said = BAD_SCENES[case]
    spoil(scene)
    before = sorted(tmp_path.rglob("*"))
    commands = ["remove"] if "mask" in case else ["fit", "remove"]
    for command in commands:
        refused([command, str(scene), "--out", str(tmp_path / "run")], said, capfd)
        assert sorted(tmp_path.rglob("*")) == before


def test_a_mask_folder_without_masks(scene, tmp_path, capfd):
    (tmp_path / "empty").mkdir()
    for folder in ("empty", "absent"):
        words = ["remove", str(scene), "--out", str(tmp_path / "run"), "--masks", str(tmp_path / folder)]
        refused(words, f"{tmp_path / folder}: there are no mask images", capfd)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("command", ["fit", "remove"])
@pytest.mark.parametrize(
    "place", ["file", "under a file", "other things", pytest.param("/proc/self/run", marks=PROC)]
)
def test_outputs_that_cannot_be_written(scene, tmp_path, capfd, command, place):
    out = {"file": tmp_path / "file", "under a file": tmp_path / "file" / "run", "other things": scene}
    (tmp_path / "file").write_text("kept")
    before = sorted(tmp_path.rglob("*"))
    refused([command, str(scene), "--out", str(out.get(place, place))], str(out.get(place, place)), capfd)
    assert sorted(tmp_path.rglob("*")) == before
    assert (tmp_path / "file").read_text() == "kept"


def gone_on(scene: Path, run: Path, capfd) -> list[str]:
    """The notes of a fit that is over at once."""
    assert cli.main(["fit", str(scene), "--out", str(run), "--iterations", "1"]) == 0
    notes = read_manifest(run)["notes"]
    written = capfd.readouterr().err
    assert all(f"diga3d: note: {note}\n" in written for note in notes)
    assert (run / "point_cloud.ply").is_file() and (run / "report.html").is_file()
    return notes


def test_missing_and_truncated_images_are_named_and_left_out(scene, tmp_path, capfd):
    first, second = images(scene)[3:5]
    first.unlink()
    second.write_bytes(second.read_bytes()[:200])
    missing, truncated = gone_on(scene, tmp_path / "run", capfd)
    assert "1 images are missing: view_003" in missing
    assert f"left out: {second}" in truncated
    assert len(list((tmp_path / "run" / "views" / "after").iterdir())) == 7


def test_unusable_gaussians_are_counted_and_left_out(scene, tmp_path, capfd):
    def spoil(gaussians) -> None:
        gaussians.means[4, 1] = float("nan")
        gaussians.quaternions[[7, 8]] = 0.0

    splat(scene, spoil)
    notes = gone_on(scene, tmp_path / "run", capfd)
    assert "splat.ply: left out 1 gaussians with NaN or infinite values" in notes
    assert "splat.ply: left out 2 gaussians whose quaternion is zero" in notes
