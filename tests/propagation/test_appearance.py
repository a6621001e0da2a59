"""Views that attend to references, on the floor of the filling tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from test_fill import CAMERAS, background, floor_color, floor_points

from diga3d_warp.priors.conditioning import Guidance, Prompts
from diga3d_warp.priors.exemplar.prior import ExemplarPrior
from diga3d_warp.priors.settings import SamplingSettings
from diga3d_warp.propagation.appearance import propagate_appearance
from diga3d_warp.propagation.fill import Fill, warp_fills
from diga3d_warp.propagation.references import References
from gaussian_prior import GaussianPrior

TINT = np.array([0.0, 0.0, 0.5], np.float32)
REFERENCES = References([0], np.zeros(len(CAMERAS), np.int64))
QUICK = SamplingSettings(steps=4)


@pytest.fixture(scope="module")
def backgrounds():
    found = [background(camera) for camera in CAMERAS]
    # Nothing is missing in the last view.
    return [*found[:-1], replace(found[-1], unseen=np.zeros_like(found[-1].unseen))]


@pytest.fixture(scope="module")
def depths():
    return [floor_points(camera)[1] for camera in CAMERAS]


@pytest.fixture(scope="module")
def fills(backgrounds, depths):
    """The reference's fill is the floor in a tint that no known pixel has."""
    unseen = backgrounds[0].unseen
    image = backgrounds[0].image.copy()
    image[unseen] = (floor_color(floor_points(CAMERAS[0])[0]) + TINT)[unseen]
    depth = np.where(unseen, depths[0], 0.0).astype(np.float32)
    first = Fill(image, depth, unseen, unseen, np.zeros_like(unseen))
    return warp_fills(CAMERAS, backgrounds, depths, REFERENCES, [first])


def propagated(fills, backgrounds, depths, sampling=QUICK, **options):
    return propagate_appearance(ExemplarPrior(), fills, backgrounds, depths, REFERENCES, sampling, **options)


@pytest.fixture(scope="module")
def attending(fills, backgrounds, depths):
    return propagated(fills, backgrounds, depths)


def test_holes_are_filled_and_nothing_else_changes(attending, fills, backgrounds):
    assert attending[0] is fills[0], "the reference is as it was"
    assert attending[3] is fills[3], "nothing was missing"
    for i in (1, 2):
        unseen = backgrounds[i].unseen
        assert np.array_equal(attending[i].image[~unseen], fills[i].image[~unseen])
        assert np.abs(attending[i].image - fills[i].image)[unseen].mean() > 0.01
        assert attending[i].image[unseen].std() > 0.01, "not blank"
        assert np.array_equal(attending[i].filled, unseen)
        assert (attending[i].depth[unseen] > 0).all() and (attending[i].depth[~unseen] == 0).all()


def blueness(fill, where):
    return float((fill.image[where][:, 2] - fill.image[where][:, 0]).mean())


def test_attention_brings_the_reference_s_colour(attending, fills, backgrounds, depths):
    """The tint stands in the reference alone, not in any view's surroundings."""
    alone = propagated(fills, backgrounds, depths, attend=False)
    for i in (1, 2):
        unseen = backgrounds[i].unseen
        assert blueness(attending[i], unseen) > blueness(alone[i], unseen) + 0.1


def test_without_weight_attention_is_none(fills, backgrounds, depths):
    nothing = propagated(fills, backgrounds, depths, replace(QUICK, afp_weight=0.0))
    alone = propagated(fills, backgrounds, depths, attend=False)
    for i in (1, 2):
        assert np.array_equal(nothing[i].image, alone[i].image)


def test_a_negative_prompt_leads_away_from_the_object(fills, backgrounds, depths):
    """The object is red; what is told as known shows it within the mask."""
    plain, away = (
        propagate_appearance(ExemplarPrior(negative=negative), fills, backgrounds, depths, REFERENCES, QUICK)
        for negative in ("", "something red")
    )
    unseen = backgrounds[1].unseen
    assert away[1].image[unseen][:, 0].mean() < plain[1].image[unseen][:, 0].mean() - 0.01


def test_where_no_fill_arrived_the_view_is_its_own_inventor(fills, backgrounds, depths):
    missing = backgrounds[1].unseen & (np.arange(96) > 50)
    gap = replace(
        fills[1], missing=missing, filled=fills[1].filled & ~missing,
        depth=np.where(missing, 0.0, fills[1].depth).astype(np.float32),
    )  # fmt: skip
    for strength in (0.5, 1.0):
        sampling = replace(QUICK, strength=strength)
        found = propagated([fills[0], gap, *fills[2:]], backgrounds, depths, sampling)[1]
        assert np.array_equal(found.invented, missing) and not found.missing.any()
        near = depths[1][missing]
        assert np.abs(found.depth[missing] / near - 1.0).max() < 0.05, "the floor goes on"
        assert found.image[missing][:, 0].mean() < 0.9, "not the red object"


def test_same_seed_same_bytes(attending, fills, backgrounds, depths):
    again = propagated(fills, backgrounds, depths)
    assert all(np.array_equal(a.image, b.image) for a, b in zip(again, attending, strict=True))
    assert torch.from_numpy(again[1].image).dtype == torch.float32


def test_sampling_can_start_from_the_inverted_fill(fills, backgrounds, depths):
    """With the prompt that describes it, the fill comes back; from the photograph its object would."""
    prior = GaussianPrior(spread=0.3)
    prior.guidance, settings = Guidance(Prompts(0.0, 0.0), scale=1.0), SamplingSettings(steps=100)
    from_fill, from_photograph = (
        propagate_appearance(
            prior, fills, backgrounds, depths, REFERENCES, settings, attend=False, inversion=inversion
        )
        for inversion in ("fill", "photograph")
    )
    for i in (1, 2):
        holes = backgrounds[i].unseen & fills[i].filled
        assert np.abs(from_fill[i].image - fills[i].image)[holes].mean() < 0.02
        assert np.abs(from_photograph[i].image - backgrounds[i].image)[holes].mean() < 0.02
        assert np.abs(from_photograph[i].image - from_fill[i].image)[holes].mean() > 0.1
