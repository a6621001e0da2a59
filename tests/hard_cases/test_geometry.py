"""Hard cases of projection: what lies behind, too near, too thin, too large, or has no rotation."""

import math

import pytest
import torch

import oracle
from diga3d_warp.config import SPLATTING
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.scene.camera import Camera, Distortion
from diga3d_warp.splatting.project import project
from diga3d_warp.splatting.render import Rendering, render
from diga3d_warp.splatting.shade import shade
from scenes import LENSES, camera_at, random_gaussians, single

AHEAD = Camera(40, 30, 35.0, 35.0, 20.0, 15.0, torch.eye(4))
"""A camera at the origin that looks along z."""


def rendered(gaussians: Gaussians, camera: Camera = AHEAD) -> tuple[Rendering, Gaussians]:
    leaves = gaussians.detached().requires_grad_()
    out = render(leaves, camera)
    (out.color.sum() + out.depth.sum()).backward()
    for name, leaf in leaves.named():
        assert leaf.grad.isfinite().all(), name
    assert out.color.isfinite().all() and out.depth.isfinite().all()
    return out, leaves


def is_culled(out: Rendering, leaves: Gaussians) -> bool:
    nothing = not out.projection.extents.any()
    if nothing:
        assert not out.alpha.any() and not any(leaf.grad.any() for _, leaf in leaves.named())
    return nothing


@pytest.mark.parametrize(
    "z,drawn", [(-2.0, False), (0.0, False), (0.0099, False), (0.0101, True), (2.0, True)]
)
def test_nothing_is_drawn_behind_the_near_plane(z, drawn):
    gaussians = single(means=[0.0, 0.0, z], log_scales=[math.log(0.2 * max(z, 0.01))] * 3)
    out, leaves = rendered(gaussians)
    assert is_culled(out, leaves) != drawn
    if drawn:
        assert out.alpha.max() > 0.85
        assert leaves.means.grad.abs().max() > 0


def test_a_mean_at_the_camera_centre_is_culled_and_its_color_is_finite():
    out, leaves = rendered(single(means=[0.0, 0.0, 0.0]))
    assert is_culled(out, leaves)
    # Shading alone does not cull it: the direction has no length there.
    gaussians = random_gaussians(1)
    means = torch.zeros(1, 3, requires_grad=True)
    colors = shade(means, gaussians.sh, torch.ones(1, 2), AHEAD, 3)
    colors.sum().backward()
    flat = 0.5 + 0.28209479177387814 * gaussians.sh[:, 0]
    torch.testing.assert_close(colors, flat.clamp_min(0), atol=1e-6, rtol=0)
    assert means.grad.isfinite().all()


@pytest.mark.parametrize("thin", [-12.0, -30.0, -39.0])
def test_a_needle_has_a_factor_as_good_as_in_float64(thin):
    """Two axes of e^-12 and less beside one of 2.7: a d - b^2 would be off by 1e-3."""
    gaussians = single(
        means=[0.1, -0.05, 2.0],
        log_scales=[1.0, thin, thin],
        quaternions=[0.9, 0.1, 0.2, 0.4],
        opacity_logits=3.0,
    )
    out, _ = rendered(gaussians)
    splats = oracle.project(
        *(tensor.double() for name, tensor in gaussians.named() if name != "sh"), AHEAD.world_to_camera, AHEAD
    )
    conic = oracle.conics(out.projection.factors.double())
    assert conic.abs().max() > 0.5  # as thin as the low-pass allows
    torch.testing.assert_close(conic, splats.conics, rtol=1e-4, atol=1e-6)
    assert (out.alpha > 0.1).sum() > 20


@pytest.mark.parametrize("log_scale", [3.0, 8.0, 12.0, 16.0, 30.0, 39.0])
def test_a_huge_gaussian_covers_the_image_or_nothing(log_scale):
    out, leaves = rendered(single(means=[0.0, 0.0, 2.0], log_scales=[log_scale] * 3))
    if is_culled(out, leaves):
        assert log_scale > 10
    else:
        assert out.alpha.min() > 0.8


def test_an_oblique_gaussian_does_not_sweep_over_the_image():
    """Far beside the image its affine approximation would: the Jacobian stops at the margin."""
    beside = single(means=[3.0, 0.0, 0.05], log_scales=[-2.0] * 3)
    center = 20.0 + 35.0 * 3.0 / 0.05
    unbounded = 35.0 / 0.05 * (3.0 / 0.05) * math.exp(-2.0)  # f x / z^2 times sigma
    assert unbounded > 2.0 * center
    assert is_culled(*rendered(beside))


