"""Hard cases of blending: the cut-offs of 3DGS, ties, and nothing to draw."""

import math

import pytest
import torch

import oracle
from diga3d_warp.config import Accuracy, Effects
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.composite import composite
from diga3d_warp.splatting.project import project
from diga3d_warp.splatting.render import Rendering, render
from scenes import random_gaussians, single

AHEAD = Camera(40, 30, 35.0, 35.0, 20.0, 15.0, torch.eye(4))
BACKGROUND = torch.tensor([0.2, 0.5, 0.9])
SH0 = 0.28209479177387814
WALL = 6.0
"""Logarithm of a scale so large that a gaussian is as opaque at the border as in the middle."""


def stack(
    opacities: list[float], colors: list[list[float]], depths: list[float], log_scale: float
) -> Gaussians:
    """Round gaussians on the axis of the camera."""
    count = len(depths)
    opacity = torch.tensor(opacities, dtype=torch.float64)
    means = torch.zeros(count, 3)
    means[:, 2] = torch.tensor(depths)
    return Gaussians(
        means=means,
        log_scales=torch.full((count, 3), log_scale),
        quaternions=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(count, 1),
        opacity_logits=torch.logit(opacity).float(),
        sh=((torch.tensor(colors) - 0.5) / SH0)[:, None],
    )


def rendered(gaussians: Gaussians, camera: Camera = AHEAD) -> tuple[Rendering, Gaussians]:
    leaves = gaussians.detached().requires_grad_()
    out = render(leaves, camera, background=BACKGROUND)
    (out.color.sum() + out.depth.sum()).backward()
    assert all(leaf.grad.isfinite().all() for _, leaf in leaves.named())
    return out, leaves


@pytest.mark.parametrize("opacity", [0.991, 0.999999, 1.0])
def test_alpha_saturates_and_its_gradient_stops(opacity):
    """Clamped everywhere: no gradient for opacity or shape, but one for colour."""
    out, leaves = rendered(stack([opacity], [[0.9, 0.1, 0.4]], [2.0], WALL))
    torch.testing.assert_close(out.alpha, torch.full((30, 40), 0.99), atol=1e-6, rtol=0)
    for name in ("opacity_logits", "log_scales", "quaternions"):
        assert not getattr(leaves, name).grad.any(), name
    assert leaves.sh.grad.abs().min() > 1


def test_below_saturation_the_gradient_flows():
    out, leaves = rendered(stack([0.98], [[0.9, 0.1, 0.4]], [2.0], WALL))
    assert out.alpha.min() > 0.97 and out.alpha.max() < 0.9801
    assert leaves.opacity_logits.grad.abs().max() > 0.1


def test_the_gaussian_that_would_end_a_pixel_is_left_out():
    """0.02^2 = 4e-4 is left; the third would take it to 8e-6 < 1e-4, so the background keeps its share."""
    colors = [[0.9, 0.1, 0.1], [0.1, 0.9, 0.1], [0.1, 0.1, 0.9]]
    out, leaves = rendered(stack([0.98, 0.98, 0.98], colors, [2.0, 3.0, 4.0], WALL))
    left = 0.02**2
    torch.testing.assert_close(1 - out.alpha, torch.full((30, 40), left), atol=5e-6, rtol=0)
    expected = 0.98 * torch.tensor(colors[0]) + 0.02 * 0.98 * torch.tensor(colors[1]) + left * BACKGROUND
    torch.testing.assert_close(out.color, expected.expand(30, 40, 3), atol=1e-4, rtol=0)
    for _, leaf in leaves.named():
        assert not leaf.grad[2].any()
    assert leaves.sh.grad[1].abs().min() > 1


