"""A glossy support mirrors what stands on it, and the truth without the object does not show it."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from diga3d_warp.cli import main
from diga3d_warp.errors import InputError
from diga3d_warp.scene.synthetic.generate import SyntheticScene, generate
from diga3d_warp.scene.synthetic.gloss import level_faces
from diga3d_warp.scene.synthetic.shots import Shot, Stage, set_stage, take, take_alone
from diga3d_warp.scene.synthetic.situations.catalogue import SITUATIONS, build_situation

WIDTH, HEIGHT = 96, 72


@cache
def situation():
    return build_situation("tiles", 1)


def camera():
    return list(situation().orbit.cameras(WIDTH, HEIGHT, 8, np.random.default_rng(0)).values())[4]


@cache
def stage(gloss: float | None) -> Stage:
    scenery = situation().scenery
    light = replace(scenery.lighting, lamp_strata=1, gather_strata=2)
    return set_stage(replace(scenery, lighting=light), 1, False, gloss)


@cache
def shot(gloss: float | None) -> Shot:
    return take(stage(gloss), camera(), 2, np.random.default_rng(0))


def change(picture: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.abs(picture.astype(int) - other.astype(int)).max(axis=-1)


def test_the_mirror_image_hangs_under_the_object():
    at = camera()
    differs = (change(shot(0.5).image, shot(0.5).without_object) > 8) & ~shot(0.5).mask
    assert differs.sum() > 100
    # Corners of the object, mirrored in the floor, enclose it in the image.
    corners = situation().scenery.thing.vertices * [1.0, 1.0, -1.0]
    local = corners @ at.pose[:3, :3].T + at.pose[:3, 3]
    x, y = (local[:, :2] / local[:, 2:] * (at.fx, at.fy) + (at.cx, at.cy)).T
    rows, columns = np.nonzero(differs)
    assert (columns >= x.min() - 2).all() and (columns <= x.max() + 2).all()
    assert (rows >= y.min() - 2).all() and (rows <= y.max() + 2).all()


def test_masks_and_depth_are_those_of_the_matte_capture():
    glossy, matte = shot(0.5), shot(None)
    assert np.array_equal(glossy.mask, matte.mask)
    assert np.array_equal(glossy.depth, matte.depth)
    assert np.array_equal(glossy.depth_without_object, matte.depth_without_object)


def test_more_gloss_shows_more():
    seen = [
        change(shot(gloss).image, shot(gloss).without_object)[~shot(gloss).mask].sum()
        for gloss in (None, 0.1, 0.5)
    ]
    assert seen[0] == 0 < seen[1] < seen[2]


def test_each_truth_has_its_own_mirror_image():
    glossy = shot(0.5)
    below = (change(glossy.image, glossy.without_object) > 8) & ~glossy.mask
    assert (change(glossy.other_material, glossy.image)[below] > 4).mean() > 0.5
    assert (change(glossy.other_object, glossy.without_object) > 8).sum() > 100


def test_views_from_elsewhere_mirror_the_room_alone():
    image, _ = take_alone(stage(0.5), camera(), 2)
    assert np.array_equal(image, shot(0.5).without_object)
    assert change(image, shot(None).without_object).max() > 8


@pytest.mark.parametrize("name", [name for name in SITUATIONS if name != "lawn"])
def test_every_other_situation_has_a_level_support(name):
    surface = build_situation(name, 0).scenery.surroundings
    level = level_faces(surface)
    near = np.abs(surface.vertices[surface.faces[level]][..., :2]).max(axis=(1, 2)) < 0.5
    assert near.any()


def test_the_capture_says_that_it_is_glossy(tmp_path):
    settings = SyntheticScene(width=32, height=24, views=2, situation="tiles", gloss=0.3)
    told = json.loads((generate(settings, tmp_path / "glossy") / "scene.json").read_text())
    assert told["gloss"] == 0.3


@pytest.mark.parametrize(
    ("wrong", "said"), [({"gloss": 1.5}, "no reflectance"), ({"gloss": 0.3, "situation": "lawn"}, "lawn")]
)
def test_gloss_that_makes_no_sense_is_one_line(wrong, said):
    with pytest.raises(InputError, match=said):
        SyntheticScene(**wrong)


def test_the_command_line_takes_a_share(tmp_path, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["synthetic", str(tmp_path / "out"), "--gloss", "2"])
    assert stopped.value.code == 2 and "from 0 to 1" in capsys.readouterr().err
