"""A recipe of a few thousand weights, and stores of made-up windows and samples for it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from training.recipe import (
    AutoencoderRecipe,
    ControlRecipe,
    DataRecipe,
    DenoiserRecipe,
    Recipe,
    RunRecipe,
    TextRecipe,
)
from training.store import Store
from training.windows import Part, open_windows

RUN = RunRecipe(batch=2, rate=1e-3, warm_up=2)
TINY = Recipe(
    data=DataRecipe(side=64, windows=1),
    autoencoder=AutoencoderRecipe(channels=8, crop=32, run=RUN),
    text=TextRecipe(tokens=40, width=16, layers=1),
    denoiser=DenoiserRecipe(channels=(16, 16), attention=(True, False), head=8, groups=4, run=RUN),
    control=ControlRecipe(embedding=(4, 4, 4, 4), run=RUN),
)
TINY = replace(TINY, latents=replace(TINY.latents, chunk=4))

WORDS = ("a", "an", "golden", "gold", "gilded", "marble", "white", "red", "ball", "vase", "made", "of", "on")


def made_up_windows(work: Path, part: Part = "windows", count: int = 2) -> Store:
    """Windows of coloured noise with a square as the object, in the layout of rendered ones."""
    store = open_windows(work, TINY.data, part)
    rng, side = np.random.default_rng(1), TINY.data.side
    masks = np.zeros((2, side, side), bool)
    masks[0, 20:44, 20:44] = masks[1, 16:40, 24:48] = True
    rows, images = [], []
    for window in range(count):
        place = np.full((side, side, 3), rng.integers(60, 200, 3), np.uint8)
        common = {"seed": 1, "window": window, "place": "a red rug", "stands": "on"}
        rows.append({**common, "thing": None})
        images.append(place)
        for thing, kind in enumerate(("ball", "vase")):
            for material in ("gold", "marble"):
                rows.append({**common, "thing": thing, "words": ["", material, kind]})
                color = (200, 160, 30) if material == "gold" else (230, 230, 225)
                images.append(np.where(masks[thing][..., None], np.uint8(color), place))
    depth = np.tile(np.linspace(0, 255, side, dtype=np.uint8)[:, None], (len(rows), 1, side))
    bits = np.tile(np.packbits(masks, -1), (len(rows), 1, 1, 1))
    store.append(rows, {"image": np.array(images), "mask": bits, "depth": depth})
    return store
