"""Every way of projecting, in float64 against the plain renderer, and what each is for."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

import oracle
from diga3d_warp.config import SPLATTING, Accuracy, Effects
from diga3d_warp.scene.camera import Camera, Distortion
from diga3d_warp.splatting.optics import optics_of
from diga3d_warp.splatting.project import Projection, project
from scenes import LENSES, camera_at, random_gaussians, single

FIELDS = ("means", "log_scales", "quaternions", "opacity_logits")
FOOTPRINTS = ("affine", "unscented")
DOUBLE = Accuracy(precision="float64", pixel_order=True)
SHARP = Effects(antialias=True)


def scene(count: int, lens: str):
    """Gaussians before and beside the camera, their leaves in float64 and a camera with leaves of its own."""
    gaussians, camera = random_gaussians(count, seed=1, degree=0), camera_at(lens)
    gaussians.means *= 2.0
    leaves = {name: getattr(gaussians, name).double().requires_grad_() for name in FIELDS}
    leaves["pose"] = camera.world_to_camera.clone().requires_grad_()
    leaves["intrinsics"] = camera.intrinsics.clone().requires_grad_()
    return leaves, camera


def projected(leaves: dict, camera: Camera, accuracy: Accuracy, effects: Effects) -> Projection:
    posed = camera.with_pose(leaves["pose"]).with_intrinsics(leaves["intrinsics"])
    return project(*(leaves[name] for name in FIELDS), posed, accuracy=accuracy, effects=effects)


def expected(leaves: dict, camera: Camera, **ways) -> oracle.Splats:
    posed = camera.with_intrinsics(leaves["intrinsics"])
    return oracle.project(*(leaves[name] for name in FIELDS), leaves["pose"], posed, **ways)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("footprint", FOOTPRINTS)
def test_values_and_gradients_agree_in_float64(footprint, lens):
    leaves, camera = scene(150, lens)
    found = projected(leaves, camera, replace(DOUBLE, footprint=footprint), SHARP)
    splats = expected(leaves, camera, footprint=footprint, antialias=True)
    rays = oracle.rays(leaves["means"], leaves["pose"])
    drawn = splats.drawn & (rays.norm(dim=1) < optics_of(camera).radius_max)
    assert (found.visible >= (drawn & splats.meets(camera, -1e-6))).all()
    assert (found.visible <= (drawn & splats.meets(camera, 0.5 + 1e-6))).all()
    assert 50 < found.visible.sum() < drawn.sum() < 150

    parts = [found.centers, found.depths, oracle.conics(found.factors), found.opacities, found.depth_slopes]
    truths = [splats.centers, splats.depths, splats.conics, splats.opacities, splats.slopes]
    tame = found.visible & (splats.depths > 0.3)  # numbers grow without bound next to the camera plane
    for part, truth in zip(parts, truths, strict=True):
        assert part.dtype == torch.float64
        torch.testing.assert_close(part[tame], truth[tame], rtol=1e-7, atol=1e-7)
    assert found.depth_slopes[tame].abs().max() > 0.01
    certain = tame[:, None]
    sums = [oracle.weighted_sum([part.view(150, 1, -1) for part in p], certain) for p in (parts, truths)]
    gradients = [torch.autograd.grad(total, list(leaves.values())) for total in sums]
    for name, mine, truth in zip(leaves, *gradients, strict=True):
        assert truth.abs().max() > 0.1
        assert (mine - truth).norm() / truth.norm() < 1e-6, name


WAYS = [
    *(("affine", lens, False) for lens in LENSES),
    *(("unscented", lens, True) for lens in LENSES),
    ("affine", "none", True),
    ("unscented", "none", False),
]
"""Every pair of footprint, lens and extras occurs; each way compiles four kernels, which takes seconds."""


@pytest.mark.parametrize(("footprint", "lens", "extras"), WAYS)
def test_side_by_side_in_float32_is_one_by_one_in_float64(footprint, lens, extras):
    """One is vector code and the other is not: what a compiler does wrong in one of them shows."""
    sums, gradients = [], []
    for precision in ("float32", "float64"):
        leaves, camera = scene(150, lens)
        accuracy = Accuracy(footprint=footprint, precision=precision, pixel_order=extras)
        splats = projected(leaves, camera, accuracy, Effects(antialias=extras))
        tame = splats.visible & (splats.depths > 0.3)
        parts = [part.double()[tame] for part in splats if part is not None]
        sums.append(parts)
        weights = torch.Generator().manual_seed(3)
        total = sum(
            (part * torch.rand(part.shape, generator=weights)).sum() for part in (*parts[:3], *parts[4:])
        )
        gradients.append(
            [gradient.double() for gradient in torch.autograd.grad(total, list(leaves.values()))]
        )
    assert len(sums[0]) == 5 + extras and len(sums[0][0]) > 50
    for mine, truth in zip(*sums, strict=True):
        assert (mine - truth).norm() < 1e-5 * truth.norm()
    for name, mine, truth in zip(leaves, *gradients, strict=True):
        assert truth.norm() > 0.1
        assert (mine - truth).norm() < 1e-4 * truth.norm(), name


@pytest.mark.parametrize("lens", ["none", "brown"])
@pytest.mark.parametrize("footprint", FOOTPRINTS)
def test_gradcheck(footprint, lens):
    """Against finite differences, with gaussians in the image and away from cut-offs."""
    leaves, camera = scene(40, lens)
    accuracy, effects = replace(DOUBLE, footprint=footprint), SHARP
    found = projected(leaves, camera, accuracy, effects)
    inside = found.visible & (found.opacities > 0.1) & (found.depths > 1.0)
    inside &= ((found.centers - 0.5) / torch.tensor([camera.width, camera.height]) - 0.5).abs().amax(1) < 0.45
    rows = torch.nonzero(inside)[:4, 0]
    assert len(rows) == 4
    chosen = [leaves[name].detach()[rows].requires_grad_() for name in FIELDS]
    names = list(leaves)

    def parts(*tensors):
        out = projected(dict(zip(names, tensors, strict=True)), camera, accuracy, effects)
        return out.centers, out.depths, out.factors, out.opacities, out.depth_slopes

    assert torch.autograd.gradcheck(
        parts, (*chosen, leaves["pose"], leaves["intrinsics"]), eps=1e-6, atol=1e-6, rtol=1e-5
    )


@pytest.mark.parametrize("lens", LENSES)
def test_sigma_points_agree_in_float32(lens, device):
    leaves, camera = scene(150, lens)
    floats = {name: leaf.detach().float().to(device) for name, leaf in leaves.items()}
    found = projected(floats, camera, Accuracy(footprint="unscented"), Effects())
    splats = expected(leaves, camera, footprint="unscented")
    tame = found.visible.cpu() & (splats.depths > 0.3)
    assert tame.sum() > 50
    torch.testing.assert_close(found.centers.cpu().double()[tame], splats.centers[tame], rtol=1e-5, atol=1e-4)
    torch.testing.assert_close(
        oracle.conics(found.factors).cpu().double()[tame], splats.conics[tame], rtol=1e-3, atol=1e-4
    )


def moments(p: np.ndarray, spread: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """True mean (2,) and covariance (2, 2) of the image of a gaussian in camera space, by quadrature."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(9)
    weights = weights / weights.sum()
    points = np.array(list(itertools.product(nodes, repeat=3))) @ spread.T + p
    mass = np.array([np.prod(w) for w in itertools.product(weights, repeat=3)])
    image = oracle.pixels(torch.tensor(points), camera).numpy()
    mean = mass @ image
    return mean, (image - mean).T @ ((image - mean) * mass[:, None])


