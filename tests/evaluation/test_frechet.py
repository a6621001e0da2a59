"""FID's distance where it has a closed form, and its network on random weights."""

import numpy as np
import pytest
import scipy.linalg
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.frechet import INCEPTION, Inception, frechet_distance


def features(count, size, seed):
    return np.random.default_rng(seed).normal(size=(count, size)) @ np.diag(np.linspace(0.2, 2.0, size))


@pytest.mark.parametrize("count", [4, 60])
def test_distance_of_its_definition(count):
    """By the root of the product of the covariances, with fewer and with more pictures than features."""
    first, second = features(count, 12, 0), features(count + 3, 12, 1) + 0.5
    covariances = [np.cov(rows, rowvar=False) for rows in (first, second)]
    root = scipy.linalg.sqrtm(covariances[0] @ covariances[1]).real
    expected = np.square(first.mean(0) - second.mean(0)).sum() + np.trace(sum(covariances) - 2 * root)
    assert frechet_distance(first, second) == pytest.approx(expected, rel=1e-4)


def test_equal_sets_and_a_shift():
    first = features(9, 20, 2)
    assert frechet_distance(first, first[::-1]) == pytest.approx(0.0, abs=1e-9)
    assert frechet_distance(first, first + 0.5) == pytest.approx(20 * 0.25, rel=1e-9)
    assert frechet_distance(first, 3 * (first - first.mean(0)) + first.mean(0)) == pytest.approx(
        4 * np.trace(np.cov(first, rowvar=False)), rel=1e-9
    )


def test_features_of_inception(tmp_path, monkeypatch, weights_of):
    pytest.importorskip("torch_fidelity", reason="needs the extra [metrics]")
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "hub"))
    with pytest.raises(InputError, match=r"weights-inception.*\(96 MB\) .*curl -L .*torch-fidelity"):
        Inception()
    path = tmp_path / INCEPTION.name
    torch.save({"fc.bias": torch.zeros(3)}, path)
    with pytest.raises(InputError, match="another network's"):
        Inception(tmp_path)
    measure = Inception(weights_of("inception"))
    image = torch.rand(20, 31, 3, generator=torch.Generator().manual_seed(3))
    found = measure.features(image)
    assert found.shape == (2048,) and found.dtype == np.float64 and np.isfinite(found).all()
    assert found.std() > 0
    assert not np.array_equal(measure.features(image.flip(0)), found)
