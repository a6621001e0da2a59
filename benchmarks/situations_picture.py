"""Each synthetic situation with three seeds: a photograph, and the same view without the object.

python benchmarks/situations_picture.py     writes docs/images/situations.jpg
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from diga3d_warp.files import whole_file
from diga3d_warp.scene.synthetic.shots import set_stage, take
from diga3d_warp.scene.synthetic.situations.catalogue import SITUATIONS, build_situation

SEEDS = (0, 1, 2)
WIDTH, HEIGHT, VIEWS = 160, 120, 12

SHOWN = 3
"""Of the views, in order along the path."""

LINE = 16
"""Height of the name above a row [px]."""

OUT = Path(__file__).parents[1] / "docs" / "images" / "situations.jpg"

QUALITY = 82
"""Of the JPEG in [0, 100]."""


def pair(name: str, seed: int) -> np.ndarray:
    """A photograph beside the truth without the object, shape (H, 2 W, 3), uint8."""
    situation = build_situation(name, seed)
    rng = np.random.default_rng([seed, 2])
    camera = list(situation.orbit.cameras(WIDTH, HEIGHT, VIEWS, rng).values())[SHOWN]
    shot = take(set_stage(situation.scenery, seed, True), camera, 3, rng)
    return np.hstack([shot.image, shot.without_object])


def row(name: str) -> np.ndarray:
    """The pairs of all seeds side by side under the situation's name."""
    import cv2

    pairs = np.hstack([pair(name, seed) for seed in SEEDS])
    heading = np.full((LINE, pairs.shape[1], 3), 255, np.uint8)
    cv2.putText(heading, name, (2, LINE - 4), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA)
    return np.vstack([heading, pairs])


def main() -> None:
    import cv2

    sheet = np.vstack([row(name) for name in SITUATIONS])
    ok, jpeg = cv2.imencode(".jpg", sheet[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    assert ok
    with whole_file(OUT) as partial:
        partial.write_bytes(jpeg.tobytes())
    print(OUT)


if __name__ == "__main__":
    main()