@pytest.mark.parametrize(
    "quaternion", [[0.0] * 4, [1e-45] * 4, [1e-20, 0.0, 0.0, 0.0], [4e-5, 4e-5, 4e-5, 4e-5]]
)
def test_a_quaternion_without_direction_is_culled(quaternion):
    out, leaves = rendered(single(means=[0.0, 0.0, 2.0], quaternions=quaternion))
    assert is_culled(out, leaves)


@pytest.mark.parametrize("length", [2e-4, 1.0, 1e6, 1e14])
def test_the_length_of_a_quaternion_does_not_matter(length):
    direction = torch.tensor([0.9, 0.1, 0.2, 0.4])
    unit, scaled = (
        rendered(
            single(
                means=[0.0, 0.0, 2.0], log_scales=[-1.0, -2.0, -3.0], quaternions=(scale * direction).tolist()
            )
        )
        for scale in (1.0, length)
    )
    torch.testing.assert_close(scaled[0].alpha, unit[0].alpha, atol=1e-5, rtol=0)
    torch.testing.assert_close(
        scaled[1].quaternions.grad * length, unit[1].quaternions.grad, rtol=1e-3, atol=1e-3
    )
    assert unit[1].quaternions.grad.abs().max() > 0.1


@pytest.mark.parametrize("kind,k1,radius", [("brown", -0.6, 1.29), ("fisheye", -0.5, 4.0)])
def test_what_a_lens_folds_back_into_the_image_is_culled(kind, k1, radius):
    """The polynomial returns to the middle of the image: 1.29 (1 - 0.6 * 1.29^2) = 0.002."""
    lens = Distortion(kind, (k1, 0.0, 0.0, 0.0))
    camera = Camera(40, 30, 35.0, 35.0, 20.0, 15.0, torch.eye(4), lens)
    beyond = single(means=[2.0 * radius, 0.0, 2.0])
    assert abs(oracle.distort(torch.tensor([radius]), torch.zeros(1), camera)[0].item()) < 0.4
    assert is_culled(*rendered(beyond, camera))
    inside, _ = rendered(single(means=[0.6, 0.0, 2.0]), camera)
    assert inside.alpha.max() > 0.8


@pytest.mark.parametrize("lens", LENSES)
def test_exactly_on_the_axis_of_a_lens(lens):
    """The fisheye divides by the distance from the axis; all lenses have slope one there."""
    camera = Camera(40, 30, 35.0, 35.0, 20.0, 15.0, torch.eye(4), LENSES[lens])
    out, leaves = rendered(single(means=[0.0, 0.0, 2.0]), camera)
    torch.testing.assert_close(out.projection.centers, torch.tensor([[20.0, 15.0]]))
    variance = (35.0 / 2.0 * math.exp(-1.6)) ** 2 + SPLATTING.low_pass
    torch.testing.assert_close(
        oracle.conics(out.projection.factors)[0, ::2], torch.full((2,), 1 / variance), rtol=1e-3, atol=0
    )
    assert leaves.means.grad.abs().max() > 0.1


def test_a_lens_that_reaches_no_pixel_shows_nothing():
    lens = Distortion("brown", (-0.4, 0.0, 0.0, 0.0))  # maps to 0.61 focal lengths at most
    camera = Camera(8, 6, 35.0, 35.0, 100.0, 3.0, torch.eye(4), lens)
    out, leaves = rendered(single(means=[0.0, 0.0, 2.0]), camera)
    assert not out.alpha.any() and not leaves.means.grad.any()


def test_poses_far_from_the_origin_project_alike():
    """A scene shifted by 1000 units, camera and all, looks the same to the precision that is left."""
    gaussians, camera = random_gaussians(50), camera_at()
    shift = torch.tensor([1000.0, -500.0, 300.0])
    moved = Gaussians(**{**dict(gaussians.named()), "means": gaussians.means + shift})
    pose = camera.world_to_camera.clone()
    pose[:3, 3] -= pose[:3, :3] @ shift.double()
    parameters = [tensor for name, tensor in gaussians.named() if name not in ("means", "sh")]
    first = project(gaussians.means, *parameters, camera)
    second = project(moved.means, *parameters, camera.with_pose(pose))
    assert first.extents.all()
    torch.testing.assert_close(second.centers, first.centers, atol=0.02, rtol=0)


def test_the_low_pass_keeps_a_splat_a_pixel_wide():
    out, _ = rendered(single(means=[0.0, 0.0, 2.0], log_scales=[-30.0] * 3, opacity_logits=20.0))
    expected = torch.tensor([[1 / SPLATTING.low_pass, 0.0, 1 / SPLATTING.low_pass]])
    torch.testing.assert_close(oracle.conics(out.projection.factors), expected, rtol=1e-5, atol=1e-6)
    assert 1 <= (out.alpha > 0).sum() <= 16