@pytest.mark.parametrize("lens,factor", [("none", 0.4), ("fisheye", 0.6)])
def test_sigma_points_follow_perspective_and_lens_better_than_the_jacobian(lens, factor):
    """On large gaussians at the side of a wide image, nearer to the true moments by a factor."""
    camera = Camera(120, 90, 40.0, 40.0, 60.0, 45.0, torch.eye(4), LENSES[lens])
    errors: dict[str, list[float]] = {footprint: [] for footprint in FOOTPRINTS}
    random = torch.Generator().manual_seed(3)
    corner, size = torch.tensor([-2.0, -1.0, 2.0]), torch.tensor([4.0, 2.0, 1.0])
    for _ in range(20):
        place = corner + size * torch.rand(3, generator=random)
        gaussians = single(
            means=place.tolist(), log_scales=(-1.5 + 0.3 * torch.randn(3, generator=random)).tolist(),
            quaternions=torch.randn(4, generator=random).tolist(),
        )  # fmt: skip
        spread = oracle.rotations(gaussians.quaternions.double())[0] * gaussians.scales[0].double()
        mean, covariance = moments(place.numpy(), spread.numpy(), camera)
        for footprint in FOOTPRINTS:
            accuracy = replace(DOUBLE, footprint=footprint)
            tensors = (getattr(gaussians, name) for name in FIELDS)
            out = project(*tensors, camera, accuracy=accuracy, effects=SHARP)
            xx, xy, yy = oracle.conics(out.factors)[0].tolist()
            found = np.linalg.inv([[xx, xy], [xy, yy]]) - SPLATTING.low_pass_antialiased * np.eye(2)
            shape = np.linalg.norm(found - covariance) / np.linalg.norm(covariance)
            shift = np.linalg.norm(out.centers[0].numpy() - mean) / math.sqrt(covariance.trace())
            errors[footprint].append(shape + shift)
    assert np.median(errors["affine"]) > 0.02
    assert np.median(errors["unscented"]) < factor * np.median(errors["affine"])


