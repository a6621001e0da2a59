"""What benchmarks on the small room share: stages by name, scores against the room without the vase."""

from types import SimpleNamespace

import numpy as np

from diga3d_warp.bench import room
from diga3d_warp.config import Effects
from diga3d_warp.files import write_image
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.pipelines.demo import TRUTH
from diga3d_warp.pipelines.remove import RemoveSettings
from diga3d_warp.pipelines.run import Run
from diga3d_warp.splatting.render import render


def test_scores_are_those_of_held_out_views_against_the_truth(toy_run):
    scene, run = toy_run.scene, SimpleNamespace(effects=Effects())
    gaussians = Gaussians.load_ply(toy_run.folder / "point_cloud.ply")
    for view in scene.test_views:
        truth = render(gaussians, view.camera).color.detach().clamp(0, 1).numpy()
        truth[view.mask] = np.clip(truth[view.mask] + 0.1, 0.0, 1.0)
        write_image(scene.path / TRUTH / f"{view.name}.png", (255 * truth).round().astype(np.uint8))
    score = room.against_truth(scene, SimpleNamespace(gaussians=gaussians, run=run), RemoveSettings())
    assert 20.0 < score["masked"].psnr < score["whole"].psnr
    assert score["unmasked"].psnr > 45.0


def test_named_stages_are_shared_where_they_exist(tmp_path):
    first, second = (Run(tmp_path / name, "remove", {}) for name in ("first", "second"))
    for name in ("fit", "clear", "refit"):
        first.stage(name, lambda folder, name=name: (folder / "product").write_text(name))
    room.share_stages(first.folder, second.folder)
    assert sorted(stage.name for stage in (second.folder / "stages").iterdir()) == ["clear", "fit"]
    ran = []
    folder = second.stage("fit", lambda folder: ran.append(folder))
    assert not ran and (folder / "product").read_text() == "fit"
