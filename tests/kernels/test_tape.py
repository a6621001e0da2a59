"""Operations recorded on a `wp.Tape` give the bits of the torch operations, forward and backward."""

import numpy as np
import pytest
import torch
import warp as wp

from diga3d_warp.config import Accuracy, Effects
from diga3d_warp.kernels import tape as taped
from diga3d_warp.kernels.blending import Blending
from diga3d_warp.splatting.arrays import warp_array
from diga3d_warp.splatting.composite import composite
from diga3d_warp.splatting.normals import orient
from diga3d_warp.splatting.optics import optics_of
from diga3d_warp.splatting.project import Projection, project
from diga3d_warp.splatting.reproject import motion_between, reproject
from diga3d_warp.splatting.shade import shade
from diga3d_warp.splatting.ssim import ssim
from scenes import camera_at, random_gaussians

WIDTH, HEIGHT = 37, 29
KINDS = {
    "means": wp.vec3,
    "log_scales": wp.vec3,
    "quaternions": wp.vec4,
    "opacity_logits": float,
    "sh": wp.vec3,
}


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


def leaf(tensor: torch.Tensor, dtype) -> wp.array:
    """A Warp array with a gradient of its own."""
    return wp.array(tensor.numpy(), dtype=dtype, device="cpu", requires_grad=True)


def equal(array: wp.array, tensor: torch.Tensor) -> bool:
    return np.array_equal(array.numpy().ravel(), tensor.detach().numpy().ravel())


@pytest.fixture(scope="module")
def by_torch():
    """A rendering compared with a photograph, through torch: outputs and leaves after backward."""
    camera = camera_at("brown", WIDTH, HEIGHT)
    leaves = random_gaussians(100).requires_grad_()
    pose = camera.world_to_camera.clone().requires_grad_()
    intrinsics = camera.intrinsics.clone().requires_grad_()
    camera = camera.with_pose(pose).with_intrinsics(intrinsics)
    projection = project(leaves.means, leaves.log_scales, leaves.quaternions, leaves.opacity_logits, camera)
    colors = shade(leaves.means, leaves.sh, projection.extents, camera, 3)
    normals = random(100, 3, seed=4).requires_grad_()
    image = composite(projection, colors, WIDTH, HEIGHT, normals=normals, median_depth=True)
    likeness = ssim(image.color, random(HEIGHT, WIDTH, 3), reduce=False)
    loss = (likeness * random(HEIGHT, WIDTH, 3, seed=1)).sum()
    loss = loss + (image.depth_sum * random(HEIGHT, WIDTH, seed=2)).sum()
    loss = loss + (image.transmittance * random(HEIGHT, WIDTH, seed=3)).sum()
    loss = loss + (image.normal_sum * random(HEIGHT, WIDTH, 3, seed=5)).sum()
    (loss + (image.median_depth * random(HEIGHT, WIDTH, seed=6)).sum()).backward()
    return (
        image,
        likeness,
        {**dict(leaves.named()), "pose": pose, "intrinsics": intrinsics, "normals": normals},
    )


def by_tape():
    """The same through a tape; outputs, leaves and a function that runs backward."""
    camera = camera_at("brown", WIDTH, HEIGHT)
    optics = optics_of(camera)
    leaves = {name: leaf(tensor, KINDS[name]) for name, tensor in random_gaussians(100).named()}
    pose = camera.world_to_camera
    leaves["poses"] = leaf(pose[None].float(), wp.mat44)
    leaves["eyes"] = leaf(-(pose[:3, :3].T @ pose[:3, 3:]).T.float(), wp.vec3)
    leaves["intrinsics"] = leaf(camera.intrinsics[None].float(), wp.vec4)
    leaves["normals"] = leaf(random(100, 3, seed=4), wp.vec3)
    target = warp_array(random(HEIGHT, WIDTH, 3).view(-1, 3), wp.vec3)
    with wp.Tape() as tape:
        parameters = [leaves[name] for name in ("means", "log_scales", "quaternions", "opacity_logits")]
        splats = taped.project(tape, optics, *parameters, leaves["poses"], leaves["intrinsics"])
        colors = taped.shade(tape, 3, leaves["means"], leaves["sh"], leaves["eyes"], splats.extents)
        outputs = taped.composite(
            tape, splats, colors, WIDTH, HEIGHT,
            blending=Blending(normals=True, median=True), normals=leaves["normals"],
        )  # fmt: skip
        likeness = taped.ssim(tape, outputs[0], target, WIDTH, HEIGHT)
    weights = {
        likeness: warp_array(random(HEIGHT, WIDTH, 3, seed=1).view(-1, 3), wp.vec3),
        outputs[1]: warp_array(random(HEIGHT, WIDTH, seed=2).view(-1), wp.float32),
        outputs[2]: warp_array(random(HEIGHT, WIDTH, seed=3).view(-1), wp.float32),
        outputs[3]: warp_array(random(HEIGHT, WIDTH, 3, seed=5).view(-1, 3), wp.vec3),
        outputs[4]: warp_array(random(HEIGHT, WIDTH, seed=6).view(-1), wp.float32),
    }
    return outputs, likeness, leaves, lambda: tape.backward(grads=weights), tape


