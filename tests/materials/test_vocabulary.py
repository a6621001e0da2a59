"""The vocabulary of materials: seeded, seamless, told apart, and named by a prompt."""

import numpy as np
import pytest

from diga3d_warp.materials.vocabulary import MATERIALS

SIDE = 128


@pytest.fixture(scope="module")
def exemplars() -> dict[str, np.ndarray]:
    return {name: material.exemplar(SIDE, seed=1) for name, material in MATERIALS.items()}


def test_there_are_enough_materials_and_no_word_means_two():
    assert len(MATERIALS) >= 24
    words = [word for material in MATERIALS.values() for word in (material.name, *material.also)]
    assert len(set(words)) == len(words)


@pytest.mark.parametrize("name", MATERIALS)
def test_an_exemplar_is_a_seeded_picture_with_detail(exemplars, name):
    image = exemplars[name]
    assert image.shape == (SIDE, SIDE, 3) and image.dtype == np.float32
    assert image.min() >= 0.0 and image.max() <= 1.0
    assert image.std(axis=(0, 1)).max() > 0.015, "not one flat colour"
    assert 0.04 < image.mean() < 0.96
    again, other = (MATERIALS[name].exemplar(SIDE, seed) for seed in (1, 2))
    assert np.array_equal(image, again)
    assert not np.array_equal(image, other)


@pytest.mark.parametrize("name", MATERIALS)
def test_an_exemplar_has_no_seam(exemplars, name):
    """Across the border neighbours differ little more than the roughest neighbours inside do."""
    image = exemplars[name].astype(np.float64)
    for axis in (0, 1):
        steps = np.abs(np.roll(image, -1, axis) - image).mean(axis=(1 - axis, 2))
        assert steps[-1] <= 1.3 * steps[:-1].max() + 1e-3


def test_materials_look_different(exemplars):
    """By mean colour and contrast at three sizes of detail, no two are the same."""
    import cv2

    def look(image: np.ndarray) -> np.ndarray:
        blurred = [image, *(cv2.GaussianBlur(image, (0, 0), sigma) for sigma in (1.5, 5.0))]
        return np.concatenate([image.mean((0, 1)), *(np.std(each, (0, 1)) for each in blurred)])

    looks = np.stack([look(image) for image in exemplars.values()])
    distance = np.linalg.norm(looks[:, None] - looks[None], axis=-1)
    np.fill_diagonal(distance, np.inf)
    assert distance.min() > 0.02
