"""Fixtures that several rooms share."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from diga3d_warp.process import tune_process

tune_process()  # as the program does; only before torch is imported has it an effect

import torch  # noqa: E402


@pytest.fixture(
    params=[
        "cpu",
        pytest.param(
            "cuda",
            marks=[
                pytest.mark.cuda,
                pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device"),
            ],
        ),
    ]
)
def device(request) -> str:
    """Every device of this machine, as torch names it."""
    return request.param


@pytest.fixture
def threads():
    """`set_thread_count`; the numbers of threads of Warp and torch are restored after the test."""
    from diga3d_warp.kernels.launch import set_thread_count, thread_count

    before, of_torch = thread_count(), torch.get_num_threads()
    yield set_thread_count
    set_thread_count(before)
    torch.set_num_threads(of_torch)


@pytest.fixture(scope="session")
def models(tmp_path_factory) -> Path:
    """Folders dpt, detector and cutter: tiny checkpoints in the real format."""
    from tiny_perception import write_cutter, write_depth_model, write_detector

    root = tmp_path_factory.mktemp("models")
    write_depth_model(root / "dpt")
    write_detector(root / "detector")
    write_cutter(root / "cutter")
    return root


@dataclass(frozen=True)
class ToyRun:
    """A finished `remove` run of a few gaussians, made without fitting.

    Attributes:
        folder: The run folder.
        scene: Its scene: photographs are renderings of source.ply with an error of 4 levels of 255.
    """

    folder: Path
    scene: object


@pytest.fixture
def toy_run(tmp_path):
    """A ring of eight cameras around a red cluster (removed) in a wide grey-green one; two are held out."""
    from diga3d_warp.evaluation.record import CAMERAS, RESULT, SOURCE
    from diga3d_warp.files import to_bytes
    from diga3d_warp.gaussians.parameters import Gaussians
    from diga3d_warp.pipelines.run import Run
    from diga3d_warp.scene.camera import Camera, look_at
    from diga3d_warp.scene.layouts.cameras_file import CameraSet, save_cameras
    from diga3d_warp.scene.scene import Points, Scene, View
    from diga3d_warp.splatting.render import render

    generator = torch.Generator().manual_seed(5)
    count, removed = 300, 40
    means = torch.randn(count, 3, generator=generator)
    means[:removed] *= 0.15
    colors = torch.rand(count, 3, generator=generator) * torch.tensor([0.3, 0.9, 0.5])
    colors[:removed] = torch.tensor([0.9, 0.1, 0.1])
    gaussians = Gaussians(
        means=means,
        log_scales=torch.full((count, 3), -2.0),
        quaternions=torch.randn(count, 4, generator=generator),
        opacity_logits=torch.ones(count),
        sh=((colors - 0.5) / 0.28209479177387814)[:, None],
    )
    edited = gaussians.select(torch.arange(removed, count))
    angles = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    views = []
    for index, angle in enumerate(angles):
        eye = np.array([4 * np.cos(angle), 4 * np.sin(angle), 1.0])
        camera = Camera(48, 36, 40.0, 40.0, 24.0, 18.0, torch.from_numpy(look_at(eye, np.zeros(3))))
        before, after = (render(splat, camera).color.detach() for splat in (gaussians, edited))
        pixels = to_bytes(before)
        pixels = np.where(pixels > 128, pixels - 4, pixels + 4)
        views.append(View(f"view_{index}", camera, pixels, (before != after).any(-1).numpy()))
    scene = Scene(
        path=tmp_path / "scene",
        kind="colmap",
        views=views[1:4] + views[5:],
        test_views=[views[0], views[4]],
        points=Points(means.double().numpy(), to_bytes(colors)),
    )
    settings = {"scene": scene.path, "masks": None, "image_scale": 1.0, "hold_out": 4, "seed": 0}
    run = Run(tmp_path / "run", "remove", settings)
    edited.save_ply(run.folder / RESULT)
    gaussians.save_ply(run.folder / SOURCE)
    save_cameras(run.folder / CAMERAS, CameraSet.of(scene))
    return ToyRun(run.folder, scene)


@pytest.fixture
def toy_truth(toy_run):
    """The scene of `toy_run` with test views that show the scene without the object, as SPIn-NeRF's do."""
    from diga3d_warp.evaluation.record import RESULT
    from diga3d_warp.files import to_bytes
    from diga3d_warp.gaussians.parameters import Gaussians
    from diga3d_warp.splatting.render import render

    edited = Gaussians.load_ply(toy_run.folder / RESULT)
    views = []
    for view in toy_run.scene.test_views:
        pixels = to_bytes(render(edited, view.camera).color)
        pixels[view.mask] ^= 16
        views.append(replace(view, pixels=pixels))
    return replace(toy_run.scene, test_views=views, ground_truth=True)
