"""Retexture through a diffusion prior, on a tiny checkpoint in the real format: random weights, real code."""

from __future__ import annotations

import numpy as np
import pytest
from ball import ball_sight, ring

from diga3d_warp.objects.diffusion_repaint import DiffusionRepainter
from diga3d_warp.priors.conditioning import Guidance
from diga3d_warp.priors.settings import SamplingSettings
from tiny_diffusion import write_checkpoint

SETTINGS = SamplingSettings(steps=2, batch=2)
CONTROLS = ("edges", "depth")


@pytest.fixture(scope="module")
def load(tmp_path_factory):
    from diga3d_warp.priors.stable_diffusion.load import load_stable_diffusion

    folder = write_checkpoint(tmp_path_factory.mktemp("checkpoint") / "sd")

    return lambda controls=CONTROLS: load_stable_diffusion(folder, controls=controls, device="cpu")


def repaint(prior, sights, references, prompt="a wooden vase", seed=0, **options):
    guidance = Guidance(prior.encode_prompts(prompt, "", "retexture"))
    return DiffusionRepainter(prior, guidance, SETTINGS, **options).repaint(sights, references, seed)


@pytest.fixture(scope="module")
def sights():
    return [ball_sight(camera) for camera in ring(3, size=48)]


@pytest.fixture(scope="module")
def painted(load, sights):
    return repaint(load(), sights, [0, 2])


def test_the_object_is_repainted_and_nothing_else(painted, sights):
    assert len(painted) == len(sights)
    for sight, image in zip(sights, painted, strict=True):
        assert 100 < sight.touched.sum() < 0.5 * sight.touched.size
        assert np.array_equal(image[~sight.touched], sight.image[~sight.touched])
        assert np.abs(image - sight.image)[sight.touched].mean() > 0.05
        assert image[sight.touched].std() > 0.02, "not blank"
        assert image.min() >= 0.0 and image.max() <= 1.0


def test_the_same_bytes_each_time(painted, load, sights):
    again = repaint(load(), sights, [0, 2], seed=1)
    assert all(np.array_equal(a, b) for a, b in zip(painted, again, strict=True))


@pytest.mark.parametrize(
    ("prompt", "controls"), [("a cube", CONTROLS), ("a wooden vase", ("depth",)), ("a wooden vase", ())]
)
def test_prompt_and_controls_matter(painted, load, sights, prompt, controls):
    other = repaint(load(controls), sights, [0, 2], prompt)
    for sight, mine, theirs in zip(sights, painted, other, strict=True):
        assert np.abs(mine - theirs)[sight.touched].mean() > 1e-3


def test_edges_and_depth_of_the_view_are_followed(load, sights):
    """Depth is brightest on the ball, the nearest there is; its outline is an edge."""
    prior, seen = load(), {}
    predict = prior.predict_noise

    def watch(z, t, text, cond=None, controls=(), image_embeds=None):
        seen.update({control.kind: (control.scale, control.image[0]) for control in controls})
        return predict(z, t, text, cond, controls, image_embeds)

    prior.predict_noise = watch
    repaint(prior, sights[:1], [0])
    scale, depth = seen["depth"]
    middle = tuple(side // 2 for side in depth.shape)
    assert scale == 1.0 and depth[middle] > 0.9 and depth[0, 0] < 1e-3
    scale, edges = seen["edges"]
    assert scale == 0.8 and set(edges.unique().tolist()) == {0.0, 1.0}
    assert edges.mean() < 0.3 and edges[0, 0] == 0.0


def test_the_plan_is_printed_before_sampling(load, sights):
    said = []
    repaint(load(), sights, [0], say=said.append)
    assert [line.partition(" noise")[0] for line in said] == [
        "1 views, 0 of them references, 2 steps: 4",
        "3 views, 1 of them references, 2 steps: 12",
    ]
    assert all("keys of the references" in line for line in said)
