"""Random scenes, cameras and depths full of poison: no error, no NaN, all in bounds, same bytes twice.

`DIGA3D_FUZZ=10000 pytest tests/hard_cases/test_fuzz.py` tries that many examples a test, new ones each time.
"""

from __future__ import annotations

import os

import numpy as np
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from diga3d_warp.config import SPLATTING, Accuracy, Effects
from diga3d_warp.gaussians.exposure import IDENTITY, Exposures, best_transform, exposed
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.scene.camera import Camera, Distortion
from diga3d_warp.splatting.reproject import reproject
from poison import FIELDS, POISON, check, images, rendered
from scenes import LENSES, camera_at, random_gaussians

EXAMPLES = int(os.environ.get("DIGA3D_FUZZ", "0"))


def fuzzed(examples: int):
    return settings(
        max_examples=EXAMPLES or examples,
        derandomize=not EXAMPLES,
        database=None,
        deadline=None,
        print_blob=True,
        suppress_health_check=list(HealthCheck),
    )


VARIANTS = {
    "as 3DGS": (Effects(), Accuracy.STANDARD),
    "bare": (Effects(sh_degree=0, depth=False, background=False, lens=False), Accuracy.DRAFT),
    "everything": (Effects(antialias=True, normals=True, median_depth=True), Accuracy.STANDARD),
    "exact": (Effects(sh_degree=1), Accuracy.EXACT),
    "circle": (Effects(), Accuracy(extent="circle")),
}
"""Few, because each one is kernels to compile."""

SAMPLINGS = {
    "mesh": Accuracy.STANDARD,
    "points": Accuracy.DRAFT,
    "mesh, four samples": Accuracy(supersampling=2),
    "points, nine samples": Accuracy(sampling="nearest", supersampling=3),
}

FOLDED = Distortion("brown", (-0.6, 0.0, 0.01, -0.02))
"""One to one up to 0.7 focal lengths only."""

SIZES = ((21, 17), (1, 1), (33, 3), (16, 16))


@st.composite
def cameras(draw) -> Camera:
    """Cameras in the cloud, before it and far away, from fisheye to telescope, some looking past it."""
    width, height = draw(st.sampled_from(SIZES))
    focal = draw(st.sampled_from((18.0, 1.0, 200.0, 1e4, 1e-6, 3e5)))
    off_axis = draw(st.sampled_from((0.0, 0.7, -40.0, 3e5)))
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=draw(st.integers(0, 99))).as_matrix()
    pose[2, 3] = draw(st.sampled_from((3.0, 0.5, 0.0, 30.0, 1e6, -1.0, 9e14)))
    return Camera(
        width, height, focal, 1.1 * focal, 0.5 * width + off_axis, 0.5 * height, torch.tensor(pose),
        draw(st.sampled_from((*LENSES.values(), FOLDED))),
    )  # fmt: skip


@st.composite
def scenes(draw) -> Gaussians:
    """Up to eight gaussians; single numbers of them, whole gaussians or whole fields are overwritten."""
    values = st.sampled_from(POISON) | st.floats(width=32)
    count = draw(st.integers(0, 8))
    gaussians = random_gaussians(count, seed=draw(st.integers(0, 9)))
    if count == 0:
        return gaussians
    rows = st.integers(0, count - 1)
    for _ in range(draw(st.integers(0, 6))):
        field = draw(st.sampled_from(sorted(FIELDS)))
        component = draw(st.integers(0, FIELDS[field] - 1))
        getattr(gaussians, field)[draw(rows)].view(-1)[component] = draw(values)
    if draw(st.booleans()):
        row = draw(rows)
        for field in FIELDS:
            numbers = getattr(gaussians, field)[row].view(-1)
            chosen = draw(st.lists(values, min_size=min(4, len(numbers)), max_size=min(4, len(numbers))))
            numbers[: len(chosen)] = torch.tensor(chosen)
    if draw(st.booleans()):
        getattr(gaussians, draw(st.sampled_from(sorted(FIELDS))))[:] = draw(values)
    return gaussians


@fuzzed(250)
@given(scenes(), cameras(), st.sampled_from(sorted(VARIANTS)))
def test_renderings(gaussians, camera, variant):
    effects, accuracy = VARIANTS[variant]
    out, leaves = rendered(gaussians, camera, effects, accuracy)
    check(out, leaves, accuracy, effects)
    again, others = rendered(gaussians, camera, effects, accuracy)
    for (name, image), (_, other) in zip(images(out), images(again), strict=True):
        assert torch.equal(image, other), name
    for name, leaf in leaves.items():
        assert (leaf.grad is None) == (others[name].grad is None)
        assert leaf.grad is None or torch.equal(leaf.grad, others[name].grad), name


