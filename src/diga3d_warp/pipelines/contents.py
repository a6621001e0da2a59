"""Everything that the result of a run depends on besides its command line: capture contents and settings."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from diga3d_warp.pipelines.method import Method
from diga3d_warp.pipelines.own_fills import NO_FILLS, Fills
from diga3d_warp.priors.protocol import DiffusionPrior, Prior
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.scene import Scene


def everything(
    scene: Scene, settings: object, seed: int, effects: Mapping[str, bool | int] | None,
    prior: Prior | None = None, method: Method | None = None, own: Fills = NO_FILLS,
) -> dict[str, Any]:  # fmt: skip
    """Collect the arguments of a task for `Run.hold_to`.

    Args:
        scene: The capture as the user gave it.
        settings: Settings of the task, such as `FitSettings` or `RemoveSettings`.
        seed: Seed of all random choices.
        effects: Effects forced on or off by the user.
        prior: The prior, if the task has one.
        method: The method in use with the prior.
        own: Reference views that the user filled.
    """
    return {
        "capture": capture_contents(scene),
        "settings": settings,
        "seed": seed,
        "effects": dict(effects or {}),
        "prior": None if prior is None else prior_settings(prior),
        "method": method,
        "fills": {name: _digest([pixels]) for name, pixels in own.items()},
    }


def capture_contents(scene: Scene) -> dict[str, str]:
    """Digests of a capture's photographs, masks and cameras, and of its splat if it came with one.

    Poses that were found by mapping are left out: another version of COLMAP finds slightly others.
    """
    views = [*scene.views, *scene.test_views]
    found = {
        "photographs": _digest(part for view in views for part in (view.name, view.pixels, view.alpha)),
        "masks": _digest(view.mask for view in views),
    }
    if scene.kind != "images":
        found["cameras"] = _digest(part for view in views for part in _numbers(view.camera))
    if scene.splat is not None:
        found["splat"] = _digest([scene.splat.read_bytes()])
    return found


def prior_settings(prior: Prior) -> dict[str, Any]:
    """Sampling settings of a prior, its own settings and a digest of its weights if it has any."""
    settings: dict[str, Any] = {"name": prior.name, "own": getattr(prior, "settings", None)}
    settings["patches"] = getattr(prior, "patches", None)
    settings["weights"] = getattr(prior, "weights", None)
    if isinstance(prior, DiffusionPrior):
        settings |= {"sampling": prior.sampling, "guidance": prior.guidance.scale}
    return settings


def _numbers(camera: Camera) -> tuple[np.ndarray | str, ...]:
    """Parameters of a camera as float32: the last bits of float64 depend on the machine."""
    lens = camera.distortion
    inside = [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy]
    inside += lens.coefficients if lens else ()
    return camera.pose.astype(np.float32), np.array(inside, np.float32), lens.kind if lens else ""


def _digest(parts: Iterable[np.ndarray | str | bytes | None]) -> str:
    digest = hashlib.blake2b(digest_size=8)
    for part in parts:
        if isinstance(part, np.ndarray):
            digest.update(f"{part.dtype}{part.shape}".encode())
            digest.update(np.ascontiguousarray(part).tobytes())
        elif part is not None:
            digest.update(part if isinstance(part, bytes) else part.encode("utf-8", "surrogateescape"))
        digest.update(b"\0")
    return digest.hexdigest()