def test_small_gaussians_have_the_same_footprint_either_way():
    leaves, camera = scene(60, "brown")
    leaves["log_scales"] = torch.full_like(leaves["log_scales"], -6.0)
    flat, curved = (
        projected(leaves, camera, replace(DOUBLE, footprint=footprint), SHARP) for footprint in FOOTPRINTS
    )
    near_axis = flat.depths > 1.0
    assert near_axis.sum() > 20
    torch.testing.assert_close(
        oracle.conics(curved.factors)[near_axis], oracle.conics(flat.factors)[near_axis], rtol=1e-3, atol=1e-5
    )


@pytest.mark.parametrize("log_scale", [0.5, 3.0, 7.0])
def test_a_gaussian_around_the_camera_has_finite_sigma_points(log_scale):
    """Its points would lie behind the camera; they stop at half the depth of its centre."""
    gaussians = single(means=[0.1, 0.05, 0.5], log_scales=[-3.0, -2.0, log_scale])
    leaves = [getattr(gaussians, name).requires_grad_() for name in FIELDS]
    camera = Camera(40, 30, 35.0, 35.0, 20.0, 15.0, torch.eye(4))
    out = project(*leaves, camera, accuracy=Accuracy(footprint="unscented"))
    assert out.extents[0, 0] > 0
    (out.centers.sum() + out.factors.sum()).backward()
    assert all(leaf.grad.isfinite().all() for leaf in leaves)
    truth = oracle.project(
        *(leaf.detach().double() for leaf in leaves), camera.world_to_camera, camera, footprint="unscented"
    )
    torch.testing.assert_close(oracle.conics(out.factors).double(), truth.conics, rtol=1e-4, atol=1e-7)
    # Without the stop the far ends would pass through the camera plane, where pixels are at infinity.
    assert out.centers.sub(torch.tensor([27.0, 18.5])).norm() < 10.0


def test_a_sigma_point_beyond_the_fold_of_a_lens_turns_its_axis_linear():
    lens = Distortion("brown", (-0.4, 0.0, 0.0, 0.0))  # folds at a radius of 0.91
    camera = Camera(40, 30, 40.0, 40.0, 20.0, 15.0, torch.eye(4), lens)
    wide = single(means=[0.3, 0.0, 1.0], log_scales=[0.0, -3.0, -3.0])
    tensors = [getattr(wide, name).double() for name in FIELDS]
    flat, curved = (
        project(*tensors, camera, accuracy=replace(DOUBLE, footprint=footprint), effects=SHARP)
        for footprint in FOOTPRINTS
    )
    assert flat.visible.all()
    torch.testing.assert_close(
        oracle.conics(curved.factors), oracle.conics(flat.factors), rtol=1e-2, atol=1e-4
    )
    truth = oracle.project(*tensors, camera.world_to_camera, camera, footprint="unscented", antialias=True)
    torch.testing.assert_close(oracle.conics(curved.factors), truth.conics, rtol=1e-6, atol=1e-9)


def test_the_circle_is_that_of_3dgs():
    leaves, camera = scene(150, "none")
    found = projected(leaves, camera, replace(DOUBLE, extent="circle"), Effects())
    splats = expected(leaves, camera)
    larger = torch.linalg.eigvalsh(splats.covariances)[:, 1]
    visible = found.visible
    assert visible.sum() > 50
    assert torch.equal(found.extents[:, 0], found.extents[:, 1])
    wide = visible & (larger > 4.0)  # 3DGS keeps the eigenvalues 0.6 px^2 apart; no matter for a wide one
    torch.testing.assert_close(found.extents[wide, 0], 3 * larger[wide].sqrt(), rtol=0.05, atol=0)
    assert (found.extents[visible, 0] > 2.99 * larger[visible].sqrt()).all()