@fuzzed(100)
@given(st.data())
def test_exposures(data):
    """Renderings that are black, flat or as bright as a renderer can be, and photographs of any kind."""
    random = torch.Generator().manual_seed(data.draw(st.integers(0, 99)))
    levels = st.sampled_from((0.0, 1e-45, 1e-20, 0.5, 1.0, SPLATTING.color_max))
    color = data.draw(levels) + data.draw(levels) * torch.rand(5, 7, 3, generator=random)
    photograph = torch.rand(5, 7, 3, generator=random) * data.draw(st.sampled_from((0.0, 1.0)))
    weight = data.draw(st.sampled_from((None, torch.zeros(5, 7), torch.rand(5, 7, generator=random))))
    exposures = Exposures([camera_at()] * data.draw(st.sampled_from((1, 3, 40))))
    before = (color - photograph).square().mean()
    for _ in range(3):
        exposures.update(0, color, photograph, weight)
    assert exposures.transforms.isfinite().all()
    assert exposed(color, exposures.transforms[0]).isfinite().all()
    torch.testing.assert_close(exposures.transforms.mean(0), IDENTITY, atol=1e-4, rtol=0)
    alone = best_transform(color, photograph, None, IDENTITY)
    if color.max() <= 1.0:  # beyond, float32 has no digits left for the difference
        assert (exposed(color, alone) - photograph).square().mean() <= 1.5 * before + 1e-6


def test_most_scenes_of_the_fuzz_are_not_blank():
    """Checks on blank images prove nothing: without poison nearly every camera before the cloud sees it."""
    pose = np.eye(4)
    pose[2, 3] = 3.0
    for effects, accuracy in VARIANTS.values():
        for width, height in SIZES:
            camera = Camera(width, height, 18.0, 20.0, 0.5 * width, 0.5 * height, torch.tensor(pose))
            out, leaves = rendered(random_gaussians(8), camera, effects, accuracy)
            check(out, leaves, accuracy, effects)
            assert out.alpha.max() > 0.3
            assert leaves["sh"].grad.any() and leaves["quaternions"].grad.any()


DEPTHS = (0.0, -1.0, float("nan"), float("inf"), -float("inf"), 1e-45, 1e-38, 1e-15, 1e15, 1e38, 0.01, 16.0)


@st.composite
def depth_maps(draw, height: int, width: int) -> torch.Tensor:
    """Random depths of a wall or of noise, parts of which are overwritten."""
    random = np.random.default_rng(draw(st.integers(0, 2**31)))
    low, high = draw(st.sampled_from(((0.5, 4.0), (2.0, 2.02))))
    depth = random.uniform(low, high, (height, width))
    spots = random.random(depth.shape) < draw(st.sampled_from((0.0, 0.02, 0.2, 1.0)))
    values = draw(st.lists(st.sampled_from(DEPTHS) | st.floats(width=32), min_size=1, max_size=4))
    depth[spots] = random.choice(values, spots.sum())
    return torch.tensor(depth, dtype=torch.float32)


@fuzzed(120)
@given(st.data())
def test_reprojections(data):
    source, target = data.draw(cameras()), data.draw(cameras())
    depth = data.draw(depth_maps(source.height, source.width))
    random = torch.Generator().manual_seed(data.draw(st.integers(0, 99)))
    image = torch.rand(source.height, source.width, 3, generator=random)
    poisoned = data.draw(st.sampled_from((None, *POISON)))
    usable = (depth >= 1e-15) & (depth <= 1e15)
    if poisoned is not None:
        image[~usable] = poisoned  # where there is no depth, nobody reads the colour
    accuracy = SAMPLINGS[data.draw(st.sampled_from(sorted(SAMPLINGS)))]
    results = []
    for _ in range(2):
        i, d = image.clone().requires_grad_(), depth.clone().requires_grad_()
        out = reproject(i, d, source, target, accuracy=accuracy)
        weights = torch.randn(out.image.shape, generator=torch.Generator().manual_seed(1))
        ((out.image * weights).sum() + (out.depth * weights[..., 0]).sum()).backward()
        results.append((*out, i.grad, d.grad))
    warped, z, visible, adj_image, adj_depth = results[0]
    for tensor in (warped, z, adj_image, adj_depth):
        assert tensor.isfinite().all()
    assert warped.min() >= 0.0 and warped.max() <= 1.0 + 1e-5
    assert torch.equal(visible, z > 0)
    assert not warped[~visible].any() and z.min() >= 0
    assert not adj_image[~usable].any() and not adj_depth[~usable].any()
    assert all(torch.equal(a, b) for a, b in zip(*results, strict=True))