def test_a_finished_pixel_takes_nothing_that_would_fit():
    """Six small gaussians end the pixels in the middle; a faint loud wall behind them is for the others."""
    leaves = stack(
        [0.98] * 6 + [0.02], [[0.5] * 3] * 6 + [[99.0] * 3], [2.0 + 0.1 * k for k in range(7)], WALL
    )
    leaves.log_scales[:6] = math.log(0.1)
    leaves = leaves.detached().requires_grad_()
    color = render(leaves, AHEAD, background=BACKGROUND).color
    without = render(leaves.select(torch.arange(6)), AHEAD, background=BACKGROUND).color
    for y, x, taken in ((14, 19, False), (12, 16, True)):  # of one block
        difference = (color[y, x] - without[y, x]).abs().max()
        assert difference > 1.0 if taken else difference < 1e-6
        (gradient,) = torch.autograd.grad(color[y, x].sum(), leaves.sh, retain_graph=True)
        assert bool(gradient[6].any()) == taken


def test_many_opaque_layers_leave_a_true_remainder():
    """Transmittance is kept, not recovered as 1 - alpha: 200 layers of 2 % leave 0.98^200 = 0.0176."""
    count = 200
    out, _ = rendered(stack([0.02] * count, [[0.5] * 3] * count, [2 + 0.01 * k for k in range(count)], WALL))
    torch.testing.assert_close(1 - out.alpha, torch.full((30, 40), 0.98**count), rtol=2e-4, atol=0)


def test_a_nearly_finished_pixel_keeps_the_digits_of_its_transmittance():
    """Layers of 0.98 and 0.99 leave 2e-4; taken as 1 - alpha, float32 would be off by 1e-4 of it."""
    gaussians = stack([0.98, 0.999], [[0.5] * 3] * 2, [2.0, 3.0], WALL + 2.0)
    projection = project(*(tensor for name, tensor in gaussians.named() if name != "sh"), AHEAD)
    left = composite(projection, torch.ones(2, 3), 40, 30).transmittance.double()
    alphas = projection.opacities.clamp_max(0.99).double()
    expected = ((1 - alphas[0]) * (1 - alphas[1])).expand(30, 40)
    torch.testing.assert_close(left, expected, rtol=3e-5, atol=0)


@pytest.mark.parametrize(
    "logit,precision", [(0.0, "float32"), (-1.0, "float32"), (2.0, "float32"), (0.0, "float64")]
)
def test_an_opacity_of_just_the_skip_has_a_gradient(logit, precision):
    """At alpha_min the logarithm is 0, and a box without size would mark a culled gaussian."""
    gaussians = single(means=[0.0, 0.0, 2.0], opacity_logits=logit)
    leaves, alpha_min = gaussians.detached().requires_grad_(), 0.5
    out = render(leaves, AHEAD, accuracy=Accuracy(alpha_min=alpha_min, precision=precision))
    (out.color.sum() + out.projection.opacities.sum()).backward()
    assert bool(out.projection.extents.any()) == (torch.sigmoid(torch.tensor(logit)) >= alpha_min)
    assert all(leaf.grad is None or leaf.grad.isfinite().all() for _, leaf in leaves.named())


@pytest.mark.parametrize("opacity,drawn", [(0.0, False), (0.0039, False), (0.00393, True), (0.02, True)])
def test_below_one_step_of_eight_bits_nothing_is_drawn(opacity, drawn):
    """1/255 = 0.003922. The radius sqrt(2 ln(255 o)) has no value below it."""
    out, leaves = rendered(stack([opacity], [[0.9, 0.1, 0.4]], [2.0], WALL))
    assert bool(out.projection.extents.any()) == drawn
    assert out.projection.extents.isfinite().all()
    if not drawn:
        assert torch.equal(out.color, BACKGROUND.expand(30, 40, 3))
        assert not any(leaf.grad.any() for _, leaf in leaves.named())
    else:
        assert out.alpha.max().item() == pytest.approx(opacity, rel=1e-3)


def test_the_skip_has_the_radius_that_projection_promises():
    """Alpha falls to 1/255 on an ellipse that touches its box: light inside, none outside."""
    out, _ = rendered(stack([0.8], [[0.9, 0.1, 0.4]], [2.0], -1.5))
    reach = out.projection.extents[0, 0].item()
    assert 10 < reach < 14  # less than the image, and no multiple of the 4 px in which pixels are blended
    columns, rows = torch.arange(40) + 0.5 - 20.0, torch.arange(30) + 0.5 - 15.0
    distance = (columns**2 + rows[:, None] ** 2).sqrt()
    clear = (distance - reach).abs() > 1e-3
    assert torch.equal((out.alpha > 0)[clear], (distance < reach)[clear])
    assert clear.float().mean() > 0.99


