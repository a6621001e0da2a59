"""The plain kernel and the fast ones draw the same image and the same gradients."""

import torch
import warp as wp

from diga3d_warp.bench.garden import DEGREE, Garden, project_into
from diga3d_warp.kernels import plain
from diga3d_warp.splatting.arrays import vector_arrays
from diga3d_warp.splatting.composite import bin_projection, composite
from diga3d_warp.splatting.shade import shade

NAMES = ("centers", "factors", "opacities")


def test_fast_kernels_agree_with_the_plain_one():
    garden = Garden(count=3000, width=101, height=67)
    gaussians, camera = garden.gaussians(), garden.camera
    projection = project_into(gaussians, camera)
    colors = shade(gaussians.means, gaussians.sh, projection.extents, camera, DEGREE).requires_grad_()
    leaves = {name: getattr(projection, name).detach().requires_grad_() for name in NAMES}
    blended = composite(projection._replace(**leaves), colors, camera.width, camera.height)
    random = torch.Generator().manual_seed(1)
    adj_color = torch.randn(blended.color.shape, generator=random)
    adj_transmittance = torch.randn(blended.transmittance.shape, generator=random)
    torch.autograd.backward([blended.color, blended.transmittance], [adj_color, adj_transmittance])

    bins, pixels = bin_projection(projection, camera.width, camera.height), camera.width * camera.height
    leaves["colors"] = colors
    splats = plain.Blended(*vector_arrays(list(leaves.values())))
    image = plain.Image(*(wp.zeros(pixels, dtype=dtype, device="cpu") for dtype in (wp.vec3, float)))
    plain.composite(bins, camera.width, camera.height, splats, image)
    color, transmittance = (torch.from_numpy(array.numpy()) for array in image)
    torch.testing.assert_close(blended.color.view(-1, 3), color, atol=1e-5, rtol=0)
    torch.testing.assert_close(blended.transmittance.view(-1), transmittance, atol=1e-5, rtol=0)
    assert 0.0 < transmittance.min() < 2e-4
    assert transmittance.max() > 0.01

    adj_splats = plain.Blended(*map(wp.zeros_like, splats))
    adj_image = plain.Image(*vector_arrays([adj_color.view(-1, 3), adj_transmittance.view(-1)]))
    plain.composite_adjoint(bins, camera.width, camera.height, splats, image, adj_image, adj_splats)
    for (name, leaf), plain_gradient in zip(leaves.items(), adj_splats, strict=True):
        expected = torch.from_numpy(plain_gradient.numpy())
        error = (leaf.grad - expected).norm() / expected.norm()
        assert error < 1e-4, f"{name}: {error}"
