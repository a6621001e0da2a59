"""Situations: each seed another capture, its files true to each other, its captions to what is seen."""

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from diga3d_warp.cli import main
from diga3d_warp.errors import InputError
from diga3d_warp.scene.layouts.cameras_file import load_cameras
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.synthetic.generate import TEST_VIEWS, SyntheticScene, generate
from diga3d_warp.scene.synthetic.shots import set_stage, take
from diga3d_warp.scene.synthetic.situations.catalogue import SITUATIONS, build_situation

WIDTH, HEIGHT, VIEWS = 64, 48, 4


build = cache(build_situation)


class Seen:
    """A situation, lit with and without shadows where they are wanted, and views of it."""

    def __init__(self, name: str, seed: int = 1, shadows: bool = False) -> None:
        self.situation = build(name, seed)
        rng = np.random.default_rng(0)
        self.cameras = list(self.situation.orbit.cameras(WIDTH, HEIGHT, VIEWS, rng).values())
        # A ray to the lamp and four to the surroundings: noisy light, in a tenth of the time.
        light = replace(self.situation.scenery.lighting, lamp_strata=1, gather_strata=2)
        self.stage = set_stage(replace(self.situation.scenery, lighting=light), seed, shadows)
        self.shots = [take(self.stage, camera, 2, np.random.default_rng(0)) for camera in self.cameras]


@pytest.fixture(scope="module", params=SITUATIONS)
def seen(request) -> Seen:
    return Seen(request.param)


def test_pictures_show_something(seen):
    for shot in seen.shots:
        for picture in (shot.image, shot.without_object, shot.other_object, shot.other_material):
            assert picture.std() > 15
            assert 35 < picture.mean() < 215
            assert (picture == 0).all(-1).mean() < 0.02, "no view looks into nothing"
            assert (picture >= 254).all(-1).mean() < 0.1, "not burnt out"
        assert np.isfinite(shot.depth_without_object).all(), "something is seen everywhere"


def test_the_object_stands_in_the_middle_of_every_view(seen):
    for shot in seen.shots:
        assert 0.02 < shot.mask.mean() < 0.3
        rows, columns = np.nonzero(shot.mask)
        assert 0.25 * WIDTH < columns.mean() < 0.75 * WIDTH
        assert 0.2 * HEIGHT < rows.mean() < 0.8 * HEIGHT
        rim = np.ones_like(shot.mask)
        rim[1:-1, 1:-1] = False
        assert not (shot.mask & rim).any(), "all of it is seen"


def test_without_shadows_the_truth_differs_in_the_masks_alone(seen):
    for shot in seen.shots:
        for truth in (shot.without_object, shot.other_material):
            differs = (shot.image != truth).any(-1)
            assert not (differs & ~shot.mask).any()
            assert differs[shot.mask].mean() > 0.6
        nearer = shot.depth < shot.depth_without_object
        assert not (nearer & ~shot.mask).any()
        assert nearer.sum() > 0.7 * shot.mask.sum()
        other = (shot.other_object != shot.without_object).any(-1)
        assert 0.01 < other.mean() < 0.35


def test_the_object_stands_on_what_is_behind_it(seen):
    """Right below the object, without it, lies its support: it neither floats nor sinks."""
    low = seen.situation.scenery.thing.vertices
    assert low[:, 2].min() == pytest.approx(0.0, abs=0.02)
    foot = low[low[:, 2] < low[:, 2].min() + 0.01, :2]
    assert np.abs(foot.mean(0)).max() < 0.25
    for camera, shot in zip(seen.cameras, seen.shots, strict=True):
        at = camera.pose[:3, :3] @ np.zeros(3) + camera.pose[:3, 3]
        column, row = int(at[0] / at[2] * camera.fx + camera.cx), int(at[1] / at[2] * camera.fy + camera.cy)
        assert shot.depth_without_object[row, column] == pytest.approx(at[2], rel=0.06)


