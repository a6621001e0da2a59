"""Likeness of photographs: what it is made of."""

import numpy as np
import pytest

from diga3d_warp.surfaces.agreement import _medians


@pytest.mark.filterwarnings("ignore:All-NaN slice")
@pytest.mark.parametrize("count", [1, 2, 3, 12])
def test_medians_are_of_what_is_known(count):
    rng = np.random.default_rng(count)
    values = rng.random((count, 20, 21)).astype(np.float32)
    values[rng.random(values.shape) < 0.4] = np.nan
    assert count > 3 or np.isnan(values).all(axis=0).any()
    np.testing.assert_array_equal(_medians(values), np.nanmedian(values, axis=0))
