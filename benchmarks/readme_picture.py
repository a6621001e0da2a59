"""The picture of the README: a photograph of the demo's room, the splat without the vase, and the truth.

python benchmarks/readme_picture.py run/demo
"""

import argparse
from pathlib import Path

import numpy as np

from diga3d_warp.files import whole_file
from diga3d_warp.pipelines.demo import RUN, SCENE, TRUTH
from diga3d_warp.scene.photographs.images import read_image

VIEW = "view_008"
"""A held-out view: no picture of it was fitted. The vase stands in the middle."""

GAP = 6
"""White between two pictures [px]."""

OUT = Path(__file__).parents[1] / "docs" / "images" / "demo.jpg"

QUALITY = 92
"""Of the JPEG in [0, 100]: a PNG of three textured views has more than 400 kB."""


def main() -> None:
    """Join the three pictures of one view side by side."""
    import cv2

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("demo", type=Path, help="folder that `make demo` filled")
    demo = parser.parse_args().demo
    sources = [demo / SCENE / "images", demo / RUN / "views" / "after", demo / SCENE / TRUTH]
    pictures = [read_image(source / f"{VIEW}.png") for source in sources]
    gap = np.full((pictures[0].shape[0], GAP, 3), 255, np.uint8)
    row = np.concatenate([pictures[0], gap, pictures[1], gap, pictures[2]], axis=1)
    with whole_file(OUT) as partial:
        assert cv2.imwrite(str(partial), row[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    print(OUT)


if __name__ == "__main__":
    main()
