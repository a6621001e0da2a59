"""The mirror image of a pillar: found where there is one, and not taken from shadows, stains or windows."""

from dataclasses import replace

import numpy as np
import pytest

from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.mirrors.find import MirrorEvidence
from diga3d_warp.splatting.placement import unprojected
from glossy import AROUND, EYES, RADIUS, dark, evidence_of, met, mirror_photo, painted, pillar, window_photo
from tabletop import camera_at, checks, photo


def grey(x, y):
    return np.full((*x.shape, 3), 0.6)


def in_shadow(x, y):
    """A shadow that falls to one side of the foot."""
    inside = (np.abs(y - 0.3 * x) < 0.12) & (x > 0.0) & (x < 0.8)
    return np.where(inside[..., None], 0.5, 1.0) * checks(x, y)


def stained(x, y):
    return np.where((np.hypot(x, y) < 0.4)[..., None], 0.25, grey(x, y))


@pytest.mark.parametrize(("pattern", "gloss"), [(grey, 0.1), (checks, 0.3), (in_shadow, 0.2), (stained, 0.5)])
def test_a_mirror_image_is_found_with_its_gloss(pattern, gloss):
    evidence = evidence_of([mirror_photo(eye, pattern, gloss) for eye in AROUND], pillar())
    assert evidence.suffices() and evidence.beyond is not None, evidence
    assert 0.4 * gloss < evidence.gloss < 1.2 * gloss


def test_a_few_photographs_from_the_front_are_enough():
    evidence = evidence_of([mirror_photo(eye, grey, 0.3) for eye in (*EYES, (1.6, -2.0, 2.0))], pillar())
    assert evidence.suffices(), evidence


@pytest.mark.parametrize("pattern", [grey, checks, in_shadow, stained])
def test_a_matte_support_shows_none(pattern):
    evidence = evidence_of([photo(camera_at(eye), pattern, hole=0.16) for eye in AROUND], pillar())
    assert not evidence.suffices(), evidence
    assert evidence.gloss < 0.03


def test_the_rim_of_an_object_that_masks_left_visible_is_no_mirror_image():
    seen = []
    for eye in AROUND:
        bare = photo(camera_at(eye), checks, hole=0.0)
        directions = unprojected(np.ones(bare.shape), bare.camera) - bare.camera.center
        hit, turn, height = met(bare.camera.center + 0.0 * directions, directions, RADIUS, 0.0, 0.08)
        pixels = bare.pixels.copy()
        pixels[hit] = np.round(255.0 * painted(turn, height)[hit] ** (1.0 / GAMMA))
        seen.append(replace(bare, pixels=pixels))
    evidence = evidence_of(seen, pillar())
    assert not evidence.suffices(), evidence


def test_a_mirror_that_shows_the_room_alone_shows_no_object():
    """As a polished table does where the object stands in a hollow, or is not there."""
    seen = [mirror_photo(eye, checks, 0.3, with_pillar=False) for eye in AROUND]
    evidence = evidence_of(seen, pillar())
    assert not evidence.suffices(), evidence


def pale(turn, height):
    return np.full((*turn.shape, 3), 0.8)


@pytest.mark.parametrize(
    ("share", "radius", "deep", "paint"),
    [
        (0.4, 0.05, 0.7, dark),
        (0.6, 0.12, 0.5, dark),
        (0.8, 0.12, 0.5, dark),
        (0.6, 0.12, 0.9, pale),
        (0.8, 0.12, 0.5, pale),
        (0.6, 0.3, 0.4, dark),
    ],
)
def test_a_leg_seen_through_a_pane_is_no_mirror_image(share, radius, deep, paint):
    """Its outline may even be that of the mirrored object; its colours are others."""
    seen = [window_photo(eye, grey, share, radius, deep, paint) for eye in AROUND]
    evidence = evidence_of(seen, pillar())
    assert not evidence.suffices(), evidence


def test_a_plain_object_is_left_in_the_mirror_as_it_could_be_a_leg_behind_a_pane():
    evidence = evidence_of([mirror_photo(eye, grey, 0.3, dark) for eye in AROUND], pillar(dark))
    assert evidence.explained > 0.5 and not evidence.suffices()


def test_where_nothing_can_be_compared_there_is_nothing_to_tell():
    seen = [mirror_photo(AROUND[0], grey, 0.3)]
    assert evidence_of(seen, pillar()) is None
    nowhere = [replace(each, known=np.zeros_like(each.known)) for each in seen * 5]
    assert evidence_of(nowhere, pillar()) is None


@pytest.mark.parametrize(
    "change",
    [
        {"gloss": 0.01},
        {"detail": 0.005},
        {"strength": 0.001},
        {"explained": 0.02},
        {"beyond": 1.0},
        {"alike": 0.3},
    ],
)
def test_each_kind_of_evidence_counts(change):
    good = {"gloss": 0.3, "detail": 0.3, "strength": 0.05, "explained": 0.6, "beyond": 1.5, "alike": 1.0}
    assert MirrorEvidence(**good).suffices()
    assert not MirrorEvidence(**(good | change)).suffices()
