"""A camera's lens in COLMAP's terms."""

from __future__ import annotations

from diga3d_warp.scene.camera import Camera


def colmap_lens(camera: Camera) -> tuple[str, list[float]]:
    """COLMAP's name and parameters of a camera's lens: PINHOLE, OPENCV, FULL_OPENCV or OPENCV_FISHEYE."""
    focal_and_center = [camera.fx, camera.fy, camera.cx, camera.cy]
    lens = camera.distortion
    if lens is None:
        return "PINHOLE", focal_and_center
    if lens.kind == "brown5":
        return "FULL_OPENCV", [*focal_and_center, *lens.coefficients, 0.0, 0.0, 0.0]
    model = "OPENCV" if lens.kind == "brown" else "OPENCV_FISHEYE"
    return model, [*focal_and_center, *lens.coefficients]
