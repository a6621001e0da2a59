"""Selection of the K reference views, which are filled first (paper Sec. 3.3)."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.extent import central_cameras

RESTARTS = 10
"""K-means runs from different starts; the best is kept, since a single run may end in a poor split. 10 is
scikit-learn's customary number (`n_init`)."""


LEAST_SHOWN = 0.05
"""Least part of the largest edited area that a reference shows [1]: an object at four times the distance has
a sixteenth; less is a tip of it at the border of the image."""


@dataclass(frozen=True, eq=False)
class References:
    """Reference views, the one with the largest cluster first.

    Attributes:
        indices: Index of each reference among the views, shape (K,).
        cluster: For every view, the reference of its cluster, as an index into `indices`, shape (N,), int64.
    """

    indices: list[int]
    cluster: np.ndarray


def check_reference_count(count: int, views: int) -> None:
    """Refuse a number of references that is not between 1 and the number of views.

    Raises:
        InputError: there are fewer views than references, or no reference is asked for.
    """
    if not 1 <= count <= views:
        raise InputError(f"{count} references cannot be chosen from {views} views: ask for 1 to {views}")


def select_references(
    centers: np.ndarray,
    count: int = 3,
    seed: int = 0,
    method: Literal["kmeans", "random"] = "kmeans",
    usable: Sequence[bool] | None = None,
) -> References:
    """Choose reference views from the camera centres.

    "kmeans" clusters the centres and takes the view nearest to the middle of each cluster, as the paper does.
    "random" draws the views, as a baseline. Both then assign every view to its nearest reference. A camera
    far from all others is not chosen as long as there are enough others.

    Args:
        centers: Camera centres in world space [scene units], shape (N, 3).
        count: Number of references K.
        seed: Seed of the k-means starts or of the draw.
        method: "kmeans" or "random".
        usable: Which views may be references, N of them, from `usable_views`; all if None. If these are fewer
            than K, each of them is one.

    Raises:
        InputError: there are fewer views than references, no reference is asked for, no view is usable, or
            the method is unknown.
    """
    centers = np.asarray(centers, np.float64)
    check_reference_count(count, len(centers))
    among = np.arange(len(centers)) if usable is None else np.flatnonzero(np.asarray(usable, bool))
    if len(among) == 0:
        raise InputError("no view shows anything to edit: mask an object that the views show")
    count = min(count, len(among))
    central = among[central_cameras(centers)[among]]
    among = among if len(central) < count else central
    generator = np.random.default_rng(seed)
    if method == "kmeans":
        indices = among[_nearest_to_means(centers[among], count, generator)]
    elif method == "random":
        indices = among[generator.choice(len(among), count, replace=False)]
    else:
        raise InputError(f"reference method {method!r} is unknown: use 'kmeans' or 'random'")
    return given_references(centers, indices)


def given_references(centers: np.ndarray, indices: Sequence[int]) -> References:
    """References that were chosen already; every view follows the nearest.

    Args:
        centers: Camera centres in world space [scene units], shape (N, 3).
        indices: Which views are references, at least one.
    """
    centers, chosen = np.asarray(centers, np.float64), np.asarray(indices)
    cluster = _distances(centers, centers[chosen]).argmin(1)
    cluster[chosen] = np.arange(len(chosen))  # cameras at one place: each reference stands for itself
    order = np.argsort(-np.bincount(cluster, minlength=len(chosen)), kind="stable")
    return References([int(i) for i in chosen[order]], np.argsort(order)[cluster])


def usable_views(areas: Sequence[np.ndarray]) -> list[bool]:
    """Views that can be references: they show enough of the edited region, and some of its surroundings.

    A reference with a tiny edited region gives other views nothing to follow; one without surroundings gives
    the prior nothing to continue.

    Args:
        areas: Where each view is edited, shape (H, W), bool.

    Returns:
        One for each view; none is usable only if no view is edited.
    """
    shares = np.array([area.mean() for area in areas])
    usable = (shares >= LEAST_SHOWN * shares.max(initial=0.0)) & (shares > 0.0)
    open_views = usable & (shares < 1.0)
    return (open_views if open_views.any() else usable).tolist()


def _nearest_to_means(centers: np.ndarray, count: int, generator: np.random.Generator) -> np.ndarray:
    from scipy.cluster.vq import kmeans2

    scale = float(np.ptp(centers, axis=0).max()) or 1.0
    points = (centers - centers.mean(0)) / scale
    best, best_error = points[:count], np.inf
    for _ in range(RESTARTS):
        start = _spread_start(points, count, generator)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an empty cluster: cameras at one place, nothing to mend
            means, label = kmeans2(points, start, minit="matrix")
        error = float(((points - means[label]) ** 2).sum())
        if error < best_error:
            best, best_error = means, error
    return _distinct_nearest(_distances(points, best))


def _spread_start(points: np.ndarray, count: int, generator: np.random.Generator) -> np.ndarray:
    """Initial means far from each other (k-means++), distinct wherever the points are."""
    chosen = [int(generator.integers(len(points)))]
    for _ in range(count - 1):
        distance = _distances(points, points[chosen]).min(1)
        distance[chosen] = 0.0
        if distance.sum() > 0.0:
            chosen.append(int(generator.choice(len(points), p=distance / distance.sum())))
        else:
            chosen.append(next(i for i in range(len(points)) if i not in chosen))
    return points[chosen]


def _distinct_nearest(distance: np.ndarray) -> np.ndarray:
    """The nearest view of each mean, no view twice."""
    free = distance.copy()
    indices = []
    for k in range(distance.shape[1]):
        indices.append(int(free[:, k].argmin()))
        free[indices[-1]] = np.inf
    return np.array(indices)


def _distances(points: np.ndarray, means: np.ndarray) -> np.ndarray:
    """Squared distances, shape (points, means)."""
    return ((points[:, None] - means[None]) ** 2).sum(-1)
