"""Thresholds of the renderer, each with its unit, its reason and its source.

Settings of a task stand beside the task: `gaussians.fit.FitSettings`, `pipelines.remove.RemoveSettings`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal


@dataclass(frozen=True)
class Splatting:
    """Constants of projection and compositing. The defaults render as 3DGS does, but for `near`.

    Attributes:
        near: Nearest depth that is drawn [scene extents]. 3DGS uses 0.2 scene units, 0.04 of the extents of
            usual captures, and a small scene loses everything; gsplat and brush use 0.01 scene units.
        jacobian_margin: The EWA Jacobian is taken no further out than this many times the image's half
            extent [ratio]. Far outside the image the affine approximation would sweep over it. 3DGS: 1.3.
        low_pass: Added to both variances of a projected gaussian [px^2]. Keeps every splat at least about a
            pixel wide. 3DGS: 0.3.
        low_pass_antialiased: The same where opacity makes up for it: Mip-Splatting's 2D filter, 0.1, about
            the box of a pixel.
        sigma_depth: Sigma points of the unscented footprint come no nearer than this part of their centre's
            depth [ratio]. At 0 a gaussian that reaches the camera plane would cover every image.
        circle_radius: Radius of the "circle" extent [standard deviations]. 3DGS: 3.
        alpha_max: Largest opacity of one gaussian in one pixel. Keeps 1 - alpha away from zero, by which the
            adjoint divides. 3DGS: 0.99.
        alpha_min: Contributions below are skipped: an 8-bit image would not show them. 3DGS: 1/255.
        transmittance_min: A pixel is finished before the gaussian that would take its transmittance below
            this value; that gaussian is left out. 3DGS: 1e-4.
        quaternion_min: Smallest squared norm of a quaternion that still names a rotation. Real .ply files
            hold all-zero quaternions; normalising one gives 0/0. gsplat: 1e-8.
        variance_max: Largest variance of a projected gaussian [px^2]. Above it a splat is flat over any
            image and its determinant leaves the range of float32. brush: 1e18 on entries.
        coordinate_max: Coordinates of means, quaternions and cameras that are not below this are broken input
            [scene units]; their squares still fit into float32. NaN and infinity fail the same comparison.
        log_scale_max: Logarithms of scales beyond this, up or down, are broken input: e^40 = 2e17.
        logit_min: Opacity logits that are not above this, NaN among them, are culled before any arithmetic:
            the adjoint of e^-x would multiply zero by infinity. The opacity there, e^-80, is far below
            `alpha_min`.
        color_max: A gaussian whose harmonics' absolute values sum up to more is black. Trained ones stay
            below 100; rounding of 1e4 is 1e-3 in the gradient of what lies behind. brush clamps, too.
    """

    near: float = 0.01
    jacobian_margin: float = 1.3
    low_pass: float = 0.3
    low_pass_antialiased: float = 0.1
    sigma_depth: float = 0.5
    circle_radius: float = 3.0
    alpha_max: float = 0.99
    alpha_min: float = 1.0 / 255.0
    transmittance_min: float = 1e-4
    quaternion_min: float = 1e-8
    variance_max: float = 1e12
    coordinate_max: float = 1e15
    log_scale_max: float = 40.0
    logit_min: float = -80.0
    color_max: float = 1e4


SPLATTING = Splatting()

NO_EFFECT = {"affects": "nothing that is computed"}
"""Metadata of a settings field on which no result depends: a resumed run may have another value."""

TILE = 16
"""Side of a tile [px]. 16 is 3DGS's; smaller tiles list more pairs, larger ones blend more in vain."""

POSE_GROUP = 1024
"""Gaussians that share one row of the camera's gradient. Each group sums on one thread, and the rows are
added in order, so that the gradient does not depend on the number of threads."""


