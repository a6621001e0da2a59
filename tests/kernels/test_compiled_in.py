"""What is off is not in a kernel's code; what is on compiles for a GPU, on a machine without one."""

from dataclasses import replace

import pytest

from diga3d_warp.kernels import harmonics, projection
from diga3d_warp.kernels.footprint import Projecting
from diga3d_warp.kernels.gaussian_lanes import CUDA_LANES
from diga3d_warp.kernels.normals import normals_kernel

PLAIN = Projecting()
EXTRAS = {
    "lens": (replace(PLAIN, lens_kind="fisheye"), "wp::atan("),
    "k3": (replace(PLAIN, lens_kind="brown5"), "wp::vec_t<5, wp::float32>"),
    "slopes": (replace(PLAIN, slopes=True), "(var_depth_slopes,"),
    "unscented": (replace(PLAIN, footprint="unscented"), "wp::outer("),
    "antialias": (replace(PLAIN, antialias=True), f"{PLAIN.alpha_min**2}"),
    "float64": (replace(PLAIN, precision="float64"), "wp::float64"),
}
"""Ways of projecting, each with a piece of code that it alone needs."""


def projection_kernel(kind: Projecting):
    return projection.projection_kernel(kind, CUDA_LANES)


@pytest.mark.parametrize("name", EXTRAS)
def test_a_projection_holds_only_what_is_asked_for(name, cuda_code):
    kind, piece = EXTRAS[name]
    assert piece in cuda_code(projection_kernel(kind))
    others = [PLAIN, *(other for key, (other, _) in EXTRAS.items() if key != name)]
    for other in others:
        assert piece not in cuda_code(projection_kernel(other)), other


def test_a_circle_needs_no_reach_of_the_ellipse(cuda_code):
    circle = cuda_code(projection_kernel(replace(PLAIN, extent="circle")))
    assert "bits_of" not in circle and "bits_of" in cuda_code(projection_kernel(PLAIN))


def test_all_at_once_compiles(cuda_code):
    kind = Projecting(
        "brown", extent="circle", footprint="unscented", precision="float64", antialias=True, slopes=True
    )
    plain = replace(PLAIN, precision="float64")
    assert len(cuda_code(projection_kernel(kind))) > len(cuda_code(projection_kernel(plain)))
    assert "wp::float64" in cuda_code(normals_kernel(CUDA_LANES, "float64"))


@pytest.mark.parametrize("kernel_of", [harmonics.harmonics_kernel, harmonics.adjoint_kernel])
def test_harmonics_hold_only_the_terms_of_their_degree(kernel_of, cuda_code):
    """Each degree has a constant that no lower one needs."""
    codes = [cuda_code(kernel_of(degree, CUDA_LANES, "float64")) for degree in range(4)]
    for least, constant in enumerate((harmonics.C0, harmonics.C1, harmonics.C2[2], harmonics.C3[1])):
        assert [str(constant) in code for code in codes] == [degree >= least for degree in range(4)]
    assert "wp::sqrt(" not in codes[0] and "wp::sqrt(" in codes[1]
