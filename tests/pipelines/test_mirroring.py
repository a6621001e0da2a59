"""The stage of the mirror image: what it finds goes with the object, into masks, gaussians and the plan."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from diga3d_warp.effects.plan import plan_effects
from diga3d_warp.gaussians.lift import LiftSettings
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.kernels.harmonics import C0
from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.mirrors.reflection import mirrored
from diga3d_warp.pipelines import clearing
from diga3d_warp.pipelines.clearing import MaskSettings, widened
from diga3d_warp.pipelines.mirroring import Image, find_image
from diga3d_warp.pipelines.run import Run
from diga3d_warp.pipelines.standing import Masked
from diga3d_warp.scene.scene import Points, Scene, View
from diga3d_warp.splatting.placement import unprojected
from glossy import AROUND, RADIUS, TALL, met, mirror_photo, painted, pillar, support
from tabletop import HEIGHT, WIDTH, camera_at, checks

GLOSS = 0.3


def photographed(number: int, gloss: float) -> View:
    """A photograph of the pillar on its floor, with its mask."""
    eye = AROUND[number]
    camera = camera_at(eye)
    pixels = mirror_photo(eye, checks, gloss, hole=0.0).pixels.copy()
    directions = unprojected(np.ones((HEIGHT, WIDTH)), camera) - camera.center
    hit, turn, height = met(camera.center + 0.0 * directions, directions, RADIUS, 0.0, TALL)
    pixels[hit] = np.round(255.0 * painted(turn, height)[hit] ** (1.0 / GAMMA))
    return View(f"{number:02d}", camera, pixels, hit)


def floor() -> Gaussians:
    places = np.stack(np.meshgrid(*[np.linspace(-1.6, 1.6, 70)] * 2), axis=-1).reshape(-1, 2)
    count = len(places)
    return Gaussians(
        torch.from_numpy(np.concatenate([places, np.zeros((count, 1))], axis=1)).float(),
        torch.log(torch.tensor([0.035, 0.035, 0.002])).repeat(count, 1),
        torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        torch.full((count,), 4.0),
        torch.from_numpy((checks(places[:, 0], places[:, 1]) - 0.5) / C0).float()[:, None, :],
    )


@cache
def scene(gloss: float = GLOSS) -> Scene:
    views = [photographed(number, gloss) for number in range(len(AROUND))]
    points = floor().means.double().numpy()[::9]
    sparse = Points(points, np.zeros((len(points), 3), np.uint8))
    return Scene(Path("nowhere"), "colmap", views=views[1:], test_views=views[:1], points=sparse)


@dataclass(frozen=True)
class Splat:
    """A splat as a fit leaves it: the floor, the object, and what shows its mirror image."""

    gaussians: Gaussians
    rows: torch.Tensor
    under: torch.Tensor


@cache
def splat() -> Splat:
    thing = pillar(count=1500)
    whole = floor().joined(thing).joined(mirrored(thing, support().frame))
    numbers = torch.arange(len(whole))
    first, count = len(floor()), len(thing)
    return Splat(whole, (numbers >= first) & (numbers < first + count), numbers >= first + count)


def masks(of: Scene) -> clearing.Masks:
    return {view.name: widened(np.asarray(view.mask), MaskSettings()) for view in [*of.views, *of.test_views]}


def found(folder: Path, gloss: float, wish: bool | None = None, **options) -> tuple[Run, Image | None]:
    of, made = scene(gloss), splat()
    run = Run(folder, "remove", {})
    overrides = {} if wish is None else {"mirror": wish}
    plan = plan_effects(of, takes_out=True, overrides=overrides)
    run.effects = replace(plan.effects, lens=False)
    run.record("effects", plan.as_json())
    thing = Masked(run, of, masks(of), made.gaussians, made.rows, LiftSettings(), MaskSettings(), 0)
    return run, find_image(thing, wish, **options)


def choice(run: Run) -> dict:
    return next(each for each in run.recorded("effects")["choices"] if each["effect"] == "mirror")


def test_the_mirror_image_goes_with_the_object(tmp_path):
    run, image = found(tmp_path / "run", GLOSS)
    assert image is not None and choice(run)["value"] is True and choice(run)["by"] == "scene"
    assert run.effects.mirror
    for view in [*scene().views, *scene().test_views]:
        plain = scene(0.0)
        matte = next(each for each in [*plain.views, *plain.test_views] if each.name == view.name)
        bare = photographed(int(view.name), GLOSS)
        assert np.array_equal(bare.pixels, view.pixels) and matte.pixels.std() > 10
        shown = image.masks[view.name] & ~masks(scene())[view.name]
        assert 20 < shown.sum() < 0.15 * shown.size, "under the foot, and not everywhere"
        both = image.with_object(masks(scene()))[view.name]
        assert np.array_equal(both, image.masks[view.name] | masks(scene())[view.name])
    deep = splat().gaussians.means[:, 2] < -0.2 * TALL
    assert image.rows[splat().under & deep].float().mean() > 0.9
    assert not image.rows[~splat().under].any(), "neither the floor nor the object itself"
    picture = cv2.imread(str(tmp_path / "run" / "mirror.png"))
    assert picture is not None and picture.std() > 10


def test_a_matte_floor_keeps_its_masks(tmp_path):
    run, image = found(tmp_path / "run", 0.0)
    assert image is None and choice(run)["value"] is False and not run.effects.mirror
    assert not (tmp_path / "run" / "mirror.png").exists()


def test_the_user_may_insist(tmp_path):
    run, image = found(tmp_path / "run", 0.0, wish=True)
    assert image is not None and choice(run)["by"] == "user" and choice(run)["value"] is True


@pytest.mark.parametrize(("wish", "options"), [(False, {}), (None, {"filled": True})])
def test_where_it_is_not_looked_for_there_is_no_stage(tmp_path, wish, options):
    run, image = found(tmp_path / "run", GLOSS, wish, **options)
    assert image is None and choice(run)["value"] is False
    assert not (tmp_path / "run" / "stages" / "mirror").exists()
    assert "not looked for" in choice(run)["evidence"]
