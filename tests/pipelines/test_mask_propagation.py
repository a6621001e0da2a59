"""Masks of all views from those of a few, on a tiny room."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from diga3d_warp.config import Effects
from diga3d_warp.errors import InputError
from diga3d_warp.gaussians import lift
from diga3d_warp.gaussians.lift import LiftSettings
from diga3d_warp.perception.boxes import Box
from diga3d_warp.pipelines.marking import OWN_MASKS, Marks, mark
from diga3d_warp.pipelines.mask_propagation import SHEET, propagate_masks
from diga3d_warp.pipelines.run import Run


def views_of(scene):
    return [*scene.views, *scene.test_views]


def box_around(view) -> Box:
    rows, columns = np.flatnonzero(view.mask.any(1)), np.flatnonzero(view.mask.any(0))
    return Box(view.name, int(columns[0]) - 1, int(rows[0]) - 1, int(columns[-1]) + 2, int(rows[-1]) + 2)


@pytest.fixture(scope="module")
def carried(removed, tmp_path_factory):
    marks = Marks(tuple(box_around(removed.scene.views[k]) for k in (0, 3, 6)))
    run = Run(tmp_path_factory.mktemp("boxes") / "run", "remove", {})
    scene = mark(run, removed.scene, marks)
    assert [view.mask is not None for view in scene.views] == [k in (0, 3, 6) for k in range(7)]
    assert all(view.mask is None for view in scene.test_views)
    return propagate_masks(run, scene, removed.result.source, marks, LiftSettings()), run


def test_every_view_gets_a_mask_near_the_true_one(carried, removed):
    masks, _ = carried
    overlaps = []
    for view in views_of(removed.scene):
        mine = masks[view.name]
        overlaps.append((mine & view.mask).sum() / (mine | view.mask).sum())
    assert np.mean(overlaps) > 0.45 and min(overlaps) > 0.1, "so short a fit has a ragged object"


def test_the_sheet_shows_every_view(carried):
    _, run = carried
    sheet = cv2.imread(str(run.folder / SHEET))
    assert sheet is not None and sheet.std() > 20
    pink = (sheet[..., 2].astype(int) - sheet[..., 1] > 40).mean()
    assert 0.005 < pink < 0.5


def test_without_marks_nothing_changes(removed, tmp_path):
    run = Run(tmp_path / "run", "remove", {})
    assert mark(run, removed.scene, OWN_MASKS) is removed.scene
    masks = propagate_masks(run, removed.scene, removed.result.source, OWN_MASKS, LiftSettings())
    assert all(masks[view.name] is view.mask for view in views_of(removed.scene))
    assert not (tmp_path / "run" / "stages").exists()


def test_a_mask_that_lifts_to_no_gaussian(removed, tmp_path):
    run = Run(tmp_path / "run", "remove", {})
    marks = Marks((box_around(removed.scene.views[1]),))
    scene = mark(run, removed.scene, marks)
    nowhere = removed.result.source.detached()
    nowhere.means += 1000.0
    with pytest.raises(InputError, match="the marked object lifts to no gaussian"):
        propagate_masks(run, scene, nowhere, marks, LiftSettings())


def test_gaussians_vote_as_the_run_renders_them(removed, tmp_path, monkeypatch):
    """Anti-aliasing makes splats wider and fainter: masks must be those of what was fitted."""
    seen = []

    def watched(gaussians, camera, effects):
        seen.append(effects)
        return project_for(gaussians, camera, effects)

    project_for = lift._projected
    monkeypatch.setattr(lift, "_projected", watched)
    marks = Marks((box_around(removed.scene.views[0]),))
    run = Run(tmp_path / "run", "remove", {})
    run.effects = Effects(antialias=True)
    scene = mark(run, removed.scene, marks)
    propagate_masks(run, scene, removed.result.source, marks, LiftSettings())
    assert seen and all(effects == run.effects for effects in seen)
