"""Every hard case as a small scene: images and all gradients are those of the plain float64 renderer."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

import oracle
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.render import Rendering, render
from scenes import random_gaussians

COUNT = 60
AHEAD = Camera(40, 30, 35.0, 35.0, 20.0, 15.0, torch.eye(4))
"""A camera at the origin that looks along z."""
CROP = Camera(40, 30, 35.0, 35.0, -15.0, 44.0, torch.eye(4))
"""The corner of a larger image: the principal point lies outside."""


def ahead(seed: int, nearest: float = 1.5, farthest: float = 6.0) -> Gaussians:
    """A cloud in the view of `AHEAD`, its far parts as wide in the image as its near ones."""
    gaussians = random_gaussians(COUNT, seed=seed)
    random = torch.Generator().manual_seed(seed)
    z = nearest * (farthest / nearest) ** torch.rand(COUNT, generator=random)
    gaussians.means = torch.stack([0.4 * gaussians.means[:, 0], 0.4 * gaussians.means[:, 1], z], -1)
    gaussians.means[:, :2] *= z[:, None]
    gaussians.log_scales += (z / 4).log()[:, None]
    return gaussians


def near_plane() -> Gaussians:
    """Some behind the camera, some within the near plane at 0.01, some just beyond it."""
    gaussians = ahead(1, 0.0105, 3.0)
    gaussians.means[::6, 2] *= -1.0
    gaussians.means[1::6, 2] = 0.0099
    return gaussians


def camera_centre() -> Gaussians:
    """A mean at the centre of the camera, which has no direction, and means around it."""
    gaussians = ahead(2)
    gaussians.means[0] = 0.0
    gaussians.means[1] = torch.tensor([0.0, 0.0, 1e-30])
    gaussians.means[2:6] *= 1e-3
    return gaussians


def oblique() -> Gaussians:
    """Most are beside the image, where the EWA Jacobian is no longer followed."""
    gaussians = ahead(3, 0.5, 4.0)
    gaussians.means[:, :2] *= 4.0
    gaussians.log_scales += 0.7
    return gaussians


def needles() -> Gaussians:
    gaussians = ahead(4)
    gaussians.log_scales[:, 0] += 2.0
    gaussians.log_scales[:, 1] = -12.0
    gaussians.log_scales[:, 2] = torch.linspace(-39.0, -8.0, COUNT)
    return gaussians


def huge() -> Gaussians:
    gaussians = ahead(5)
    gaussians.log_scales[::2] += 5.0
    gaussians.opacity_logits -= 2.0
    return gaussians


def no_rotation() -> Gaussians:
    """Quaternions of zero and of denormal length, and of every length that names a rotation."""
    gaussians = ahead(6)
    gaussians.quaternions *= 10.0 ** torch.linspace(-2.0, 12.0, COUNT)[:, None]
    gaussians.quaternions[::5] = 0.0
    gaussians.quaternions[1::5] = 1e-40
    return gaussians


def opaque() -> Gaussians:
    """Opacities up to 1: alpha saturates, and pixels are finished after two or three gaussians."""
    gaussians = ahead(7)
    gaussians.log_scales += 1.0
    gaussians.opacity_logits = torch.linspace(2.0, 30.0, COUNT)[torch.arange(0, 7 * COUNT, 7) % COUNT]
    gaussians.opacity_logits[0] = torch.inf
    return gaussians


def faint() -> Gaussians:
    """Opacities about 1/255, logit -5.537."""
    gaussians = ahead(8)
    gaussians.opacity_logits = torch.linspace(-5.6, -5.0, COUNT)
    return gaussians


def ties() -> Gaussians:
    """All at two depths."""
    gaussians = ahead(9)
    gaussians.means[:, 2] = torch.tensor([2.0, 3.0]).repeat(COUNT // 2)
    return gaussians


def far_away() -> Gaussians:
    """A million units away."""
    gaussians = ahead(10)
    gaussians.means *= 1e6
    gaussians.log_scales += 13.8
    return gaussians


def one() -> Gaussians:
    return ahead(11).select(torch.tensor([7]))


CASES: dict[str, tuple[Callable[[], Gaussians], Camera]] = {
    "near plane": (near_plane, AHEAD),
    "camera centre": (camera_centre, AHEAD),
    "oblique": (oblique, AHEAD),
    "oblique in a crop": (oblique, CROP),
    "needles": (needles, AHEAD),
    "huge": (huge, AHEAD),
    "no rotation": (no_rotation, AHEAD),
    "opaque": (opaque, AHEAD),
    "faint": (faint, AHEAD),
    "ties": (ties, AHEAD),
    "far away": (far_away, AHEAD),
    "one gaussian": (one, AHEAD),
}


BACKGROUND = torch.tensor([0.2, 0.5, 0.9])


@pytest.mark.parametrize("name", CASES)
def test_image_and_gradients(name, device):
    make, camera = CASES[name]
    gaussians = make()
    found, leaves = rendered(gaussians, camera, device)
    drawn = (gaussians.means[:, 2] >= oracle.NEAR) & (gaussians.opacities >= oracle.ALPHA_MIN)
    drawn &= gaussians.quaternions.norm(dim=1) >= 1e-4
    visible = found.projection.visible.cpu()
    assert visible.any() and not (visible & ~drawn).any()

    # The oracle sees the drawn rows alone: zero length and depth have no gradient to compare with. It draws
    # those outside the image, too, in vain.
    rows = {field: drawn for field, _ in gaussians.named()}
    references = {
        field: leaf.detach().cpu()[rows.get(field, ...)].double().requires_grad_()
        for field, leaf in leaves.items()
    }
    *parameters, pose, background = references.values()
    *reference, certain = oracle.render(parameters, pose, background, camera, degree=3)
    assert certain.float().mean() > 0.6
    assert reference[1].max() > (0.01 if make is faint else 0.3), "not blank"
    for value, image in zip(found[:3], reference, strict=True):
        error = (value.detach().cpu().double() - image.detach())[certain].abs().max()
        assert error < 1e-4 * max(1.0, image.max().item())

    oracle.weighted_sum(found[:3], certain).backward()
    oracle.weighted_sum(reference, certain).backward()
    for field, leaf in leaves.items():
        gradient, wanted = leaf.grad.cpu().double(), references[field].grad
        if field in rows:
            assert not gradient[~drawn].any(), field
            gradient = gradient[drawn]
        if field == "quaternions":  # a gradient is as large as its quaternion is short
            lengths = references[field].detach().norm(dim=1, keepdim=True)
            gradient, wanted = lengths * gradient, lengths * wanted
        assert wanted.any(), field
        error = (gradient - wanted).norm() / wanted.norm()
        assert error < 1e-3, f"{field}: {error}"


def rendered(gaussians: Gaussians, camera: Camera, device: str) -> tuple[Rendering, dict[str, torch.Tensor]]:
    leaves = gaussians.detached().to(device).requires_grad_()
    pose = camera.world_to_camera.clone().requires_grad_()
    background = BACKGROUND.clone().to(device).requires_grad_()
    out = render(leaves, camera.with_pose(pose), background=background)
    return out, {**dict(leaves.named()), "pose": pose, "background": background}
