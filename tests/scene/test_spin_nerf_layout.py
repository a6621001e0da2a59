"""Synthetic captures in the layout of SPIn-NeRF, and the image sizes of captures."""

from __future__ import annotations

import numpy as np
import pytest
from corner import Corner

from diga3d_warp.errors import InputError
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.published import image_size, published_scale
from diga3d_warp.scene.synthetic.generate import SyntheticScene, generate
from diga3d_warp.scene.synthetic.spin_nerf import generate_spin_nerf

SETTINGS = SyntheticScene(
    width=32, height=24, views=10, shadows=False, seed=2, supersampling=1, situation="rug"
)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """One capture in both layouts."""
    root = tmp_path_factory.mktemp("spin")
    return generate(SETTINGS, root / "plain"), generate_spin_nerf(SETTINGS, root / "spin")


def test_test_views_show_the_scene_without_its_object(folders):
    plain, spin = (load_scene(folder, hold_out=0) for folder in folders)
    assert spin.ground_truth and "the layout of SPIn-NeRF" in "\n".join(spin.notes)
    assert [view.name for view in spin.test_views] == ["view_001", "view_003", "view_006", "view_008"]
    assert len(spin.views) == 6 and all(view.mask is not None and view.mask.any() for view in spin.views)
    with_object = {view.name: view for view in plain.views}
    for view in spin.test_views:
        other = with_object[view.name]
        np.testing.assert_array_equal(view.mask, other.mask)
        changed = (view.pixels != other.pixels).any(-1)
        assert changed.any() and not (changed & ~other.mask).any()
        assert np.allclose(view.camera.pose, other.camera.pose)
    for view in spin.views:
        np.testing.assert_array_equal(view.pixels, with_object[view.name].pixels)


def test_a_failure_leaves_nothing(folders, tmp_path):
    with pytest.raises(InputError, match="leave no test views"):
        generate_spin_nerf(SyntheticScene(32, 24, views=4), tmp_path / "few")
    with pytest.raises(InputError, match="exists already"):
        generate_spin_nerf(SETTINGS, folders[1])
    assert not list(tmp_path.iterdir())


def test_sizes_of_a_capture(folders, tmp_path, corner: Corner):
    plain, spin = folders
    assert image_size(plain) == image_size(spin) == (32, 24)
    assert published_scale(plain) == published_scale(spin) == 1.0  # images_4 alone is what is measured
    (spin / "images_2").mkdir()
    for image in (spin / "images_4").glob("*.png"):
        (spin / "images_2" / image.name).write_bytes(image.read_bytes())
    assert published_scale(spin) == 0.5
    corner.write_images(tmp_path)
    assert published_scale(tmp_path) == 1.0
    with pytest.raises(InputError, match="no such file or folder"):
        published_scale(tmp_path / "none")
