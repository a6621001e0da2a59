"""A synthetic capture in the layout of SPIn-NeRF: some photographs show the scene without its object."""

from __future__ import annotations

from pathlib import Path

from diga3d_warp.errors import InputError
from diga3d_warp.scene.synthetic.generate import SyntheticScene, appearing, generate

IMAGES = "images_4"
"""The one image folder: that on which the figures of SPIn-NeRF are measured."""

TEST_SHARE = 5, 2
"""Of so many views, so many are test views: 40 of 100 in SPIn-NeRF."""


def generate_spin_nerf(settings: SyntheticScene, folder: Path | str, progress: bool = False) -> Path:
    """Write a synthetic capture in the layout of SPIn-NeRF.

    images_4/*.png, of which the test views show the scene without its object; images_4/label and test_label
    with the masks of training and test views; sparse/0 with the cameras and points.

    Args:
        settings: What to make.
        folder: Where to; it appears once everything is written.
        progress: Show a progress bar.

    Returns:
        `folder`.

    Raises:
        InputError: as `generate`; or there are too few views for both kinds.
    """
    if settings.views < TEST_SHARE[0]:
        raise InputError(f"{settings.views} views leave no test views: use {TEST_SHARE[0]} or more")
    with appearing(Path(folder)) as arranged:
        _arrange(generate(settings, arranged.with_name("ordinary"), progress), arranged)
    return Path(folder)


def _arrange(capture: Path, target: Path) -> None:
    """Move the files of an ordinary capture to where SPIn-NeRF has them."""
    images = target / IMAGES
    for place in ("label", "test_label"):
        (images / place).mkdir(parents=True)
    of, test = TEST_SHARE
    for index, image in enumerate(sorted((capture / "images").glob("*.png"))):
        held_out = index % of in range(1, 2 * test, 2)  # 1 and 3 of 5, so that training views surround them
        source = capture / "ground_truth" / "without_object" / image.name if held_out else image
        source.rename(images / image.name)
        (capture / "masks" / image.name).rename(images / ("test_label" if held_out else "label") / image.name)
    (capture / "sparse").rename(target / "sparse")
    for name in ("scene.json", "captions.json"):
        if (capture / name).exists():
            (capture / name).rename(target / name)
