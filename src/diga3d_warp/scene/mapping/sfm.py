"""Structure from motion through pycolmap: points where poses are known, poses where only images are.

The same photographs give the same bytes, on any number of threads: images are numbered by name, features are
found in each image alone, matches are exact (`matching`), every random search has a seed, points are added in
one thread, and they come out in the order of the features of which they were made.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.process import load_pycolmap
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.colmap.models import camera_from_model
from diga3d_warp.scene.colmap.reconstruction import posed_reconstruction
from diga3d_warp.scene.mapping import matching
from diga3d_warp.scene.photographs.images import resize_image
from diga3d_warp.scene.scene import Points

if TYPE_CHECKING:
    import pycolmap


@dataclass(frozen=True)
class MatchingBudget:
    """What bounds the time of feature extraction and matching on a CPU.

    Attributes:
        longest_side: Images are shrunk to this before features are found [px]. A 504 x 378 image yields
            some 2,000 features, ample for a start of a splat.
        features: Most features an image; half of COLMAP's 8192, as the images are small.
        neighbours: Images with known poses are matched with this many nearest ones, by place and direction.
        exhaustive: Up to this many images without poses are matched each with each; more are taken for a
            film and matched with those next in name.
        seed: Of the random samples in geometric verification and mapping.
    """

    longest_side: int = 640
    features: int = 4096
    neighbours: int = 12
    exhaustive: int = 60
    seed: int = 0


BUDGET = MatchingBudget()
_SUFFIX = ".png"


def triangulate(images: Mapping[str, np.ndarray], cameras: Mapping[str, Camera], progress: bool) -> Points:
    """Triangulate points from photographs with known poses.

    Args:
        images: uint8 RGB, each (H, W, 3), by image key.
        cameras: Camera of each image at the size of its pixels, by the same keys.
        progress: Say on the terminal what is going on.

    Returns:
        Points in the frame of the poses; none if no features matched.
    """
    pycolmap = load_pycolmap()

    _tell(f"triangulating points from {len(images)} images with known poses", progress)
    with _workspace(images) as (folder, database):
        sized = {}
        for key, camera in cameras.items():
            height, width = shrink(images[key]).shape[:2]
            sized[key + _SUFFIX] = camera.resized(width, height)
        reconstruction = posed_reconstruction(sized)
        with pycolmap.Database.open(database) as tables:
            for camera in reconstruction.cameras.values():
                tables.write_camera(camera, use_camera_id=True)
            for rig in reconstruction.rigs.values():
                tables.write_rig(rig, use_rig_id=True)
            for frame in reconstruction.frames.values():
                tables.write_frame(frame, use_frame_id=True)
            for image in reconstruction.images.values():
                tables.write_image(image, use_image_id=True)
        pycolmap.extract_features(database, folder / "images", extraction_options=_extraction())
        _match(folder, database, _neighbours(sized))
        output = folder / "points"
        output.mkdir()
        found = pycolmap.triangulate_points(
            reconstruction, database, folder / "images", output, options=_mapping()
        )
        return _points(found)


def map_images(images: Mapping[str, np.ndarray], progress: bool) -> tuple[dict[str, Camera], Points]:
    """Recover cameras and points from photographs alone, with COLMAP's incremental mapper.

    Args:
        images: uint8 RGB, each (H, W, 3), by image key. If all have one size, one camera took them all.
        progress: Say on the terminal what is going on.

    Returns:
        Camera of each image that was registered, at the size of its pixels, and the points.

    Raises:
        InputError: the images could not be registered.
    """
    pycolmap = load_pycolmap()

    _tell(f"recovering the poses of {len(images)} images: this takes minutes", progress)
    with _workspace(images) as (folder, database):
        one_size = len({pixels.shape for pixels in images.values()}) == 1
        mode = pycolmap.CameraMode.SINGLE if one_size else pycolmap.CameraMode.PER_IMAGE
        # Imported beforehand, images are numbered by name; numbered as their features get ready, no two runs
        # agree.
        pycolmap.import_images(database, folder / "images", camera_mode=mode)
        pycolmap.extract_features(database, folder / "images", extraction_options=_extraction())
        names = sorted(key + _SUFFIX for key in images)
        few = len(names) <= BUDGET.exhaustive
        _match(folder, database, matching.all_pairs(names) if few else matching.film_pairs(names))
        output = folder / "models"
        output.mkdir()
        options = _mapping()
        # Distortion found while the first few images are registered runs away (k = 4.8 was seen on 8 views
        # of a lawn), so it is refined once all are in place.
        options.ba_refine_extra_params = False
        models = pycolmap.incremental_mapping(database, folder / "images", output, options=options)
        best = max(models.values(), key=lambda model: model.num_reg_images(), default=None)
        if best is None or best.num_reg_images() < 2:
            raise InputError(
                f"the poses of {len(images)} images could not be recovered: they share too few features; "
                "take more overlapping photographs, or give a COLMAP reconstruction"
            )
        _refine(best)
        cameras = {}
        for image in best.images.values():
            if not image.has_pose:
                continue
            lens, key = best.cameras[image.camera_id], image.name.removesuffix(_SUFFIX)
            camera = camera_from_model(lens.model.name, lens.width, lens.height, lens.params.tolist())
            pose = np.eye(4)
            pose[:3] = image.cam_from_world().matrix()
            height, width = images[key].shape[:2]
            cameras[key] = camera.with_pose(pose).resized(width, height)
        return cameras, _points(best)


def _tell(line: str, progress: bool) -> None:
    if progress:
        print(line, file=sys.stderr, flush=True)


def shrink(pixels: np.ndarray) -> np.ndarray:
    """The image at the size at which features are looked for, uint8 RGB (H, W, 3)."""
    return resize_image(pixels, min(1.0, BUDGET.longest_side / max(pixels.shape[:2])))


@contextmanager
def _workspace(images: Mapping[str, np.ndarray]) -> Iterator[tuple[Path, Path]]:
    """A temporary folder with small copies of the images, and the path of a database in it.

    COLMAP's log is silent below errors within the block.
    """
    import cv2

    pycolmap = load_pycolmap()

    level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    try:
        with tempfile.TemporaryDirectory(prefix="diga3d-") as name:
            folder = Path(name)
            for key, pixels in images.items():
                path = folder / "images" / (key + _SUFFIX)
                path.parent.mkdir(parents=True, exist_ok=True)
                cv2.imwrite(str(path), shrink(pixels)[..., ::-1])
            database = folder / "database.db"
            pycolmap.Database.open(database).close()
            yield folder, database
    finally:
        pycolmap.logging.minloglevel = level


def _extraction() -> pycolmap.FeatureExtractionOptions:
    pycolmap = load_pycolmap()

    options = pycolmap.FeatureExtractionOptions()
    options.sift.max_num_features = BUDGET.features
    return options


def _match(folder: Path, database: Path, pairs: Sequence[matching.Pair]) -> None:
    """Match pairs of images and verify each pair by its geometry."""
    pycolmap = load_pycolmap()

    with pycolmap.Database.open(database) as tables:
        matching.match_pairs(tables, pairs)
    listed = folder / "pairs.txt"
    listed.write_text("\n".join(f"{a} {b}" for a, b in pairs), encoding="utf-8")
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = BUDGET.seed
    pycolmap.verify_matches(database, listed, options)


def _mapping() -> pycolmap.IncrementalPipelineOptions:
    pycolmap = load_pycolmap()

    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = BUDGET.seed
    # Several threads add observations in any order, and no two runs agree; one is as fast on small images.
    options.num_threads = options.mapper.num_threads = 1
    # Small captures make a model too; COLMAP wants 10 images.
    options.min_model_size = 2
    return options


def _refine(reconstruction: pycolmap.Reconstruction) -> None:
    """Adjust poses, points, focal lengths and distortion together."""
    pycolmap = load_pycolmap()

    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.ceres.solver_options.num_threads = 1
    config = pycolmap.BundleAdjustmentConfig()
    for number in reconstruction.reg_image_ids():
        config.add_image(number)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    pycolmap.create_default_bundle_adjuster(options, config, reconstruction).solve()


def _neighbours(cameras: Mapping[str, Camera]) -> Sequence[tuple[str, str]]:
    """Pairs of images that look at the same things: each with its nearest by place and direction."""
    names = sorted(cameras)
    centers = np.stack([cameras[name].center for name in names])
    directions = np.stack([cameras[name].forward for name in names])
    # Places count in units of their spread, so that they weigh about as much as unit directions.
    spread = max(float(np.linalg.norm(centers - centers.mean(0), axis=1).max()), 1e-12)
    place = np.concatenate([centers / spread, directions], axis=1)
    distance = np.linalg.norm(place[:, None] - place[None], axis=2)
    pairs: set[tuple[int, int]] = set()
    for i, row in enumerate(distance):
        nearest = [int(j) for j in np.argsort(row, kind="stable") if j != i][: BUDGET.neighbours]
        pairs.update((min(i, j), max(i, j)) for j in nearest)
    return [(names[i], names[j]) for i, j in sorted(pairs)]


def _points(reconstruction: pycolmap.Reconstruction) -> Points:
    """The points in the order of their first feature, by image and number of the feature."""

    def first_feature(point: pycolmap.Point3D) -> tuple[int, int]:
        return min((element.image_id, element.point2D_idx) for element in point.track.elements)

    points = sorted(reconstruction.points3D.values(), key=first_feature)
    positions = np.array([point.xyz for point in points], np.float64).reshape(-1, 3)
    colors = np.array([point.color for point in points], np.uint8).reshape(-1, 3)
    names = {number: image.name.removesuffix(_SUFFIX) for number, image in reconstruction.images.items()}
    tracks = [frozenset(names[element.image_id] for element in point.track.elements) for point in points]
    return Points(positions, colors, tracks)
