"""plan_effects: each effect is switched by what calls for it, and by nothing else."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from floor import FOCAL, HEIGHT, WIDTH, Floor

from diga3d_warp.bench.still_life import still_life, still_life_camera
from diga3d_warp.config import Effects
from diga3d_warp.effects import evidence
from diga3d_warp.effects.observations import observe
from diga3d_warp.effects.plan import EffectsPlan, plan_effects
from diga3d_warp.effects.prices import fastest, priced, toggled
from diga3d_warp.effects.thresholds import THRESHOLDS
from diga3d_warp.gaussians.initialise import initialise
from diga3d_warp.scene.camera import Distortion
from diga3d_warp.scene.load import load_scene
from scenes import random_gaussians

OFF = Effects(sh_degree=0, lens=False, depth=False, background=False, surround=True)

GAINS = tuple(1.0 + 0.15 * np.sin(2.5 * np.arange(14)))


def said(plan: EffectsPlan, effect: str) -> str:
    return next(choice.evidence for choice in plan.choices if choice.effect == effect)


def by(plan: EffectsPlan, effect: str) -> str:
    return next(choice.by for choice in plan.choices if choice.effect == effect)


@pytest.fixture(scope="module")
def matte():
    return Floor().scene()


def test_a_matte_floor_under_one_exposure_calls_for_nothing(matte):
    assert plan_effects(matte).effects == OFF


def test_a_sheen_calls_for_harmonics_and_for_nothing_else():
    effects = plan_effects(Floor(gloss=0.3).scene()).effects
    assert effects.sh_degree is not None and effects.sh_degree >= 1
    assert effects == Effects(**{**vars(OFF), "sh_degree": effects.sh_degree})


def test_drifting_exposure_calls_for_exposure_and_not_for_harmonics():
    plan = plan_effects(Floor(gains=GAINS).scene())
    assert plan.effects == Effects(**{**vars(OFF), "exposure": True})
    gains = np.array(GAINS) / np.mean(GAINS)
    drift = 255 * np.sqrt((((gains - 1) * 0.5) ** 2).mean())
    assert float(said(plan, "exposure").split()[3]) == pytest.approx(drift, rel=0.15)


def test_found_transforms_are_those_of_the_photographs():
    observed = observe(Floor(gains=GAINS).scene(), THRESHOLDS)
    transforms = evidence.color_transforms(observed, THRESHOLDS)
    middle = transforms[:, 0] * 0.5 + transforms[:, 1]
    np.testing.assert_allclose(middle, np.tile(0.5 * np.array(GAINS)[:, None] / np.mean(GAINS), 3), atol=0.01)
    np.testing.assert_allclose(transforms.mean(0), [[1, 1, 1], [0, 0, 0]], atol=1e-9)


def test_harmonics_are_blamed_where_the_user_forbids_exposure():
    scene = Floor(gains=GAINS).scene()
    plan = plan_effects(scene, overrides={"exposure": False})
    assert plan.effects.exposure is False and by(plan, "exposure") == "user"
    assert said(plan, "sh_degree") != said(plan_effects(scene), "sh_degree")


def test_what_is_hidden_does_not_spoil_the_evidence():
    """Where the board is, its rim excepted, no point of the floor passes."""
    scene = Floor(board=True).scene()
    observed = observe(scene, THRESHOLDS)
    floor = np.nanmedian(observed.colors, axis=0).max(1) > 0.1
    hidden = observed.colors[:, floor].max(2) < 0.1
    assert hidden.sum() < 0.03 * observed.seen[:, floor].sum()
    everything = replace(THRESHOLDS, depth_tolerance=np.inf)
    observed = observe(scene, everything)
    floor = np.nanmedian(observed.colors, axis=0).max(1) > 0.1
    assert (observed.colors[:, floor].max(2) < 0.1).sum() > 0.1 * observed.seen[:, floor].sum()


def test_a_lens_is_judged_by_its_shift_at_the_corner():
    radius = np.hypot(WIDTH - 1, HEIGHT - 1) / 2 / FOCAL
    for shift, wanted in ((1.0, True), (0.1, False)):
        k1 = shift / FOCAL / radius**3
        plan = plan_effects(Floor(lens=Distortion("brown", (k1, 0.0, 0.0, 0.0))).scene())
        assert plan.effects.lens is wanted
        assert float(said(plan, "lens").split()[-2]) == pytest.approx(shift, rel=0.1)


def test_an_octave_of_distances_calls_for_antialiasing():
    spreads = []
    for distances, wanted in (((1.5, 4.0), True), ((1.8, 2.0), False)):
        plan = plan_effects(Floor(distances=distances).scene())
        assert plan.effects.antialias is wanted
        spreads.append(float(said(plan, "antialias").split()[-1]))
    # More than the cameras' own ratio: each sees a near and a far part of the floor.
    assert 4.0 / 1.5 < spreads[0] < 4.5 and 2.0 / 1.8 < spreads[1] < 1.7


def test_too_few_points_keep_the_defaults_and_say_so():
    plan = plan_effects(Floor(points=20).scene())
    assert plan.effects == Effects(**{**vars(OFF), "sh_degree": 3})
    assert by(plan, "sh_degree") == "default" and "sparse points are seen by 8 views" in plan.notes[0]
    assert plan.notes[0] in plan.table().text()


def test_a_splat_is_rendered_as_it_was_fitted(matte):
    plan = plan_effects(matte, random_gaussians(10, degree=2))
    assert plan.effects == Effects(**{**vars(OFF), "sh_degree": 2, "surround": False})
    assert by(plan, "sh_degree") == by(plan, "exposure") == by(plan, "pixel_order") == "splat"
    assert said(plan, "pixel_order").startswith("fitted without; sorting each pixel would change it by")


def test_a_splat_fitted_with_antialiasing_is_rendered_with_it(matte):
    plan = plan_effects(matte, random_gaussians(10), antialiased=True)
    assert plan.effects.antialias and by(plan, "antialias") == "splat"
    assert said(plan, "antialias") == "its file says that it was fitted with it"
    assert not plan_effects(
        matte, random_gaussians(10), antialiased=True, overrides={"antialias": False}
    ).effects.antialias


def test_the_order_of_pixels_changes_crossing_discs_and_not_a_stack():
    crossing = still_life().select(torch.arange(-2, 0))
    apart = crossing.detached()
    apart.means[1, 1] += 5.0
    camera = [still_life_camera(64, 48)]
    assert evidence.order_change(crossing, camera, THRESHOLDS) > 1.0
    assert evidence.order_change(apart, camera, THRESHOLDS) < 1e-4, "two kernels round differently"


def test_the_user_decides_and_the_evidence_stays(matte):
    wishes = {"sh_degree": 2, "lens": True, "antialias": True, "exposure": True, "pixel_order": True}
    plan, free = plan_effects(matte, overrides=wishes), plan_effects(matte)
    assert plan.effects == Effects(**{**vars(OFF), **wishes})
    assert {choice.effect for choice in plan.choices if choice.by == "user"} == set(wishes)
    for effect in ("lens", "antialias", "exposure"):
        assert said(plan, effect) == said(free, effect)


def test_a_plan_survives_json(matte):
    plan = plan_effects(matte)
    assert EffectsPlan.from_json(json.loads(json.dumps(plan.as_json()))) == plan


def test_an_error_left_out_is_that_of_a_fit_without_the_view(matte):
    """The closed form against a ridge regression for each view and point."""
    observed = observe(Floor(gloss=0.3, points=400).scene(), THRESHOLDS)
    errors = evidence.view_dependence(observed, observed.colors, THRESHOLDS)
    for degree in range(4):
        means = []
        for point in range(observed.colors.shape[1]):
            colors = observed.colors[:, point]
            seen = np.abs(colors - np.nanmedian(colors, axis=0)).max(1) < THRESHOLDS.outlier
            if seen.sum() < THRESHOLDS.views_least:
                continue
            colors = colors[seen]
            basis = evidence.harmonics(observed.directions[seen, point], degree)
            penalty = np.diag([1e-9] + [THRESHOLDS.ridge] * (basis.shape[1] - 1))
            squares = []
            for view in range(len(basis)):
                others = np.arange(len(basis)) != view
                a, b = basis[others], colors[others]
                found = np.linalg.solve(a.T @ a + penalty, a.T @ b)
                squares.append((basis[view] @ found - colors[view]) ** 2)
            means.append(np.mean(squares))
        if degree == 0:
            kept = np.array(means) <= np.quantile(means, 1.0 - THRESHOLDS.worst_share)
        assert errors[degree] == pytest.approx(255 * np.sqrt(np.array(means)[kept].mean()), rel=1e-6)


def test_harmonics_are_orthonormal():
    steps = 400
    z, turn = np.meshgrid((np.arange(steps) + 0.5) / steps * 2 - 1, np.arange(steps) / steps * 2 * np.pi)
    flat = np.sqrt(1 - z**2)
    basis = evidence.harmonics(np.stack([flat * np.cos(turn), flat * np.sin(turn), z], -1), 3).reshape(-1, 16)
    np.testing.assert_allclose(basis.T @ basis * 4 * np.pi / steps**2, np.eye(16), atol=1e-3)


def test_every_effect_that_a_step_computes_has_a_price(matte):
    plan = priced(plan_effects(matte), initialise(matte.points), matte.views[0].camera)
    costs = {choice.effect: choice.cost_ms for choice in plan.choices}
    measured = {"sh_degree", "antialias", "depth", "median_depth", "normals", "exposure", "background"}
    assert {name for name, cost in costs.items() if cost is not None} == measured
    assert plan.effects == plan_effects(matte).effects
    assert "would be" in plan.table().text() and "not measured" in plan.table().text()


def test_toggling_switches_one_effect():
    for name in ("lens", "antialias", "exposure", "background", "depth"):
        changed = vars(toggled(OFF, name))
        assert {key for key in changed if changed[key] != vars(OFF)[key]} == {name}
    assert toggled(OFF, "sh_degree").sh_degree == 3
    assert toggled(Effects(sh_degree=2), "sh_degree").sh_degree == 0


def test_what_the_time_does_not_reach_has_no_price():
    assert set(fastest({"first": lambda: None, "second": lambda: None}, 3, -1.0)) == {"first"}
    assert set(fastest({"first": lambda: None, "second": lambda: None}, 3, 60.0)) == {"first", "second"}


CAPTURES = Path(os.environ.get("DIGA3D_CAPTURES", "no captures named"))


@pytest.mark.captures
@pytest.mark.skipif(not CAPTURES.is_dir(), reason="the real captures are not here")
def test_bear_needs_its_lens_and_its_sheen():
    effects = plan_effects(load_scene(CAPTURES / "bear", image_scale=0.5)).effects
    assert effects.lens and effects.sh_degree >= 1


def test_planning_reads_no_gradient_and_leaves_the_scene(matte):
    before = [view.pixels.copy() for view in matte.views]
    plan_effects(matte)
    assert all(np.array_equal(a, view.pixels) for a, view in zip(before, matte.views, strict=True))
    assert torch.is_grad_enabled()


def cut_out(scene, share: float, every: int = 1):
    """The scene with a transparent part, a share of the width from the left, in each `every`-th view."""
    views = []
    for number, view in enumerate(scene.views):
        alpha = np.full(view.pixels.shape[:2], 255, np.uint8)
        alpha[:, : round(share * WIDTH)] = 0
        pixels = np.where(alpha[..., None] > 0, view.pixels, 255).astype(np.uint8)
        cut = number % every == 0
        views.append(replace(view, pixels=pixels, alpha=alpha) if cut else view)
    return replace(scene, views=views)


def test_transparent_pixels_call_for_a_background_and_for_nothing_else(matte):
    plan = plan_effects(cut_out(matte, 0.25))
    assert plan.effects == Effects(**{**vars(OFF), "background": True, "surround": False})
    assert by(plan, "background") == "scene"
    assert said(plan, "background") == "25 % of all pixels are transparent, in 14 of 14 photographs"
    assert "12.5 %" in said(plan_effects(cut_out(matte, 0.25, every=2)), "background")
    assert said(plan_effects(cut_out(matte, 0.25, every=2)), "background").endswith("7 of 14 photographs")
    costed = priced(plan, initialise(matte.points), matte.views[0].camera)
    assert next(choice for choice in costed.choices if choice.effect == "background").cost_ms is not None


def test_opaque_photographs_call_for_no_background(matte):
    plan = plan_effects(matte)
    assert not plan.effects.background
    assert said(plan, "background") == "the photographs cover their frames"


def test_directions_that_no_photograph_looks_into_call_for_a_surround(matte):
    plan = plan_effects(matte)
    assert plan.effects.surround and by(plan, "surround") == "scene"
    share = said(plan, "surround").removeprefix("the photographs look into ").split(" ")[0]
    assert 0 < int(share) < 60
    assert not plan_effects(matte, overrides={"surround": False}).effects.surround
    everywhere = replace(THRESHOLDS, directions=int(share) / 100 - 0.01)
    assert not plan_effects(matte, thresholds=everywhere).effects.surround


def test_what_was_cut_out_gets_no_surround(matte):
    plan = plan_effects(cut_out(matte, 0.25))
    assert plan.effects.background and not plan.effects.surround
    assert said(plan, "surround").endswith("nothing behind it")


def test_a_given_splat_keeps_its_surround_and_gets_none(matte):
    splat = initialise(matte.points)
    for surrounded in (False, True):
        plan = plan_effects(matte, splat, surrounded=surrounded)
        assert plan.effects.surround is surrounded and by(plan, "surround") == "splat"


def test_the_user_has_the_last_word_on_the_background(matte):
    for scene, wish in ((cut_out(matte, 0.25), False), (matte, True)):
        plan = plan_effects(scene, overrides={"background": wish})
        assert plan.effects.background is wish and by(plan, "background") == "user"


def test_points_are_not_read_where_a_photograph_is_transparent(matte):
    """The floor's points on white would be outliers, and near the rim a little too bright."""
    observed = observe(cut_out(matte, 0.25), THRESHOLDS)
    whole = observe(matte, THRESHOLDS)
    assert 0.5 < observed.seen.sum() / whole.seen.sum() < 0.9
    assert np.nanmax(observed.colors) < np.nanmax(whole.colors) + 0.02