def test_a_lower_alpha_min_reaches_farther_and_keeps_fainter_gaussians():
    gaussians, camera = single(opacity_logits=math.log(0.002)), camera_at()
    tensors = [getattr(gaussians, name) for name in FIELDS]
    assert project(*tensors, camera).extents[0, 0] == 0
    found = project(*tensors, camera, accuracy=Accuracy(precision="float64", alpha_min=1e-7))
    dx = found.extents[0, 0].double()
    conic = oracle.conics(found.factors)[0].double()
    along_x = conic[0] - conic[1] ** 2 / conic[2]  # smallest exponent on the box's side
    at_side = found.opacities[0].double() * torch.exp(-0.5 * along_x * dx**2)
    assert at_side.item() == pytest.approx(1e-7, rel=1e-3)


def test_antialiasing_keeps_the_light_of_a_splat_below_a_pixel():
    """Opacity times area stays that of the gaussian itself, however small; without, it stays a pixel's."""
    camera = Camera(64, 48, 50.0, 50.0, 32.0, 24.0, torch.eye(4))
    light = {}
    for antialias, log_scale in itertools.product((False, True), (-3.0, -5.0)):
        gaussians = single(means=[0.0, 0.0, 2.0], log_scales=[log_scale] * 3)
        tensors = [getattr(gaussians, name).double() for name in FIELDS]
        accuracy = Accuracy(precision="float64", alpha_min=1e-7)
        out = project(*tensors, camera, accuracy=accuracy, effects=Effects(antialias=antialias))
        xx, xy, yy = oracle.conics(out.factors)[0].tolist()
        light[antialias, log_scale] = out.opacities.item() / math.sqrt(xx * yy - xy * xy)
    shrunk = math.exp(-4.0)
    assert light[True, -5.0] / light[True, -3.0] == pytest.approx(shrunk, rel=1e-6)
    assert light[False, -5.0] / light[False, -3.0] > 5 * shrunk


def test_a_disc_seen_edge_on_vanishes_when_antialiased():
    """It has no area, and the slope of its opacity would be infinite."""
    camera = Camera(40, 30, 35.0, 35.0, 20.0, 15.0, torch.eye(4))
    for thin in (-39.0, -12.0):
        disc = single(means=[0.0, 0.0, 2.0], log_scales=[-1.0, thin, -1.0])
        leaves = [getattr(disc, name).requires_grad_() for name in FIELDS]
        assert project(*leaves, camera).extents[0, 0] > 0
        out = project(*leaves, camera, effects=SHARP)
        (out.opacities.sum() + out.factors.sum()).backward()
        assert not out.extents.any() and not out.opacities.any()
        assert not any(leaf.grad.any() for leaf in leaves)


def test_slopes_are_of_the_depth_where_a_gaussian_answers_most():
    """Along the ray of a pixel beside its centre, the 3D gaussian is densest at the depth that they say."""
    gaussians = single(means=[0.0, 0.0, 4.0], log_scales=[-1.0, -2.0, -4.0], quaternions=[0.9, 0.2, 0.3, 0.1])
    camera = Camera(4000, 3000, 4000.0, 4000.0, 2000.0, 1500.0, torch.eye(4))  # the low-pass is negligible
    out = project(*(getattr(gaussians, name) for name in FIELDS), camera, accuracy=DOUBLE, effects=SHARP)
    offset = torch.tensor([6.0, -9.0], dtype=torch.float64)  # pixels; small, so that the ray is affine
    rotation = oracle.rotations(gaussians.quaternions.double())[0]
    spread = rotation * gaussians.scales[0].double()
    precision = torch.linalg.inv(spread @ spread.T)
    ray = torch.cat([offset / 4000.0, torch.ones(1, dtype=torch.float64)])
    mean = gaussians.means[0].double()
    densest = (ray @ precision @ mean) / (ray @ precision @ ray)
    assert (densest - 4.0).abs() > 0.004
    claimed = out.depths[0] + out.depth_slopes[0] @ offset
    assert claimed.item() - 4.0 == pytest.approx(densest.item() - 4.0, rel=0.02)
