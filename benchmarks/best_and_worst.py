"""The best and the worst view of each of the demo's edits, by masked PSNR against the ground truth.

python benchmarks/best_and_worst.py run/demo     writes docs/images/best_and_worst.jpg, prints all figures
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

from diga3d_warp.evaluation.metrics import compare
from diga3d_warp.files import whole_file
from diga3d_warp.pipelines.demo import MATERIAL, OBJECT, REPLACED, RETEXTURED, RUN, SCENE, TRUTH
from diga3d_warp.scene.photographs.images import read_image

EDITS = {
    "removed": (RUN, TRUTH),
    MATERIAL: (RETEXTURED, TRUTH.parent / "other_material"),
    OBJECT: (REPLACED, TRUTH.parent / "other_object"),
}
"""Folders of each run and of its truth. The truth of the last two is another piece of the same material,
so that figures compare the views of one edit only."""

GAP = 6
"""White between two pictures [px]."""

CAPTION = 18
"""Height of the line under a picture [px]."""

OUT = Path(__file__).parents[1] / "docs" / "images" / "best_and_worst.jpg"

QUALITY = 88
"""Of the JPEG in [0, 100]."""


def scores(demo: Path, run: str, truth: Path) -> dict[str, float]:
    """PSNR within the run's masks, by view [dB]; views whose mask is empty are left out."""
    found = {}
    for file in sorted((demo / run / "views" / "after").glob("*.png")):
        mask = read_image(demo / run / "masks" / file.name)[..., 0] > 127
        if mask.any():
            after, wanted = (
                torch.from_numpy(read_image(path)).float() / 255.0
                for path in (file, demo / SCENE / truth / file.name)
            )
            found[file.stem] = compare(after, wanted, mask)["masked"].psnr
    return found


def captioned(path: Path, words: str) -> np.ndarray:
    """A picture with a line of words below it, and white to its right."""
    import cv2

    picture = read_image(path)
    framed = np.full((picture.shape[0] + CAPTION, picture.shape[1] + GAP, 3), 255, np.uint8)
    framed[: picture.shape[0], : picture.shape[1]] = picture
    place = (2, framed.shape[0] - 5)
    return cv2.putText(framed, words, place, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA)


def main() -> None:
    """Choose the views, join their pictures, and print every view's figure."""
    import cv2

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("demo", type=Path, help="folder that `make demo` filled")
    demo = parser.parse_args().demo
    rows = []
    for name, (run, truth) in EDITS.items():
        found = scores(demo, run, truth)
        print(name, ", ".join(f"{view} {psnr:.2f}" for view, psnr in found.items()))
        for kind, view in (
            ("best", max(found, key=found.__getitem__)),
            ("worst", min(found, key=found.__getitem__)),
        ):
            file = f"{view}.png"
            parts = {
                f"photograph, {view}": demo / SCENE / "images" / file,
                f"{name}, {kind}: {found[view]:.1f} dB": demo / run / "views" / "after" / file,
                "truth": demo / SCENE / truth / file,
            }
            rows.append(np.concatenate([captioned(path, words) for words, path in parts.items()], axis=1))
    with whole_file(OUT) as partial:
        joined = np.concatenate(rows, axis=0)[..., ::-1]
        assert cv2.imwrite(str(partial), joined, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    print(OUT)


if __name__ == "__main__":
    main()
