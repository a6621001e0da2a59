"""Masks of all views from boxes in a few of them, on a tiny room."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from diga3d_warp import cli
from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.lift import LiftSettings
from diga3d_warp.perception.boxes import Box
from diga3d_warp.pipelines.boxing import SHEET, boxed, carry_masks
from diga3d_warp.pipelines.run import Run


def views_of(scene):
    return [*scene.views, *scene.test_views]


def box_around(view) -> Box:
    rows, columns = np.flatnonzero(view.mask.any(1)), np.flatnonzero(view.mask.any(0))
    return Box(view.name, int(columns[0]) - 1, int(rows[0]) - 1, int(columns[-1]) + 2, int(rows[-1]) + 2)


@pytest.fixture(scope="module")
def carried(removed, tmp_path_factory):
    boxes = [box_around(removed.scene.views[k]) for k in (0, 3, 6)]
    run = Run(tmp_path_factory.mktemp("boxes") / "run", "remove", {})
    scene = boxed(removed.scene, boxes)
    assert [view.mask is not None for view in scene.views] == [k in (0, 3, 6) for k in range(7)]
    assert all(view.mask is None for view in scene.test_views)
    return carry_masks(run, scene, removed.result.source, boxes, LiftSettings()), run


def test_every_view_gets_a_mask_near_the_true_one(carried, removed):
    scene, _ = carried
    overlaps = []
    for mine, true in zip(views_of(scene), views_of(removed.scene), strict=True):
        overlaps.append((mine.mask & true.mask).sum() / (mine.mask | true.mask).sum())
    assert np.mean(overlaps) > 0.45 and min(overlaps) > 0.1, "so short a fit has a ragged object"


def test_the_sheet_shows_every_view(carried):
    _, run = carried
    sheet = cv2.imread(str(run.folder / SHEET))
    assert sheet is not None and sheet.std() > 20
    pink = (sheet[..., 2].astype(int) - sheet[..., 1] > 40).mean()
    assert 0.005 < pink < 0.5


def test_without_boxes_nothing_changes(removed, tmp_path):
    run = Run(tmp_path / "run", "remove", {})
    assert boxed(removed.scene, []) is removed.scene
    assert carry_masks(run, removed.scene, removed.result.source, [], LiftSettings()) is removed.scene
    assert not (tmp_path / "run" / "stages").exists()


def test_a_mask_that_lifts_to_no_gaussian(removed, tmp_path):
    box = box_around(removed.scene.views[1])
    scene = boxed(removed.scene, [box])
    nowhere = removed.result.source.detached()
    nowhere.means += 1000.0
    with pytest.raises(InputError, match="the mask boxes lift to no gaussian"):
        carry_masks(Run(tmp_path / "run", "remove", {}), scene, nowhere, [box], LiftSettings())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nobody", "1", "2", "30", "40"], "there is no view 'nobody'"),
        (["view_001", "1", "2", "300", "40"], "is not within its 96 x 72 px"),
        (["view_001", "1", "2", "3", "x"], "are not four whole numbers"),
    ],
)
@pytest.mark.parametrize("command", [["remove"], ["retexture", "--prompt", "gold"]])
def test_bad_boxes_are_one_line_and_leave_nothing(room, tmp_path, capfd, command, words, said):
    arguments = [*command, str(room), "--out", str(tmp_path / "run"), "--mask-box", *words]
    assert cli.main(arguments) == 2
    lines = [line for line in capfd.readouterr().err.replace("\r", "\n").splitlines() if "error" in line]
    assert len(lines) == 1 and said in lines[0]
    assert not (tmp_path / "run").exists()
