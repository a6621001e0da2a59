"""DiGA3D on 3D Gaussian splats: edit an object in a captured scene, on any machine.

The public face. A name is imported from its module when it is first used, so that `import diga3d_warp` and
`diga3d --help` load neither torch nor Warp.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from diga3d_warp.config import Accuracy, Effects
    from diga3d_warp.effects.plan import EffectsPlan, plan_effects
    from diga3d_warp.errors import InputError
    from diga3d_warp.gaussians.fit import FitSettings, fit
    from diga3d_warp.gaussians.parameters import Gaussians
    from diga3d_warp.pipelines.remove import remove
    from diga3d_warp.pipelines.replace import replace
    from diga3d_warp.pipelines.retexture import retexture
    from diga3d_warp.scene.camera import Camera, Distortion
    from diga3d_warp.scene.load import load_scene
    from diga3d_warp.scene.scene import Points, Scene, View
    from diga3d_warp.splatting.render import render
    from diga3d_warp.splatting.reproject import reproject

__all__ = [
    "Accuracy",
    "Camera",
    "Distortion",
    "Effects",
    "EffectsPlan",
    "FitSettings",
    "Gaussians",
    "InputError",
    "Points",
    "Scene",
    "View",
    "fit",
    "load_scene",
    "plan_effects",
    "remove",
    "render",
    "replace",
    "reproject",
    "retexture",
]

_HOMES = {
    "Accuracy": "config",
    "Camera": "scene.camera",
    "Distortion": "scene.camera",
    "Effects": "config",
    "EffectsPlan": "effects.plan",
    "FitSettings": "gaussians.fit",
    "Gaussians": "gaussians.parameters",
    "InputError": "errors",
    "Points": "scene.scene",
    "Scene": "scene.scene",
    "View": "scene.scene",
    "fit": "gaussians.fit",
    "load_scene": "scene.load",
    "plan_effects": "effects.plan",
    "remove": "pipelines.remove",
    "render": "splatting.render",
    "replace": "pipelines.replace",
    "reproject": "splatting.reproject",
    "retexture": "pipelines.retexture",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'diga3d_warp' has no attribute {name!r}")
    value = getattr(import_module(f"diga3d_warp.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
