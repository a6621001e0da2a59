"""EWA projection against the plain float64 renderer."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

import oracle
from diga3d_warp.config import POSE_GROUP, Accuracy, Effects
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.composite import bin_projection
from diga3d_warp.splatting.normals import orient
from diga3d_warp.splatting.optics import optics_of
from diga3d_warp.splatting.project import Projection, project
from poison import images, rendered
from scenes import LENSES, camera_at, random_gaussians

COUNT = 400


def wide_scene(count: int = COUNT):
    """Gaussians all around the camera: some behind it, many outside its image."""
    gaussians = random_gaussians(count, seed=1, degree=0)
    gaussians.means *= 3.0
    return gaussians


def projected(
    gaussians, camera: Camera, device: str = "cpu", **ways
) -> tuple[Projection, dict[str, torch.Tensor]]:
    """A projection, and the leaves that its gradients reach."""
    leaves = {name: tensor.detach().to(device).requires_grad_() for name, tensor in gaussians.named()}
    leaves.pop("sh")
    pose, intrinsics = (t.clone().requires_grad_() for t in (camera.world_to_camera, camera.intrinsics))
    projection = project(*leaves.values(), camera.with_pose(pose).with_intrinsics(intrinsics), **ways)
    return projection, {**leaves, "pose": pose, "intrinsics": intrinsics}


def expected(gaussians, camera: Camera, **ways) -> tuple[oracle.Splats, dict[str, torch.Tensor]]:
    leaves = {name: tensor.detach().double().requires_grad_() for name, tensor in gaussians.named()}
    leaves.pop("sh")
    pose, intrinsics = (t.clone().requires_grad_() for t in (camera.world_to_camera, camera.intrinsics))
    splats = oracle.project(*leaves.values(), pose, camera.with_intrinsics(intrinsics), **ways)
    return splats, {**leaves, "pose": pose, "intrinsics": intrinsics}


def inside_lens(gaussians, camera: Camera) -> torch.Tensor:
    """Gaussians whose ray the lens maps one to one, shape (N,)."""
    p = gaussians.means.double() @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    return (p[:, :2] / p[:, 2:]).norm(dim=1) < optics_of(camera).radius_max


def mixed_sum(splats, weights: list[torch.Tensor]) -> torch.Tensor:
    conics = oracle.conics(splats.factors) if isinstance(splats, Projection) else splats.conics
    parts = (splats.centers, splats.depths, conics, splats.opacities)
    return sum((part * weight.to(part)).sum() for part, weight in zip(parts, weights, strict=True))


@pytest.mark.parametrize("lens", LENSES)
def test_values_agree_with_float64(lens, device):
    gaussians, camera = wide_scene(), camera_at(lens)
    found, _ = projected(gaussians, camera, device)
    splats, _ = expected(gaussians, camera)
    visible = found.visible.cpu()
    drawn = splats.drawn & inside_lens(gaussians, camera)
    assert (visible >= (drawn & splats.meets(camera, -0.01))).all()
    assert (visible <= (drawn & splats.meets(camera, 0.51))).all()  # to the outer edge of the border's pixels
    assert COUNT // 5 < visible.sum() < drawn.sum() - COUNT // 5 < COUNT  # some are behind the camera, too

    def agree(values, reference, rtol):
        torch.testing.assert_close(values.cpu().double()[visible], reference[visible], rtol=rtol, atol=1e-4)

    agree(found.centers, splats.centers, 1e-4)  # far-off rays go through a fifth power of themselves
    agree(found.depths, splats.depths, 1e-5)
    agree(oracle.conics(found.factors), splats.conics, 1e-4)
    agree(found.opacities, splats.opacities, 1e-5)
    reach = (2 * torch.log(255 * splats.opacities)).clamp_min(0).sqrt()
    agree(found.extents, reach[:, None] * splats.covariances.diagonal(dim1=1, dim2=2).sqrt(), 1e-3)


@pytest.mark.parametrize("lens", LENSES)
def test_gradients_agree_with_float64(lens, device):
    gaussians, camera = wide_scene(), camera_at(lens)
    found, leaves = projected(gaussians, camera, device)
    splats, references = expected(gaussians, camera)
    # Next to the camera plane numbers grow without bound; they would hide all others.
    tame = found.visible.cpu() & (splats.depths > 0.5)
    assert tame.sum() > COUNT // 6
    random = torch.Generator().manual_seed(2)
    shapes = [(COUNT, 2), (COUNT,), (COUNT, 3), (COUNT,)]
    weights = [
        torch.rand(shape, generator=random) * tame.view(-1, *[1] * (len(shape) - 1)) for shape in shapes
    ]
    mixed_sum(found, weights).backward()
    mixed_sum(splats, weights).backward()
    for name, leaf in leaves.items():
        reference = references[name].grad
        assert reference.abs().max() > 0.1
        error = (leaf.grad.cpu().double() - reference).norm() / reference.norm()
        assert error < 1e-4, f"{name}: {error}"


def test_the_jacobian_is_followed_no_further_than_the_margin():
    gaussians, camera = wide_scene(), camera_at()
    gaussians.log_scales += 1.0  # so that some reach into the image from beyond
    low, high = oracle.field_of_view(camera)
    p = gaussians.means.double() @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    ray = p[:, :2] / p[:, 2:]
    found, _ = projected(gaussians, camera)
    outside = found.visible & ((ray < low) | (ray > high)).any(1)
    assert outside.sum() > 10  # the comparisons above went through the clamp
    # The same focal lengths in a larger image: its margin lies far out.
    free = Camera(6400, 4800, camera.fx, camera.fy, 3200.0, 2400.0, camera.world_to_camera)
    unclamped, _ = projected(gaussians, free)
    assert (unclamped.extents[outside].norm(dim=1) > 1.2 * found.extents[outside].norm(dim=1)).any()


@pytest.mark.parametrize("lens", LENSES)
def test_culled_rows_are_exact_zeros_with_zero_gradient(lens):
    gaussians, camera = wide_scene(), camera_at(lens)
    found, leaves = projected(gaussians, camera)
    culled = ~found.visible
    ahead = culled & expected(gaussians, camera)[0].drawn & inside_lens(gaussians, camera)
    assert COUNT // 5 < ahead.sum() < culled.sum() < COUNT, "outside the image, and behind the camera"
    for part in found[:5]:
        assert torch.equal(part[culled], torch.zeros_like(part[culled]))
    shapes = [found.centers.shape, found.depths.shape, found.factors.shape, found.opacities.shape]
    mixed_sum(found, [torch.ones(shape) for shape in shapes]).backward()
    for name, leaf in leaves.items():
        if name not in ("pose", "intrinsics"):
            assert torch.equal(leaf.grad[culled], torch.zeros_like(leaf.grad[culled]))
            assert (leaf.grad[~culled] != 0).any()


@pytest.mark.parametrize("size", [(64, 48), (37, 29), (1, 1)])
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_gaussian_is_visible_exactly_if_a_tile_lists_it(precision, size):
    """Both sides of the border of images whose last tiles reach beyond it."""
    gaussians, camera = wide_scene(3000), camera_at("none", *size)
    gaussians.log_scales -= 2.0
    accuracy = Accuracy(precision=precision)
    found, _ = projected(gaussians, camera, accuracy=accuracy)
    bins = bin_projection(found, *size)
    listed = torch.from_numpy(np.diff(bins.first.numpy()) > 0)
    assert torch.equal(listed, found.visible)
    assert 0 < listed.sum() < 2500


@pytest.mark.parametrize("effects", [Effects(), Effects(pixel_order=True)], ids=["3DGS", "pixel order"])
@pytest.mark.parametrize("extent", ["ellipse", "circle"])
def test_culling_against_the_image_changes_no_bit(effects, extent, monkeypatch):
    """Compared with a projection that takes the image for a very large one."""
    gaussians, camera, accuracy = wide_scene(2000), camera_at("none", 37, 29), Accuracy(extent=extent)
    gaussians.log_scales += 2.0 * torch.randn(2000, 3, generator=torch.Generator().manual_seed(3))
    out, leaves = rendered(gaussians, camera, effects, accuracy)
    optics = replace(optics_of(camera), width=10**6, height=10**6)
    monkeypatch.setattr("diga3d_warp.splatting.project.optics_of", lambda _: optics)
    whole, others = rendered(gaussians, camera, effects, accuracy)
    assert whole.projection.visible.sum() > out.projection.visible.sum() + 100
    assert out.alpha.mean() > 0.3
    for (name, image), (_, other) in zip(images(out), images(whole), strict=True):
        assert torch.equal(image, other), name
    for name, leaf in leaves.items():
        assert leaf.grad is others[name].grad is None or torch.equal(leaf.grad, others[name].grad), name


@pytest.mark.parametrize("footprint", ["affine", "unscented"])
def test_bits_do_not_depend_on_the_number_of_threads(footprint, threads):
    gaussians, camera = wide_scene(3 * POSE_GROUP + 17), camera_at()
    accuracy = Accuracy(footprint=footprint, pixel_order=True)
    results = []
    for count in (1, 2, 3):
        threads(count)
        found, leaves = projected(gaussians, camera, accuracy=accuracy)
        normals = orient(*list(leaves.values())[:3], found.extents, camera.with_pose(leaves["pose"]))
        parts = (found.centers, found.factors, found.depths, found.depth_slopes, normals)
        sum(part.sum() for part in parts).backward()
        results.append([*found, normals, *(leaf.grad for leaf in leaves.values())])
    assert all(part.abs().max() > 0.01 for part in (*parts, leaves["pose"].grad))
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_a_gaussian_on_the_axis_of_a_fisheye_has_the_pinhole_s_shape():
    """At the axis the lens has slope one; its formula divides by a radius of zero there."""
    gaussians = random_gaussians(1, degree=0)
    gaussians.means[:] = 0.0
    pinhole, fisheye = (
        Camera(64, 48, 50.0, 50.0, 32.0, 24.0, camera_at().world_to_camera, LENSES[lens])
        for lens in ("none", "fisheye")
    )
    plain, _ = projected(gaussians, pinhole)
    bent, leaves = projected(gaussians, fisheye)
    assert plain.extents[0, 0] > 1.0
    torch.testing.assert_close(
        oracle.conics(bent.factors), oracle.conics(plain.factors), rtol=1e-3, atol=1e-6
    )
    bent.centers.sum().backward()
    assert leaves["means"].grad.isfinite().all()
    assert math.isclose(bent.centers[0, 0].item(), 32.0, abs_tol=1e-3)
