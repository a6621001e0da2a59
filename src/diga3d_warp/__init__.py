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
    from diga3d_warp.gaussians.fit import FitSettings
    from diga3d_warp.gaussians.parameters import Gaussians
    from diga3d_warp.perception.boxes import Box
    from diga3d_warp.pipelines.fit import fit
    from diga3d_warp.pipelines.marking import Marks, Words
    from diga3d_warp.pipelines.method import Method
    from diga3d_warp.pipelines.remove import RemoveSettings, remove
    from diga3d_warp.pipelines.replace import ReplaceSettings, replace
    from diga3d_warp.pipelines.request import EditRequest, EditResult, FitRequest, RunResult
    from diga3d_warp.pipelines.retexture import RetextureSettings, retexture
    from diga3d_warp.pipelines.run import Run
    from diga3d_warp.priors.named import load_prior
    from diga3d_warp.scene.camera import Camera, Distortion
    from diga3d_warp.scene.load import load_scene
    from diga3d_warp.scene.scene import Points, Scene, View
    from diga3d_warp.splatting.render import render
    from diga3d_warp.splatting.reproject import reproject

__all__ = [
    "Accuracy",
    "Box",
    "Camera",
    "Distortion",
    "EditRequest",
    "EditResult",
    "Effects",
    "EffectsPlan",
    "FitRequest",
    "FitSettings",
    "Gaussians",
    "InputError",
    "Marks",
    "Method",
    "Points",
    "RemoveSettings",
    "ReplaceSettings",
    "RetextureSettings",
    "Run",
    "RunResult",
    "Scene",
    "View",
    "Words",
    "__version__",
    "fit",
    "load_prior",
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
    "Box": "perception.boxes",
    "Camera": "scene.camera",
    "Distortion": "scene.camera",
    "EditRequest": "pipelines.request",
    "EditResult": "pipelines.request",
    "Effects": "config",
    "EffectsPlan": "effects.plan",
    "FitRequest": "pipelines.request",
    "FitSettings": "gaussians.fit",
    "Gaussians": "gaussians.parameters",
    "InputError": "errors",
    "Marks": "pipelines.marking",
    "Method": "pipelines.method",
    "Points": "scene.scene",
    "RemoveSettings": "pipelines.remove",
    "ReplaceSettings": "pipelines.replace",
    "RetextureSettings": "pipelines.retexture",
    "Run": "pipelines.run",
    "RunResult": "pipelines.request",
    "Scene": "scene.scene",
    "View": "scene.scene",
    "Words": "pipelines.marking",
    "fit": "pipelines.fit",
    "load_prior": "priors.named",
    "load_scene": "scene.load",
    "plan_effects": "effects.plan",
    "remove": "pipelines.remove",
    "render": "splatting.render",
    "replace": "pipelines.replace",
    "reproject": "splatting.reproject",
    "retexture": "pipelines.retexture",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":  # reading package metadata takes a while
        from importlib.metadata import version

        return version("diga3d-warp")
    if name not in _HOMES:
        raise AttributeError(f"module 'diga3d_warp' has no attribute {name!r}")
    value = getattr(import_module(f"diga3d_warp.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
