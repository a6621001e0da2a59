"""Renderings against the plain float64 renderer, with the gradient of everything that has one."""

import math
from dataclasses import replace

import pytest
import torch

import oracle
from diga3d_warp.config import Accuracy, Effects
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.render import Rendering, render
from scenes import LENSES, camera_at, random_gaussians, single

SIZES = [(64, 48), (37, 29)]
BACKGROUND = (0.2, 0.5, 0.9)


def rendered(
    lens: str, width: int, height: int, device: str = "cpu", count: int = 200, **ways
) -> tuple[Rendering, dict[str, torch.Tensor]]:
    """A rendering, and the leaves that its gradients reach."""
    gaussians = random_gaussians(count).to(device).requires_grad_()
    camera = camera_at(lens, width, height)
    pose = camera.world_to_camera.clone().requires_grad_()
    background = torch.tensor(BACKGROUND, device=device, requires_grad=True)
    out = render(gaussians, camera.with_pose(pose), background=background, **ways)
    return out, {**dict(gaussians.named()), "pose": pose, "background": background}


@pytest.mark.parametrize("width,height", SIZES)
@pytest.mark.parametrize("lens", LENSES)
def test_image_and_gradients_agree_with_float64(lens, width, height, device):
    found, leaves = rendered(lens, width, height, device)
    references = {name: leaf.detach().cpu().double().requires_grad_() for name, leaf in leaves.items()}
    *parameters, pose, background = references.values()
    color, alpha, depth, certain = oracle.render(
        parameters, pose, background, camera_at(lens, width, height), degree=3
    )
    assert certain.float().mean() > 0.9
    assert alpha.min() < 0.1 and alpha.max() > 0.999 and color.std() > 0.1
    for value, reference in zip(found[:3], (color, alpha, depth), strict=True):
        assert (value.cpu().double() - reference)[certain].abs().max() < 1e-4

    oracle.weighted_sum(found[:3], certain).backward()
    oracle.weighted_sum((color, alpha, depth), certain).backward()
    for name, leaf in leaves.items():
        reference = references[name].grad
        assert reference.abs().max() > 0.1
        error = (leaf.grad.cpu().double() - reference).norm() / reference.norm()
        assert error < 1e-4, f"{name}: {error}"


@pytest.mark.parametrize("precision,tolerance", [("float32", 1e-5), ("float64", 1e-7)])
def test_exact_agrees_with_float64(precision, tolerance):
    """Without cut-offs and through sigma points; in float64 but for what lies below alpha 1e-7."""
    accuracy = replace(Accuracy.EXACT, pixel_order=False, precision=precision)
    found, leaves = rendered("brown", 37, 29, accuracy=accuracy)
    references = {name: leaf.detach().double().requires_grad_() for name, leaf in leaves.items()}
    *parameters, pose, background = references.values()
    color, alpha, depth, certain = oracle.render(
        parameters, pose, background, camera_at("brown", 37, 29), degree=3, footprint="unscented",
        alpha_min=accuracy.alpha_min, transmittance_min=accuracy.transmittance_min,
    )  # fmt: skip
    assert certain.float().mean() > 0.9
    assert color.std() > 0.1
    for value, reference in zip(found[:2], (color, alpha), strict=True):
        assert (value.double() - reference)[certain].abs().max() < tolerance
    solid = certain & (alpha > 0.01)
    assert ((found.depth.double() - depth)[solid].abs() / depth[solid]).max() < 10 * tolerance
    oracle.weighted_sum(found[:2], solid).backward()
    oracle.weighted_sum((color, alpha), solid).backward()
    for name, leaf in leaves.items():
        reference = references[name].grad
        error = (leaf.grad.double() - reference).norm() / reference.norm()
        assert error < 10 * tolerance, f"{name}: {error}"