def test_the_renderer_gives_the_bits_of_torch(by_torch):
    image, likeness, leaves = by_torch
    outputs, taped_likeness, taped_leaves, backward, _ = by_tape()
    assert image.transmittance.min() < 0.01
    assert all(equal(array, tensor) for array, tensor in zip(outputs, image, strict=True))
    assert equal(taped_likeness, likeness)
    backward()
    for name in (*KINDS, "intrinsics", "normals"):
        assert leaves[name].grad.abs().max() > 0.01
        assert equal(taped_leaves[name].grad, leaves[name].grad), name


def test_the_pose_gets_its_gradient_from_projection_and_from_shading(by_torch):
    *_, leaves = by_torch
    *_, taped_leaves, backward, _ = by_tape()
    backward()
    pose = camera_at("brown", WIDTH, HEIGHT).world_to_camera.clone().requires_grad_()
    eye = -(pose[:3, :3].T @ pose[:3, 3])
    eye.backward(torch.tensor(taped_leaves["eyes"].grad.numpy()[0], dtype=torch.float64))
    total = pose.grad + torch.tensor(taped_leaves["poses"].grad.numpy()[0])
    torch.testing.assert_close(total, leaves["pose"].grad, rtol=1e-6, atol=1e-6)


def test_gradients_add_up_and_can_be_cleared():
    *_, leaves, backward, tape = by_tape()
    backward()
    once = {name: array.grad.numpy().copy() for name, array in leaves.items()}
    backward()
    for name, array in leaves.items():
        np.testing.assert_allclose(array.grad.numpy(), 2 * once[name], rtol=1e-5, atol=1e-4)
    tape.zero()
    assert not any(array.grad.numpy().any() for array in leaves.values())


