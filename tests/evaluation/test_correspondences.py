"""Correspondences of frames whose motion is known."""

import math

import cv2
import numpy as np
import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.correspondences import (
    LOFTR,
    LoftrMatcher,
    Matches,
    SiftMatcher,
    count_matches,
)


def textured(height, width, seed=3):
    """Blobs of several sizes."""
    noise = np.random.default_rng(seed).random((height, width, 3), np.float32)
    layers = [cv2.GaussianBlur(noise, (0, 0), sigma) * sigma for sigma in (1.5, 3.0)]
    image = sum(layers)
    return torch.from_numpy((image - image.min()) / (image.max() - image.min()))


@pytest.fixture(scope="module")
def loftr(weights_of) -> LoftrMatcher:
    return LoftrMatcher(weights_of("loftr"))


def test_sift_finds_a_shift():
    wide = textured(90, 130)
    matches = SiftMatcher().match(wide[:, :120], wide[:, 7:127])
    assert len(matches.first) > 30
    shift = np.median(matches.first - matches.second, axis=0)
    np.testing.assert_allclose(shift, [7, 0], atol=0.1)


def test_sift_counts_what_is_shared():
    first, other = textured(90, 120), textured(90, 120, seed=4)
    half = first.clone()
    half[:, 60:] = other[:, 60:]
    same, shared, none = (count_matches(SiftMatcher(), [(0, 1)], [first, x]) for x in (first, half, other))
    assert same.whole > shared.whole > 5 > none.whole
    mask = np.zeros((90, 120), bool)
    mask[:, 66:] = True
    found = count_matches(SiftMatcher(), [(0, 1)], [first, half], [mask, mask])
    assert found.masked < 0.1 * found.whole and found.pairs == 1


@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_flat_and_small_frames_have_no_matches(value, loftr):
    for height, width in ((40, 50), (5, 3)):
        flat = torch.full((height, width, 3), value)
        assert count_matches(SiftMatcher(), [(0, 1)], [flat, flat]).whole == 0
    small = torch.rand(12, 9, 3, generator=torch.Generator().manual_seed(1))
    assert count_matches(loftr, [(0, 1)], [small, small]).whole == 0


def test_one_feature_is_not_compared_with_a_second():
    dot = torch.zeros(40, 40, 3)
    dot[18:23, 18:23] = 1.0
    SiftMatcher().match(dot, textured(40, 40))
    SiftMatcher().match(textured(40, 40), dot)


def test_loftr_matches_a_frame_with_itself(loftr):
    frame = textured(72, 96)
    matches = loftr.match(frame, frame)
    assert 1 <= len(matches.first) <= 5 * 8, "cells of 8 px, two at each border left out"
    assert (matches.first % 8 == 7.5).all(), "corners of cells, less the half pixel of kornia's frame"
    grey = frame.mean(-1, keepdim=True).expand(-1, -1, 3)
    assert len(loftr.match(grey, grey).first) >= 1


def test_loftr_counts_confident_matches_only(loftr, monkeypatch):
    first, second = textured(72, 96), textured(72, 96, seed=5)
    data = {name: torch.rand(6, 2) for name in ("keypoints0", "keypoints1")}
    data["confidence"] = torch.tensor([0.79, 0.8, 0.81, 1.0, 0.2, 0.0])
    monkeypatch.setattr(loftr.network, "forward", lambda _: data)
    assert len(loftr.match(first, second).first) == 3


def test_a_match_is_masked_if_one_end_is():
    mask = np.zeros((4, 5), bool)
    mask[1, 2] = True
    none = np.zeros_like(mask)
    matches = Matches(
        np.array([[2.0, 1.0], [1.6, 1.4], [4.4, 3.4]]), np.array([[0.0, 0.0], [9.0, 9.0], [2, 1]])
    )
    assert matches.touching(mask, none) == 2
    assert matches.touching(none, mask) == 1
    assert matches.touching(none, none) == 0
    assert Matches(np.zeros((0, 2)), np.zeros((0, 2))).touching(mask, mask) == 0


def test_mean_over_pairs():
    frames = [textured(60, 80), textured(60, 80), textured(60, 80, seed=9)]
    one = count_matches(SiftMatcher(), [(0, 1)], frames).whole
    other = count_matches(SiftMatcher(), [(0, 2)], frames).whole
    both = count_matches(SiftMatcher(), [(0, 1), (0, 2)], frames)
    assert both.whole == pytest.approx((one + other) / 2) and both.masked is None and both.pairs == 2


def test_weights_of_loftr(tmp_path, monkeypatch, weights_of):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "hub"))
    with pytest.raises(InputError, match=r"loftr_outdoor\.ckpt \(46 MB\) .*curl -L .*kornia/loftr"):
        LoftrMatcher()
    state = torch.load(weights_of("loftr") / LOFTR.name, weights_only=True)["state_dict"]
    state["backbone.conv1.weight"][0] = math.inf
    torch.save({"state_dict": state}, tmp_path / LOFTR.name)
    with pytest.raises(InputError, match="not finite"):
        LoftrMatcher(tmp_path)
