"""Rendering a run: a video that plays, frames, and what cannot be written."""

import cv2
import numpy as np
import pytest

from diga3d_warp.config import Accuracy
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.record import RESULT
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.pipelines.render import render_path
from diga3d_warp.splatting.render import render


def read_video(path):
    video = cv2.VideoCapture(str(path))
    frames = []
    while True:
        more, frame = video.read()
        if not more:
            return frames
        frames.append(frame[..., ::-1])


@pytest.mark.parametrize("ending", [".webm", ".MP4", ".Avi"])
def test_video(toy_run, tmp_path, ending):
    out = render_path(toy_run.folder, tmp_path / f"flight{ending}", frames=5, size=(97, 65))
    frames = read_video(out)
    assert len(frames) == 5
    assert {frame.shape for frame in frames} == {(64, 96, 3)}
    assert frames[0].std() > 10
    still = render_path(toy_run.folder, tmp_path / "flight", frames=5, size=(97, 65))
    picture = cv2.imread(str(still / "0000.png"))[:64, :96, ::-1]
    error = np.abs(picture.astype(float) - frames[0])
    assert error.mean() < 12, "the video shows the frame, colours in order"


def test_frames_at_the_views_are_the_views(toy_run):
    out = render_path(toy_run.folder, toy_run.folder / "frames", path="views")
    names = sorted(file.name for file in out.iterdir())
    assert names == [f"{index:04d}.png" for index in range(6)]
    splat = Gaussians.load_ply(toy_run.folder / RESULT)
    expected = render(splat, toy_run.scene.views[2].camera).color.detach().clamp(0, 1).numpy() * 255
    picture = cv2.imread(str(out / "0002.png"))[..., ::-1]
    assert picture.shape == (36, 48, 3)
    np.testing.assert_allclose(picture, expected, atol=0.51)


def test_frames_follow_the_accuracy(toy_run, tmp_path):
    folders = [
        render_path(toy_run.folder, tmp_path / name, path="views", accuracy=accuracy)
        for name, accuracy in (("draft", Accuracy.DRAFT), ("standard", Accuracy.STANDARD))
    ]
    draft, standard = (cv2.imread(str(folder / "0002.png")).astype(float) for folder in folders)
    assert 0.0 < np.abs(draft - standard).mean() < 5.0


def test_default_is_a_video_in_the_run(toy_run, capfd):
    assert render_path(toy_run.folder, frames=2) == toy_run.folder / "path.webm"
    assert len(read_video(toy_run.folder / "path.webm")) == 2
    assert not list(toy_run.folder.glob(".*partial*")), "no temporary file stays"
    assert "not supported" not in capfd.readouterr().err


def test_what_cannot_be_rendered_is_one_line(toy_run, tmp_path):
    with pytest.raises(InputError, match=r"ends in \.gif"):
        render_path(toy_run.folder, tmp_path / "flight.gif")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        render_path(toy_run.folder, tmp_path / "file" / "frames", frames=1)
    (toy_run.folder / RESULT).unlink()
    with pytest.raises(InputError, match=r"no point_cloud\.ply"):
        render_path(toy_run.folder)


def test_a_folder_for_frames_may_hold_dots(toy_run, tmp_path):
    out = render_path(toy_run.folder, tmp_path / "flight.v2", frames=2, size=(16, 12))
    assert sorted(file.name for file in out.iterdir()) == ["0000.png", "0001.png"]
    render_path(toy_run.folder, out, frames=2, size=(16, 12))  # again, over the same frames
    (tmp_path / "flight.mp4").mkdir()
    out = render_path(toy_run.folder, tmp_path / "flight.mp4", frames=1, size=(16, 12))
    assert [file.name for file in out.iterdir()] == ["0000.png"]


def test_frames_do_not_replace_or_join_other_things(toy_run, tmp_path):
    photographs = tmp_path / "scene" / "images"
    photographs.mkdir(parents=True)
    (photographs / "0000.png").write_bytes(b"mine")
    with pytest.raises(InputError, match="lies in the capture's images"):
        render_path(toy_run.folder, photographs, frames=1)
    assert (photographs / "0000.png").read_bytes() == b"mine"
    longer = render_path(toy_run.folder, tmp_path / "frames", frames=3, size=(16, 12))
    for folder in (longer, toy_run.folder):
        before = sorted(folder.iterdir())
        with pytest.raises(InputError, match="holds other things"):
            render_path(toy_run.folder, folder, frames=2)
        assert sorted(folder.iterdir()) == before


def test_a_video_that_is_not_whole_is_not_kept(toy_run, tmp_path, monkeypatch):
    monkeypatch.setattr(cv2.VideoWriter, "write", lambda self, picture: None)  # as on a full disk
    (tmp_path / "flight.avi").write_bytes(b"old")
    with pytest.raises(InputError, match="only 0 of 2 frames"):
        render_path(toy_run.folder, tmp_path / "flight.avi", frames=2, size=(16, 12))
    assert (tmp_path / "flight.avi").read_bytes() == b"old"


def test_a_video_too_small_to_be_one(toy_run, tmp_path):
    with pytest.raises(InputError, match="a video of 1 x 8 px has no even size"):
        render_path(toy_run.folder, tmp_path / "flight.mp4", frames=1, size=(1, 8))
    assert (render_path(toy_run.folder, tmp_path / "flight.mp4", frames=1, size=(2, 3))).is_file()