@pytest.mark.parametrize("swapped", [False, True])
def test_equal_depths_keep_the_order_of_their_indices(swapped):
    red, green = [0.9, 0.0, 0.0], [0.0, 0.9, 0.0]
    colors = [green, red] if swapped else [red, green]
    out, _ = rendered(stack([0.9, 0.9], colors, [2.0, 2.0], WALL))
    front = 1 if swapped else 0
    assert (out.color[..., front] > 5 * out.color[..., 1 - front]).all()


def test_more_ties_than_one_round_of_per_pixel_order_takes():
    """It takes 16 gaussians a round; the next begins after the last pair, not after the last depth."""
    count = 50
    walls = stack([0.02] * count, [[0.5] * 3] * count, [2.0] * count, WALL + 2.0)
    out = render(walls, AHEAD, effects=Effects(pixel_order=True))
    torch.testing.assert_close(1 - out.alpha, torch.full((30, 40), 0.98**count), rtol=1e-3, atol=0)


@pytest.mark.parametrize("depth", [0.0101, 2.0, 1e6, 1e12])
@pytest.mark.parametrize("swapped", [False, True])
def test_depths_that_differ_in_their_last_bit_are_sorted(depth, swapped):
    """The whole float is the key: a depth in 16 bits, or one that is linear in a range, would tie."""
    near = torch.tensor(depth)
    depths = [near.item(), torch.nextafter(near, torch.tensor(torch.inf)).item()]
    red, green = [0.9, 0.0, 0.0], [0.0, 0.9, 0.0]
    out, _ = rendered(
        stack([0.9, 0.9], [red, green], depths[::-1] if swapped else depths, WALL + math.log(depth))
    )
    front = 1 if swapped else 0
    assert (out.color[..., front] > 5 * out.color[..., 1 - front]).all()


@pytest.mark.parametrize("degree", [0, 3])
def test_no_gaussians_give_the_background(degree):
    out, leaves = rendered(random_gaussians(0, degree=degree))
    assert torch.equal(out.color, BACKGROUND.expand(30, 40, 3))
    assert not out.alpha.any() and not out.depth.any()
    assert leaves.means.grad.shape == (0, 3)


def test_no_gaussians_leave_the_pose_a_gradient_of_zero():
    pose = torch.eye(4, dtype=torch.float64, requires_grad=True)
    out = render(random_gaussians(0).requires_grad_(), AHEAD.with_pose(pose))
    out.color.sum().backward()
    assert pose.grad is None or not pose.grad.any()


def test_an_empty_view_gives_the_background_and_no_gradient():
    gaussians = random_gaussians(50)
    gaussians.means[:, 2] -= 50.0
    out, leaves = rendered(gaussians)
    assert torch.equal(out.color, BACKGROUND.expand(30, 40, 3))
    assert not out.alpha.any() and not out.depth.any()
    assert not any(leaf.grad.any() for _, leaf in leaves.named())


@pytest.mark.parametrize("width,height", [(1, 1), (1, 40), (16, 16), (17, 15), (33, 1)])
def test_images_of_any_size(width, height):
    gaussians = random_gaussians(40)
    gaussians.means[:, 2] += 3.0
    camera = Camera(width, height, 40.0, 40.0, 0.5 * width, 0.5 * height, torch.eye(4))
    out, _ = rendered(gaussians, camera)
    parameters = [tensor.double() for _, tensor in gaussians.named()]
    color, alpha, _, certain = oracle.render(parameters, camera.world_to_camera, BACKGROUND, camera, degree=3)
    assert certain.any() and alpha.max() > 0.3
    torch.testing.assert_close(out.color[certain].double(), color[certain], atol=1e-4, rtol=0)