def test_depth_agrees_between_views(seen):
    """Points of one view, by its depth, are met at the same depth by the others, unless they are hidden."""
    camera, shot = seen.cameras[0], seen.shots[0]
    rows, columns = np.mgrid[:HEIGHT, :WIDTH].reshape(2, -1)
    depth = shot.depth_without_object.ravel()
    rays = [(columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy, np.ones(len(rows))]
    world = (np.stack(rays, -1) * depth[:, None] - camera.pose[:3, 3]) @ camera.pose[:3, :3]
    agreeing = 0
    for other, shown in zip(seen.cameras[1:], seen.shots[1:], strict=True):
        local = world @ other.pose[:3, :3].T + other.pose[:3, 3]
        ahead = local[:, 2] > 0.05
        column = np.floor(local[ahead, 0] / local[ahead, 2] * other.fx + other.cx).astype(int)
        row = np.floor(local[ahead, 1] / local[ahead, 2] * other.fy + other.cy).astype(int)
        inside = (column >= 0) & (column < WIDTH) & (row >= 0) & (row < HEIGHT)
        own = shown.depth_without_object[row[inside], column[inside]]
        relative = own / local[ahead, 2][inside] - 1
        hidden = relative < -0.05
        assert (relative[~hidden] < 0.05).mean() > 0.9, "nothing lies behind what another view sees"
        agreeing += int((np.abs(relative) < 0.05).sum())
    assert agreeing > 300


def test_captions_say_what_is_there(seen):
    captions = seen.situation.captions
    assert captions.object.startswith(("a ", "an "))
    assert captions.images.startswith(captions.object)
    assert captions.images.endswith(captions.without_object)
    assert captions.other_object.endswith(captions.without_object)
    assert (
        len({captions.images, captions.without_object, captions.other_object, captions.other_material}) == 4
    )
    assert captions.object not in captions.without_object
    for words in (captions.images, captions.other_object):
        assert not re.search(r"\ba [aeiou]|\ban [^aeiou]", words)


@pytest.mark.parametrize("name", SITUATIONS)
def test_seeds_vary_what_is_seen(name):
    made = [build(name, seed) for seed in range(4)]
    assert len({situation.captions.images for situation in made}) >= 3
    assert len({situation.orbit for situation in made}) == 4
    assert len({situation.scenery.lighting for situation in made}) == 4
    again = build_situation(name, 3)
    assert again.captions == made[3].captions and again.orbit == made[3].orbit
    assert np.array_equal(again.scenery.surroundings.vertices, made[3].scenery.surroundings.vertices)


def test_some_situations_are_seen_from_all_sides_and_some_from_the_front():
    around = [build(name, seed).orbit.around for name in SITUATIONS for seed in range(3)]
    assert 0.15 < np.mean(around) < 0.85


def test_shadows_fall_beside_the_object():
    dark, plain = Seen("tiles", 2, shadows=True), Seen("tiles", 2)
    change = [
        (a.image.astype(float) - b.image)[~a.mask].mean(-1)
        for a, b in zip(dark.shots, plain.shots, strict=True)
    ]
    assert (np.concatenate(change) < -8).mean() > 0.01


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Path:
    settings = SyntheticScene(width=WIDTH, height=HEIGHT, views=VIEWS, situation="tiles", seed=2)
    return generate(settings, tmp_path_factory.mktemp("situation") / "tiles")


def test_a_capture_has_the_usual_layout_and_captions(capture):
    scene = load_scene(capture)
    assert len(scene.views) + len(scene.test_views) == VIEWS
    assert all(view.mask is not None and view.mask.any() for view in scene.views)
    captions = json.loads((capture / "captions.json").read_text())
    described = build("tiles", 2).captions
    assert captions["images"] == described.images and captions["material"] == described.material
    for folder in ("without_object", "other_object", "other_material"):
        assert captions[folder]
        assert len(list((capture / "ground_truth" / folder).glob("*.png"))) == VIEWS
    settings = json.loads((capture / "scene.json").read_text())
    assert settings["situation"] == "tiles" and settings["seed"] == 2


def test_test_views_are_from_elsewhere_and_without_the_object(capture):
    folder = capture / "ground_truth" / "elsewhere"
    test = load_cameras(folder / "views.json").test
    assert len(test) == TEST_VIEWS
    taken = np.stack([view.camera.center for view in load_scene(capture, hold_out=0).views])
    for name, camera in test.items():
        image, depth = (
            cv2.imread(str(folder / "images" / f"{name}.png")),
            np.load(folder / "depth" / f"{name}.npy"),
        )
        assert image.shape == (HEIGHT, WIDTH, 3) and image.std() > 15
        assert depth.shape == (HEIGHT, WIDTH) and np.isfinite(depth).all()
        assert np.linalg.norm(taken - camera.center, axis=1).min() > 0.05
        at = camera.pose[:3, 3]  # the origin, where the object stood
        row, column = int(at[1] / at[2] * camera.fy + camera.cy), int(at[0] / at[2] * camera.fx + camera.cx)
        assert depth[row, column] == pytest.approx(at[2], rel=0.06)


def test_same_seed_same_bytes(capture, tmp_path):
    settings = SyntheticScene(width=WIDTH, height=HEIGHT, views=VIEWS, situation="tiles", seed=2)
    again = generate(settings, tmp_path / "again")
    files = sorted(file.relative_to(capture) for file in capture.rglob("*") if file.is_file())
    assert len(files) > 30
    for file in files:
        assert (capture / file).read_bytes() == (again / file).read_bytes(), file


def test_an_unknown_situation_is_one_line(tmp_path, capsys):
    with pytest.raises(InputError, match="no situation is called 'kitchen': use one of rug"):
        SyntheticScene(situation="kitchen")
    with pytest.raises(SystemExit) as stopped:
        main(["synthetic", str(tmp_path / "out"), "--situation", "kitchen"])
    error = capsys.readouterr().err
    assert stopped.value.code == 2 and error.count("\n") == 1 and "kitchen" in error and "tiles" in error
    assert not (tmp_path / "out").exists()