def test_normals_and_median_depth_of_a_wall():
    """A flat gaussian that stands oblique before the camera; behind it another, which nobody sees."""
    camera = Camera(40, 30, 35.0, 35.0, 20.0, 15.0, torch.eye(4))
    quaternion = [math.cos(0.3), 0.0, math.sin(0.3), 0.0]  # by 0.6 about y
    walls = [
        single(means=[0.0, 0.0, z], log_scales=[0.5, 0.5, -6.0], quaternions=quaternion, opacity_logits=8.0)
        for z in (2.0, 3.0)
    ]
    leaves = walls[0].joined(walls[1]).requires_grad_()
    out = render(leaves, camera, effects=Effects(normals=True, median_depth=True))
    middle = (slice(10, 20), slice(15, 25))
    assert out.alpha[middle].min() > 0.98
    expected = torch.tensor([-math.sin(0.6), 0.0, -math.cos(0.6)]).expand(10, 10, 3)
    torch.testing.assert_close(out.normals[middle], expected, atol=1e-4, rtol=0)
    torch.testing.assert_close(out.median_depth[middle], torch.full((10, 10), 2.0))
    assert out.depth[middle].max() > 2.01  # the expected depth sees the wall behind through the first
    out.normals[..., 0].sum().backward()
    assert leaves.quaternions.grad[0].abs().max() > 1.0
    plain = render(leaves, camera)
    assert plain.normals is None and plain.median_depth is None
    assert torch.equal(plain.color, out.color)


def test_bits_do_not_depend_on_the_number_of_threads(threads):
    results = []
    for count in (1, 2, 3):
        threads(count)
        out, leaves = rendered("none", 130, 100, count=3000)
        oracle.weighted_sum(out[:3], torch.ones(100, 130, dtype=torch.bool)).backward()
        results.append([*out[:3], *(leaf.grad for leaf in leaves.values())])
    assert results[0][1].max() > 0.99
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_the_order_of_gaussians_does_not_matter():
    gaussians = random_gaussians()
    shuffled = gaussians.select(torch.randperm(200, generator=torch.Generator().manual_seed(9)))
    first, second = (render(g, camera_at()) for g in (gaussians, shuffled))
    assert torch.equal(first.color, second.color)
    assert first.alpha.max() > 0.9


def test_one_gaussian_is_where_and_what_it_should_be():
    camera = camera_at(distance=2.0)
    out = render(single(), camera, background=BACKGROUND)
    row, column = int(camera.cy), int(camera.cx)
    opacity = torch.sigmoid(torch.tensor(2.0))
    assert out.alpha.argmax() == row * camera.width + column
    assert out.alpha[row, column].item() == pytest.approx(opacity.item(), abs=0.01)
    assert out.depth[row, column].item() == pytest.approx(2.0, abs=0.02)
    expected = out.alpha[row, column] * torch.tensor([0.9, 0.5, 0.2])
    expected = expected + (1 - out.alpha[row, column]) * torch.tensor(BACKGROUND)
    torch.testing.assert_close(out.color[row, column], expected, atol=1e-3, rtol=0)
    torch.testing.assert_close(out.color[0, 0], torch.tensor(BACKGROUND))
    assert out.alpha[0, 0] == 0 and out.depth[0, 0] == 0


def test_depth_is_of_what_is_drawn_not_of_the_background():
    """Expected z is divided by alpha: a thin veil has the depth of a solid one."""
    thin = render(single(opacity_logits=-2.0), camera_at())
    solid = render(single(opacity_logits=4.0), camera_at())
    both = (thin.alpha > 0.02) & (solid.alpha > 0.02)
    assert both.sum() > 20
    torch.testing.assert_close(thin.depth[both], solid.depth[both], rtol=1e-4, atol=0)


def test_without_depth_the_colors_are_the_same():
    gaussians = random_gaussians()
    full, bare = render(gaussians, camera_at()), render(gaussians, camera_at(), effects=Effects(depth=False))
    assert torch.equal(full.color, bare.color)
    assert not bare.depth.any() and full.depth.any()


def test_a_lower_degree_ignores_the_higher_terms():
    gaussians = random_gaussians()
    flat = Gaussians(**{**dict(gaussians.named()), "sh": gaussians.sh[:, :1]})
    low = render(gaussians, camera_at(), effects=Effects(sh_degree=0))
    torch.testing.assert_close(low.color, render(flat, camera_at()).color)
    assert (low.color - render(gaussians, camera_at()).color).abs().max() > 0.05


def test_without_its_lens_a_camera_is_a_pinhole():
    gaussians = random_gaussians()
    bare = render(gaussians, camera_at("brown"), effects=Effects(lens=False)).color
    assert torch.equal(bare, render(gaussians, camera_at("none")).color)
    assert (bare - render(gaussians, camera_at("brown")).color).abs().max() > 0.05


def test_without_a_background_none_is_blended():
    gaussians = random_gaussians()
    bare = render(gaussians, camera_at(), effects=Effects(background=False), background=BACKGROUND).color
    assert torch.equal(bare, render(gaussians, camera_at()).color)
    assert (bare - render(gaussians, camera_at(), background=BACKGROUND).color).abs().max() > 0.1
