"""Colours of a chart, of the photographs that see it finest."""

import numpy as np

from diga3d_warp.surfaces.settings import SURFACES
from diga3d_warp.surfaces.texture import blended


def test_the_photograph_that_sees_a_texel_finest_gives_its_detail():
    """Grass stands above its plane: photographs show it in other places, and their mean has none."""
    stripes = np.broadcast_to(np.where(np.arange(32) % 4 < 2, 0.2, 0.8)[:, None], (16, 32, 3))
    samples = [stripes.astype(np.float32), np.roll(stripes, 2, axis=1).astype(np.float32)]
    finer = np.ones((16, 32), np.float32)
    image, shown = blended(samples, [finer, 0.85 * finer], SURFACES)
    assert shown.all()
    assert np.abs(image - samples[0]).max() < 0.06


def test_another_photograph_takes_over_without_a_seam():
    one, other = np.full((4, 64, 3), 0.4, np.float32), np.full((4, 64, 3), 0.5, np.float32)
    other[:, ::2] = 0.45
    other[:, 1::2] = 0.35
    across = np.linspace(1.0, 0.5, 64, dtype=np.float32)[None].repeat(4, axis=0)
    image, _ = blended([one, other], [across, across[:, ::-1]], SURFACES)
    even = image[:, ::2, 0].mean(axis=0)
    assert np.abs(np.diff(even)).max() < 0.02 < even.max() - even.min()
