"""Samples of a denoiser, encoded once: what an image is, what of it is known, and what guides."""

from __future__ import annotations

import time
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from numpy.random import Generator
from tqdm import tqdm

from diga3d_warp.perception.edges import canny_edges
from training.autoencoder import FROZEN, Encoder
from training.recipe import VERSION, Recipe
from training.samples import as_seen, free_form, grown
from training.store import Layout, Store
from training.windows import open_windows

CELL = 8
"""Side of a latent cell [px]."""


def layout(recipe: Recipe) -> Layout:
    """Arrays of a record: scaled latents of image and known part, mask and edges in bits, inverse depth."""
    side = recipe.data.side
    cells, channels = side // CELL, recipe.autoencoder.latent_channels
    return {
        "latent": ((channels, cells, cells), "float16"),
        "known": ((channels, cells, cells), "float16"),
        "mask": ((cells, cells // 8), "uint8"),
        "edges": ((side, side // 8), "uint8"),
        "depth": ((side // 2, side // 2), "uint8"),
    }


def open_latents(work: Path, recipe: Recipe) -> Store:
    """The store of encoded samples.

    Raises:
        InputError: they were encoded by another autoencoder.
    """
    encoded_by = zlib.crc32((work / FROZEN).read_bytes())
    return Store(work / "latents", layout(recipe), f"{VERSION}, autoencoder {encoded_by:08x}")


def encode_samples(work: Path, recipe: Recipe, count: int) -> None:
    """Encode until there are `count` samples, from the windows that there are.

    Raises:
        InputError: the autoencoder is not trained yet.
    """
    encoder = Encoder.frozen(work, recipe)
    windows, store = open_windows(work, recipe.data), open_latents(work, recipe)
    bar = tqdm(initial=len(store.rows), total=count, desc="latents", unit="sample")
    while len(store.rows) < count:
        if windows.refresh() == 0:
            time.sleep(5.0)
            continue
        rng = np.random.default_rng([recipe.seed, 7, len(store.rows)])
        samples = [Sample.of(rng, windows, recipe) for _ in range(recipe.latents.chunk)]
        store.append([sample.row for sample in samples], encode(samples, encoder))
        bar.update(len(samples))
    bar.close()


class Sample:
    """An image, what of it is masked, and its controls.

    Attributes:
        row: Of the image in the store of windows.
        image: RGB in [0, 1], shape (H, W, 3).
        mask: True where it is to be inpainted, shape (H, W), bool.
        edges, depth: Controls in [0, 1], shape (H, W).
    """

    def __init__(
        self,
        row: Mapping[str, Any],
        image: torch.Tensor,
        mask: torch.Tensor,
        edges: torch.Tensor,
        depth: torch.Tensor,
    ) -> None:
        self.row, self.image, self.mask, self.edges, self.depth = row, image, mask, edges, depth

    @staticmethod
    def of(rng: Generator, windows: Store, recipe: Recipe) -> Sample:
        """A sample of a random window."""
        index = int(rng.integers(len(windows.rows)))
        beside = _same_window(windows, index)
        alone = [i for i in beside if windows.rows[i]["thing"] is None]
        things = [i for i in beside if windows.rows[i]["thing"] is not None]
        if not things or rng.random() < recipe.latents.places:
            return _of_place(rng, windows, alone[0], things, recipe)
        return _of_object(rng, windows, int(rng.choice(things)), things, recipe)


def encode(samples: list[Sample], encoder: Encoder) -> dict[str, np.ndarray]:
    """Arrays of samples for the store."""
    images = torch.stack([sample.image for sample in samples])
    masks = torch.stack([sample.mask for sample in samples])
    latents, known = encoder(images), encoder(torch.where(masks[..., None], 0.5, images))
    cells = F.max_pool2d(masks[:, None].float(), CELL)[:, 0] > 0
    depth = F.avg_pool2d(torch.stack([sample.depth for sample in samples])[:, None], 2)[:, 0]
    edges = torch.stack([sample.edges for sample in samples]) > 0.5
    return {
        "latent": latents.numpy(),
        "known": known.numpy(),
        "mask": np.packbits(cells.numpy(), -1),
        "edges": np.packbits(edges.numpy(), -1),
        "depth": (255 * depth).round().to(torch.uint8).numpy(),
    }


def _same_window(windows: Store, index: int) -> list[int]:
    """Indices of the images of one window, which were written together."""

    def key(i: int) -> tuple[int, int]:
        return windows.rows[i]["seed"], windows.rows[i]["window"]

    first = last = index
    while first > 0 and key(first - 1) == key(index):
        first -= 1
    while last + 1 < len(windows.rows) and key(last + 1) == key(index):
        last += 1
    return list(range(first, last + 1))


def _of_place(rng: Generator, windows: Store, index: int, things: list[int], recipe: Recipe) -> Sample:
    """A room without object, masked where one might have stood."""
    masks, side = windows.array("mask")[index], recipe.data.side
    whole = windows.array("image")[index]
    form = int(rng.choice(4, p=recipe.masks.of_place))
    if form == 0 and not things:
        form = 2
    shown = whole
    if form < 2:
        thing = int(rng.choice(things)) if things else index
        first = windows.rows[thing]["thing"] or 0
        bits = masks[first] if form == 0 else masks[0] | masks[1]
        mask = _grown_silhouette(rng, bits, recipe)
        if form == 0 and rng.random() < recipe.masks.shadows:
            shown = np.where(mask.numpy()[..., None], whole, windows.array("image")[thing])
    else:
        mask = free_form(rng, side) if form == 2 else torch.ones(side, side, dtype=torch.bool)
    return _sample(rng, windows, index, shown, mask, None, recipe)


def _of_object(rng: Generator, windows: Store, index: int, things: list[int], recipe: Recipe) -> Sample:
    """A room with an object, masked at least where it stands unless the mask is free."""
    masks, row, side = windows.array("mask")[index], windows.rows[index], recipe.data.side
    form = int(rng.choice(5, p=recipe.masks.of_object))
    own = masks[row["thing"]]
    if form == 0:
        mask = _grown_silhouette(rng, own, recipe)
    elif form == 1:
        mask = _box(_grown_silhouette(rng, own, recipe))
    elif form == 2:
        mask = _grown_silhouette(rng, masks[0] | masks[1], recipe)
    else:
        mask = free_form(rng, side) if form == 3 else torch.ones(side, side, dtype=torch.bool)
    same = [i for i in things if windows.rows[i]["thing"] == row["thing"]]
    # Edges of the same shape in another material, too: an edit follows those of the photograph.
    outlined = int(rng.choice(same)) if rng.random() < recipe.latents.other_edges else index
    return _sample(rng, windows, index, windows.array("image")[index], mask, outlined, recipe)


def _sample(
    rng: Generator,
    windows: Store,
    index: int,
    shown: np.ndarray,
    mask: torch.Tensor,
    outlined: int | None,
    recipe: Recipe,
) -> Sample:
    image, mirrored = as_seen(rng, shown, recipe.samples)
    edged, depth = image, torch.from_numpy(windows.array("depth")[index].copy()).float() / 255
    if outlined is not None and outlined != index:
        edged = torch.from_numpy(windows.array("image")[outlined].copy()).float() / 255
        edged = edged.flip(1) if mirrored else edged
    if mirrored:
        mask, depth = mask.flip(1), depth.flip(1)
    return Sample(windows.rows[index], image, mask, canny_edges(edged), depth)


def _grown_silhouette(rng: Generator, bits: np.ndarray, recipe: Recipe) -> torch.Tensor:
    mask = torch.from_numpy(np.unpackbits(bits, axis=-1).astype(bool))
    return grown(mask, int(rng.integers(1, recipe.masks.grown + 1)))


def _box(mask: torch.Tensor) -> torch.Tensor:
    rows, columns = mask.any(1).nonzero()[:, 0], mask.any(0).nonzero()[:, 0]
    box = torch.zeros_like(mask)
    box[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] = True
    return box