def test_double_precision_and_normals_give_the_bits_of_torch():
    """Sigma points, slopes of depth, anti-aliasing and intrinsics, all in float64, forward and backward."""
    accuracy = Accuracy(footprint="unscented", precision="float64", pixel_order=True)
    effects = Effects(antialias=True)
    camera = camera_at("brown", WIDTH, HEIGHT)
    optics = optics_of(camera)
    gaussians = random_gaussians(100)
    tensors = {name: tensor.double().requires_grad_() for name, tensor in gaussians.named()}
    *parameters, sh = tensors.values()
    pose = camera.world_to_camera.clone().requires_grad_()
    intrinsics = camera.intrinsics.clone().requires_grad_()
    posed = camera.with_pose(pose).with_intrinsics(intrinsics)
    found = project(*parameters, posed, accuracy=accuracy, effects=effects)
    normals = orient(*parameters[:3], found.extents, posed)
    colors = shade(parameters[0], sh, found.extents, posed, 3)
    parts = [found.centers, found.factors, found.opacities, found.depth_slopes, normals, colors]
    sum(part.sum() for part in parts).backward()

    kinds = [wp.vec3d, wp.vec3d, wp.vec4d, wp.float64, wp.vec3d, wp.mat44d, wp.vec4d, wp.vec3d]
    fixed = camera.world_to_camera
    rows = [fixed[None], camera.intrinsics[None], -(fixed[:3, :3].T @ fixed[:3, 3:]).T]
    values = [*(tensor.detach() for tensor in tensors.values()), *rows]
    arrays = [leaf(value, kind) for value, kind in zip(values, kinds, strict=True)]
    means, log_scales, quaternions, logits, coefficients, poses, focal, eyes = arrays
    with wp.Tape() as tape:
        splats = taped.project(
            tape, optics, means, log_scales, quaternions, logits, poses, focal,
            accuracy=accuracy, effects=effects,
        )  # fmt: skip
        facing = taped.orient(tape, means, log_scales, quaternions, poses, splats.extents)
        lit = taped.shade(tape, 3, means, coefficients, eyes, splats.extents)
    outputs = [splats.centers, splats.factors, splats.opacities, splats.depth_slopes, facing, lit]
    for array, tensor in zip(outputs, parts, strict=True):
        np.testing.assert_allclose(array.numpy(), tensor.detach().numpy(), rtol=1e-7)  # the lens is rounded
    tape.backward(grads={array: wp.ones_like(array) for array in outputs})
    for array, tensor in zip(arrays[:5], tensors.values(), strict=True):
        assert tensor.grad.abs().max() > 0.01
        np.testing.assert_allclose(array.grad.numpy(), tensor.grad.numpy(), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(focal.grad.numpy()[0], intrinsics.grad.numpy(), rtol=1e-6)


@pytest.mark.parametrize("sampling", ["bilinear", "nearest"])
def test_reprojection_gives_the_bits_of_torch(sampling):
    source = camera_at(width=WIDTH, height=HEIGHT)
    pose = source.world_to_camera.clone()
    pose[0, 3] += 0.1
    target = source.with_pose(pose)
    image, depth = random(HEIGHT, WIDTH, 3), 2.0 + 0.1 * random(HEIGHT, WIDTH, seed=1)
    weights = random(HEIGHT, WIDTH, 3, seed=2)

    tensors = [image.clone().requires_grad_(), depth.clone().requires_grad_()]
    carried = reproject(*tensors, source, target, accuracy=Accuracy(sampling=sampling))
    assert carried.visible.float().mean() > 0.5
    (carried.image * weights).sum().backward()

    arrays = [leaf(image.view(-1, 3), wp.vec3), leaf(depth.view(-1), wp.float32)]
    with wp.Tape() as tape:
        outputs = taped.reproject(
            tape, *arrays, motion_between(source, target, torch.device("cpu")), sampling=sampling
        )
    assert all(equal(array, tensor) for array, tensor in zip(outputs, carried, strict=True))
    tape.backward(grads={outputs[0]: warp_array(weights.view(-1, 3), wp.vec3)})
    assert all(equal(array.grad, tensor.grad) for array, tensor in zip(arrays, tensors, strict=True))


def test_inputs_without_a_gradient_are_welcome():
    image, target = (
        wp.array(random(HEIGHT * WIDTH, 3, seed=seed).numpy(), dtype=wp.vec3, device="cpu") for seed in (0, 1)
    )
    with wp.Tape() as tape:
        likeness = taped.ssim(tape, image, target, WIDTH, HEIGHT)
    tape.backward(grads={likeness: wp.ones_like(likeness)})
    assert image.grad is None


def test_recorded_kernels_and_recorded_operations_share_a_tape():
    """A caller's own kernel before and after: gradients pass through all three."""
    leaves = leaf(0.2 + 0.5 * random(HEIGHT * WIDTH, 3), wp.vec3)
    target = warp_array(random(HEIGHT * WIDTH, 3, seed=1), wp.vec3)
    loss = wp.zeros(1, dtype=float, device="cpu", requires_grad=True)
    with wp.Tape() as tape:
        bright = wp.empty_like(leaves, requires_grad=True)
        wp.launch(double, leaves.size, inputs=[leaves], outputs=[bright], device="cpu")
        likeness = taped.ssim(tape, bright, target, WIDTH, HEIGHT)
        wp.launch(total, likeness.size, inputs=[likeness], outputs=[loss], device="cpu")
    tape.backward(loss)

    tensor = torch.tensor(leaves.numpy(), requires_grad=True)
    expected = ssim(2 * tensor.view(HEIGHT, WIDTH, 3), torch.tensor(target.numpy()).view(HEIGHT, WIDTH, 3))
    (expected * tensor.numel()).backward()
    assert tensor.grad.abs().max() > 0.01
    np.testing.assert_allclose(leaves.grad.numpy(), tensor.grad.numpy(), rtol=1e-5, atol=1e-6)


@wp.kernel
def double(values: wp.array(dtype=wp.vec3), doubled: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    doubled[i] = 2.0 * values[i]


@wp.kernel
def total(values: wp.array(dtype=wp.vec3), loss: wp.array(dtype=float)):
    i = wp.tid()
    wp.atomic_add(loss, 0, values[i][0] + values[i][1] + values[i][2])


def test_a_pixels_own_order_gives_the_bits_of_torch():
    """Splats without a projection before them, their slopes of depth among them."""
    tensors = [
        WIDTH * random(60, 2, seed=1), 1 + random(60, seed=2),
        torch.tensor([[0.02, 0.005, 0.03]]).repeat(60, 1), torch.full((60, 2), 20.0),
        0.1 + 0.8 * random(60, seed=3), random(60, 2, seed=4) - 0.5,
    ]  # fmt: skip
    colors = random(60, 3, seed=5)
    kinds = (wp.vec2, float, wp.vec3, wp.vec2, float, wp.vec2)
    splats = taped.Splats(*(leaf(tensor, kind) for tensor, kind in zip(tensors, kinds, strict=True)))
    taped_colors = leaf(colors, wp.vec3)
    with wp.Tape() as tape:
        images = taped.composite(
            tape, splats, taped_colors, WIDTH, HEIGHT, blending=Blending(pixel_order=True)
        )
    weights = random(HEIGHT, WIDTH, 3, seed=6)
    tape.backward(grads={images.color: warp_array(weights.view(-1, 3), wp.vec3)})

    leaves = [tensor.clone().requires_grad_() for tensor in (*tensors, colors)]
    image = composite(Projection(*leaves[:6]), leaves[6], WIDTH, HEIGHT, effects=Effects(pixel_order=True))
    (image.color * weights).sum().backward()
    assert image.transmittance.min() < 0.01
    assert equal(images.color, image.color)
    for found, wanted in zip((*splats, taped_colors), leaves, strict=True):
        if wanted.grad is not None:
            assert equal(found.grad, wanted.grad)
    assert leaves[0].grad.abs().max() > 0.01


def test_normals_without_a_place_for_them_are_an_error():
    splats = taped.Splats(
        *(wp.zeros(1, dtype=kind, device="cpu") for kind in (wp.vec2, float, wp.vec3, wp.vec2, float))
    )
    colors = wp.zeros(1, dtype=wp.vec3, device="cpu")
    with pytest.raises(ValueError, match="give both or neither"), wp.Tape() as tape:
        taped.composite(tape, splats, colors, 4, 4, normals=colors)
