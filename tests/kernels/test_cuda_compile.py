"""Every kernel of the renderer compiles for a Hopper GPU, on a machine without one: NVRTC needs no driver."""

from pathlib import Path

import pytest
import warp as wp

from diga3d_warp.kernels import (
    adam,
    attribution,
    blending,
    cameras,
    compositing,
    compositing_adjoint,
    gaussian_lanes,
    gradient_rows,
    harmonics,
    keyed_pairs,
    mesh,
    normals,
    ordering,
    patches,
    pixel_lanes,
    points,
    projection,
    raycast,
    reprojection,
    ssim,
    texturing,
    walk,
)
from diga3d_warp.kernels.footprint import Projecting

PIXELS = pixel_lanes.CUDA_LANES
GAUSSIANS = gaussian_lanes.CUDA_LANES
PLAIN = blending.Blending()
FULL = blending.Blending(1e-7, 0.0, 8, precision="float64", boxed=True, normals=True, median=True)
KERNELS = {
    "adam": lambda: adam.step_kernel(48),
    "pixel_rays": lambda: cameras.pixel_rays_kernel("fisheye"),
    "project": lambda: projection.projection_kernel(Projecting("brown"), GAUSSIANS),
    "project_adjoint": lambda: projection.adjoint_kernel(Projecting("brown"), GAUSSIANS),
    "shade": lambda: harmonics.harmonics_kernel(3, GAUSSIANS),
    "shade_adjoint": lambda: harmonics.adjoint_kernel(3, GAUSSIANS),
    "orient": lambda: normals.normals_kernel(GAUSSIANS),
    "orient_adjoint": lambda: normals.adjoint_kernel(GAUSSIANS),
    "binning": lambda: keyed_pairs.emit_pairs,
    "composite": lambda: compositing.forward_kernel(PLAIN, PIXELS),
    "composite_full": lambda: compositing.forward_kernel(FULL, PIXELS),
    "composite_adjoint": lambda: compositing_adjoint.adjoint_kernel(PLAIN, PIXELS),
    "composite_adjoint_full": lambda: compositing_adjoint.adjoint_kernel(FULL, PIXELS),
    "composite_deterministic": lambda: compositing.forward_kernel(PLAIN, pixel_lanes.CPU_LANES),
    "composite_adjoint_deterministic": lambda: compositing_adjoint.adjoint_kernel(
        PLAIN, pixel_lanes.CPU_LANES
    ),
    "ordered": lambda: ordering.ordered_kernel(PLAIN),
    "ordered_full": lambda: ordering.ordered_kernel(FULL),
    "ordered_adjoint": lambda: ordering.ordered_adjoint_kernel(PLAIN, 1),
    "ordered_adjoint_full": lambda: ordering.ordered_adjoint_kernel(FULL, 1),
    "attribute": lambda: attribution.attribution_kernel(PLAIN, PIXELS, 3, True),
    "attribute_full": lambda: attribution.attribution_kernel(FULL, PIXELS, 1, False),
    "attribute_ordered": lambda: attribution.ordered_attribution_kernel(PLAIN, 1, 3, True),
    "attribute_ordered_full": lambda: attribution.ordered_attribution_kernel(FULL, 1, 0, True),
    "add_shares": lambda: attribution.share_kernel(PLAIN),
    "gather_gradients": lambda: gradient_rows.gather_kernel(PLAIN),
    "gather_gradients_full": lambda: gradient_rows.gather_kernel(FULL),
    "similarity": lambda: ssim.similarity_kernel(ssim.CUDA_RUN),
    "similarity_adjoint": lambda: ssim.adjoint_kernel(ssim.CUDA_RUN),
    "positions": lambda: reprojection.position_kernel("none"),
    "steps": lambda: reprojection.steps_kernel(),
    "draw_triangles": lambda: mesh.draw_triangles,
    "draw_points": lambda: points.draw_each_point,
    "pick": lambda: points.pick_kernel(),
    "resolve": lambda: mesh.resolve_kernel(),
    "patch_search": lambda: patches.search_kernel(patches.PatchForm(channels=4)),
    "patch_vote": lambda: patches.vote_kernel(patches.PatchForm(channels=4)),
    "raycast": lambda: raycast.nearest_hit_kernel,
    "texturing": lambda: texturing.hit_colors_kernel,
    "walk": lambda: walk.walk_faint,
}


@pytest.mark.parametrize("name", KERNELS)
def test_compiles_to_ptx(name, tmp_path: Path):
    kernel = KERNELS[name]()
    wp.compile_aot_module(kernel.module, device=[], arch=90, module_dir=tmp_path, use_ptx=True)
    (ptx,) = tmp_path.glob("*.ptx")
    source = ptx.read_text()
    assert ".target sm_90" in source
    assert f".entry {kernel.key}" in source


def test_gradients_that_pixels_share_are_added_atomically(tmp_path: Path):
    wp.compile_aot_module(
        compositing_adjoint.adjoint_kernel(PLAIN, PIXELS).module,
        device=[],
        arch=90,
        module_dir=tmp_path,
        use_ptx=True,
    )
    (ptx,) = tmp_path.glob("*.ptx")
    assert ".global.add.f32" in ptx.read_text()