@dataclass(frozen=True)
class Accuracy:
    """Accuracy settings of the renderer; the presets are `DRAFT`, `STANDARD` (as 3DGS) and `EXACT`.

    A kernel is compiled for the values that it needs, so a knob costs nothing where it is not turned.
    `diga3d bench accuracy` measures the error and the time of each.

    Attributes:
        alpha_min: Contributions below are skipped, and boxes end where alpha falls below it. 3DGS: 1/255.
        transmittance_min: A pixel is finished before its transmittance falls below. 3DGS: 1e-4.
        exp_degree: Degree of the polynomial that stands for exp. At 5 its error, 7e-7, is that of float32.
        extent: Box of a splat: that of the ellipse on which alpha reaches `alpha_min`, or of 3DGS's circle
            of 3 standard deviations along the longer axis.
        footprint: Projected covariance: EWA's Jacobian at the centre, or the unscented transform, which
            follows perspective and lens over the whole gaussian.
        pixel_order: Sort by each pixel's own depths rather than by the depths of centres.
        precision: Floating-point type of all kernels.
        sampling: Reprojected pixels are points in the nearest pixel each, or a mesh that interpolates.
        supersampling: Samples of a reprojection per side of a target pixel.
    """

    alpha_min: float = 1.0 / 255.0
    transmittance_min: float = 1e-4
    exp_degree: int = 5
    extent: Literal["ellipse", "circle"] = "ellipse"
    footprint: Literal["affine", "unscented"] = "affine"
    pixel_order: bool = False
    precision: Literal["float32", "float64"] = "float32"
    sampling: Literal["nearest", "bilinear"] = "bilinear"
    supersampling: int = 1

    DRAFT: ClassVar[Accuracy]
    STANDARD: ClassVar[Accuracy]
    EXACT: ClassVar[Accuracy]


Accuracy.DRAFT = Accuracy(alpha_min=1.0 / 64.0, transmittance_min=1e-2, exp_degree=4, sampling="nearest")
Accuracy.STANDARD = Accuracy()
Accuracy.EXACT = Accuracy(
    alpha_min=1e-7, transmittance_min=1e-7, footprint="unscented", pixel_order=True, precision="float64"
)

ACCURACIES = {"draft": Accuracy.DRAFT, "standard": Accuracy.STANDARD, "exact": Accuracy.EXACT}
"""The presets by the names that `--accuracy` takes."""


@dataclass(frozen=True)
class Effects:
    """Effects to simulate; one that is off is not part of the compiled kernels.

    `plan_effects` chooses them from a scene and says why.

    Attributes:
        sh_degree: Highest degree of spherical harmonics, 0 to 3; all that the gaussians have if None.
        lens: Follow the camera's lens distortion inside the projection; off, cameras are pinholes.
        antialias: Scale opacity by what the low-pass widens a splat (Mip-Splatting's 2D filter).
        depth: Blend expected depth.
        median_depth: Find the depth at which half of the light is gone.
        normals: Blend normals of the gaussians' shortest axes.
        exposure: Fit an affine colour transform for each image.
        background: Blend a colour behind all gaussians.
        surround: Put a shell of gaussians behind the splat, over which it is fitted, so that no view looks
            into nothing (`gaussians.surround`). `render` does not read this.
        shadow: Take the shadow of an object out with it (`shadows`). `render` does not read this.
        mirror: Take the mirror image of an object in its support out with it (`mirrors`). `render` does not
            read this.
        pixel_order: As in `Accuracy`, for scenes whose large gaussians pop between views.
        deterministic: Sum the gradients of blending in a fixed order. Always so on CPU, where it is free; on
            CUDA it means one thread a tile instead of one a pixel and atomic sums.
    """

    sh_degree: int | None = None
    lens: bool = True
    antialias: bool = False
    depth: bool = True
    median_depth: bool = False
    normals: bool = False
    exposure: bool = False
    background: bool = True
    surround: bool = False
    shadow: bool = False
    mirror: bool = False
    pixel_order: bool = False
    deterministic: bool = False
