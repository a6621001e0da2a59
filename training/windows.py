"""Windows about an object, rendered at the size that the network is given."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.random import Generator
from tqdm import tqdm

from diga3d_warp.perception.depth import depth_control
from diga3d_warp.scene.camera import Camera
from training.recipe import VERSION, DataRecipe
from training.rooms import PLACES, Room, build_room
from training.store import Layout, Store

NEAR = 0.02
"""Least z of a corner to be projected [m]."""

SMALLEST_MASK = 0.01
"""Least share of a window that an object must cover to be taught from [1]: hidden ones teach a wrong word."""


def layout(recipe: DataRecipe) -> Layout:
    """Arrays of a record, one image: RGB, both objects' masks in bits, inverse depth."""
    side = recipe.side
    return {
        "image": ((side, side, 3), "uint8"),
        "mask": ((2, side, side // 8), "uint8"),
        "depth": ((side, side), "uint8"),
    }


Part = Literal["windows", "held_out", "tested"]
"""Rooms to train on, to look at meanwhile, and for published figures."""


def open_windows(work: Path, recipe: DataRecipe, part: Part = "windows") -> Store:
    """The store of windows of a part of the rooms."""
    return Store(work / part, layout(recipe), VERSION)


def render_rooms(work: Path, recipe: DataRecipe, rooms: int, part: Part = "windows") -> None:
    """Render rooms that the store lacks.

    Args:
        work: Folder of all work.
        recipe: What is rendered.
        rooms: Number of rooms to reach.
        part: Of the rooms.
    """
    store = open_windows(work, recipe, part)
    seeds = {
        "windows": recipe.first_seed, "held_out": recipe.held_out_seed, "tested": recipe.tested_seed,
    }  # fmt: skip
    first = seeds[part]
    done = store.rows[-1]["seed"] - first + 1 if store.rows else 0
    for number in tqdm(range(done, rooms), "rendering", initial=done, total=rooms, unit="room"):
        _append(store, first + number, recipe)


def _append(store: Store, seed: int, recipe: DataRecipe) -> None:
    room = build_room(PLACES[seed % len(PLACES)], seed, recipe)
    rng = np.random.default_rng([seed, 6])
    rows: list[dict[str, Any]] = []
    images: list[np.ndarray] = []
    masks: list[np.ndarray] = []
    depths: list[np.ndarray] = []
    for window in range(recipe.windows):
        view = room.views[(window * recipe.cameras) // recipe.windows]
        seen = room.take(window_camera(rng, view, room, recipe), recipe.supersampling)
        common = {"seed": seed, "window": window, "place": room.place, "stands": room.stands}
        both = np.packbits(seen.masks, -1)
        rows.append({**common, "thing": None})
        images.append(seen.alone)
        depths.append(_nearness(seen.depth))
        for thing, chosen in enumerate(room.things):
            if seen.masks[thing].mean() < SMALLEST_MASK:
                continue
            for said, image in zip(chosen, seen.images[thing], strict=True):
                words = [said.color, said.material, said.kind]
                rows.append({**common, "thing": thing, "words": words})
                images.append(image)
                depths.append(_nearness(seen.depths[thing]))
        masks += [both] * (len(images) - len(masks))
    store.append(rows, {"image": np.array(images), "mask": np.array(masks), "depth": np.array(depths)})


def _nearness(depth: np.ndarray) -> np.ndarray:
    """Inverse depth from 0 (farthest) to 255 (nearest), shape (H, W), uint8."""
    return np.round(255 * depth_control(torch.from_numpy(depth)).numpy()).astype(np.uint8)


def window_camera(rng: Generator, view: Camera, room: Room, recipe: DataRecipe) -> Camera:
    """A camera that sees a square part of a view about the objects."""
    corners = np.concatenate([bodies[0].vertices for bodies in room.bodies])
    local = corners @ view.pose[:3, :3].T + view.pose[:3, 3]
    local = local[local[:, 2] > NEAR]
    x, y = (local[:, :2] / local[:, 2:] * (view.fx, view.fy) + (view.cx, view.cy)).T
    low, high = np.array([x.min(), y.min()]), np.array([x.max(), y.max()])
    least, largest = recipe.around
    side = float((high - low).max()) * np.exp(rng.uniform(np.log(least), np.log(largest)))
    middle = 0.5 * (low + high) + side * recipe.aside * rng.uniform(-1, 1, 2)
    zoom = recipe.side / side
    left, top = middle - 0.5 * side
    return replace(
        view,
        width=recipe.side,
        height=recipe.side,
        fx=view.fx * zoom,
        fy=view.fy * zoom,
        cx=(view.cx - left) * zoom,
        cy=(view.cy - top) * zoom,
    )
