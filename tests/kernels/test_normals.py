"""Normals of the shortest axes, against the plain renderer's rotations."""

import pytest
import torch

import oracle
from diga3d_warp.splatting.normals import orient
from scenes import camera_at, random_gaussians

COUNT = 120


def inputs(dtype: torch.dtype, device: str = "cpu"):
    """Leaves in the order of `orient`, a camera with a pose of its own, and extents with culled rows."""
    gaussians, camera = random_gaussians(COUNT, seed=3, degree=0), camera_at()
    pose = camera.world_to_camera.clone().requires_grad_()
    names = ("means", "log_scales", "quaternions")
    leaves = [getattr(gaussians, name).to(device, dtype).requires_grad_() for name in names]
    extents = torch.ones(COUNT, 2, dtype=dtype, device=device)
    extents[::9] = 0.0
    return leaves, extents, camera.with_pose(pose), pose


def expected(leaves, pose: torch.Tensor) -> torch.Tensor:
    means, log_scales, quaternions = (leaf.detach().cpu().double() for leaf in leaves[:3])
    quaternions = leaves[2].double().cpu()
    axes = pose[:3, :3] @ oracle.rotations(quaternions)
    shortest = axes[torch.arange(COUNT), :, log_scales.argmin(1)]
    towards = means @ pose[:3, :3].T + pose[:3, 3]
    return torch.where((shortest * towards).sum(1, keepdim=True) > 0, -shortest, shortest)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_normals_and_gradients_agree_with_float64(dtype, device):
    leaves, extents, camera, pose = inputs(dtype, device)
    found = orient(*leaves, extents, camera)
    drawn = (extents[:, 0] > 0).cpu()
    truth = expected(leaves, pose) * drawn[:, None]
    tolerance = 1e-5 if dtype == torch.float32 else 1e-12
    torch.testing.assert_close(found.cpu().double(), truth, atol=tolerance, rtol=0)
    torch.testing.assert_close(found.norm(dim=1).cpu().double(), drawn.double(), atol=1e-5, rtol=0)

    weights = torch.randn(COUNT, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    moved = [leaves[2], pose]
    mine = torch.autograd.grad((found * weights.to(found)).sum(), [*leaves[:2], *moved], allow_unused=True)
    assert mine[0] is None and mine[1] is None
    reference = torch.autograd.grad((truth * weights).sum(), moved)
    for got, wanted in zip(mine[2:], reference, strict=True):
        assert wanted.abs().max() > 0.1
        assert (got.cpu() - wanted.cpu()).norm() < 10 * tolerance * wanted.norm()
    assert not mine[2][~drawn].any()


def test_gradcheck():
    leaves, extents, camera, pose = inputs(torch.float64)
    rows = slice(1, 6)
    means, log_scales, quaternions = (leaf.detach()[rows] for leaf in leaves)

    def normals(quaternions, pose):
        return orient(means, log_scales, quaternions, extents[rows], camera.with_pose(pose))

    assert torch.autograd.gradcheck(normals, (quaternions.requires_grad_(), pose))


def test_normals_face_the_camera_from_either_side():
    leaves, extents, camera, _ = inputs(torch.float64)
    turned = camera.world_to_camera.detach().clone()
    turned[:3, :3] = torch.diag(torch.tensor([-1.0, 1.0, -1.0], dtype=torch.float64)) @ turned[:3, :3]
    for view in (camera, camera.with_pose(turned)):
        normals = orient(*leaves, extents, view)
        p = leaves[0] @ view.world_to_camera[:3, :3].T + view.world_to_camera[:3, 3]
        assert ((normals * p).sum(1) <= 0).all()


def test_of_equally_short_axes_the_first_is_taken():
    leaves, extents, camera, pose = inputs(torch.float32)
    sphere = torch.zeros(COUNT, 3)
    disc = torch.tensor([-1.0, -3.0, -3.0]).repeat(COUNT, 1)
    rotation = pose[:3, :3].detach() @ oracle.rotations(leaves[2].detach().double())
    for scales, axis in ((sphere, 0), (disc, 1)):
        normals = orient(leaves[0], scales, leaves[2], extents, camera).double()
        along = (normals * rotation[:, :, axis]).sum(1).abs()
        torch.testing.assert_close(along, (extents[:, 0] > 0).double(), atol=1e-5, rtol=0)
