"""The picture of the built-in materials, one swatch of one repeat each, with its name.

python benchmarks/materials_picture.py
"""

from pathlib import Path

import numpy as np

from diga3d_warp.files import to_bytes, whole_file
from diga3d_warp.materials.vocabulary import MATERIALS

OUT = Path(__file__).parents[1] / "docs" / "images" / "materials.jpg"

SIDE = 144
"""Edge of a swatch [px]."""

TEXTURE = 288
"""Edge of the texture that a swatch shows [texels]."""

COLUMNS = 10

LABEL = 18
"""Height of a name [px]."""

QUALITY = 82
"""Of the JPEG in [0, 100]: detail is what the swatches show."""


def main() -> None:
    """Paint each material, write its name below, and join the swatches in rows."""
    import cv2

    swatches = []
    for name, material in MATERIALS.items():
        texture = cv2.resize(material.exemplar(TEXTURE, seed=0), (SIDE, SIDE), interpolation=cv2.INTER_AREA)
        swatch = np.full((SIDE + LABEL + 6, SIDE + 6, 3), 255, np.uint8)
        swatch[3 : 3 + SIDE, 3 : 3 + SIDE] = to_bytes(texture)
        place = (4, SIDE + LABEL - 3)
        cv2.putText(swatch, name, place, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (30, 30, 30), 1, cv2.LINE_AA)
        swatches.append(swatch)
    swatches += [np.full_like(swatches[0], 255)] * (-len(swatches) % COLUMNS)
    rows = [np.concatenate(swatches[i : i + COLUMNS], 1) for i in range(0, len(swatches), COLUMNS)]
    with whole_file(OUT) as partial:
        assert cv2.imwrite(str(partial), np.concatenate(rows)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    print(OUT)


if __name__ == "__main__":
    main()
