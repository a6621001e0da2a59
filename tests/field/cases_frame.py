"""Cases of frames, scales and offsets."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from expectations import Reads, Refuses, case
from field_room import FieldRoom

from diga3d_warp.gaussians.initialise import initialise
from diga3d_warp.scene.colmap.reconstruction import write_colmap
from diga3d_warp.scene.scene import Points

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])

BEHIND = "lie behind the cameras"
FLIPPED = "if the y and z axes of the cameras are flipped"
INVERTED = "if the poses are inverted"


def transposed(pose: np.ndarray) -> np.ndarray:
    return np.block([[pose[:3, :3].T, pose[:3, 3:]], [pose[3:]]])


def with_frames(
    room: FieldRoom, folder: Path, change: Callable[[np.ndarray], np.ndarray], points=True
) -> Path:
    """transforms.json with `change` applied to each matrix."""
    contents = room.transforms()
    for frame in contents["frames"]:
        frame["transform_matrix"] = change(np.array(frame["transform_matrix"])).tolist()
    if not points:
        del contents["ply_file_path"]
    room.nerfstudio(folder, contents)
    if not points:
        (folder / "sparse_pc.ply").unlink()
    return folder


def with_poses(room: FieldRoom, folder: Path, change: Callable[[np.ndarray], np.ndarray]) -> Path:
    """A COLMAP model with `change` applied to each world-to-camera transform."""
    room.write_images(folder / "images")
    cameras = {name: camera.with_pose(change(camera.pose)) for name, camera in room.cameras.items()}
    write_colmap(folder, cameras, room.points, suffix=".jpg")
    return folder


def with_points(
    room: FieldRoom, folder: Path, positions: np.ndarray, colors: np.ndarray | None = None
) -> Path:
    """A COLMAP model with other points."""
    room.write_images(folder / "images")
    colors = room.points.colors[: len(positions)] if colors is None else colors
    write_colmap(folder, room.cameras, Points(positions, colors), suffix=".jpg")
    return folder


@case(Refuses(("transforms.json", BEHIND, FLIPPED, "OpenGL axes")))
def opencv_axes_in_transforms(room, folder):
    return with_frames(room, folder, lambda matrix: matrix @ FLIP)


@case(Refuses(("sparse/0", BEHIND, FLIPPED, "OpenCV axes")))
def opengl_axes_in_colmap(room, folder):
    return with_poses(room, folder, lambda pose: FLIP @ pose)


@case(Refuses(("transforms.json", INVERTED)))
def world_to_camera_in_transforms(room, folder):
    return with_frames(room, folder, np.linalg.inv)


@case(Refuses(("transforms.json", INVERTED, "axes of the cameras flipped")))
def opencv_world_to_camera_in_transforms(room, folder):
    return with_frames(room, folder, lambda matrix: FLIP @ np.linalg.inv(matrix))


@case(Refuses(("sparse/0", INVERTED)))
def camera_to_world_in_colmap(room, folder):
    return with_poses(room, folder, np.linalg.inv)


@case(Refuses(("if the rotations are transposed",)))
def rotations_transposed_in_transforms(room, folder):
    return with_frames(room, folder, transposed)


@case(Refuses(("if the rotations are transposed",)))
def quaternions_conjugated_in_colmap(room, folder):
    return with_poses(room, folder, transposed)


@case(Refuses(("if the translations are taken for camera centres",)))
def camera_centres_as_translations_in_colmap(room, folder):
    def change(pose: np.ndarray) -> np.ndarray:
        return np.block([[pose[:3, :3], -pose[:3, :3].T @ pose[:3, 3:]], [pose[3:]]])

    return with_poses(room, folder, change)


@case(Refuses(("if the quaternions are taken as x, y, z, w",)))
def quaternions_scalar_last_in_colmap(room, folder):
    from scipy.spatial.transform import Rotation

    def change(pose: np.ndarray) -> np.ndarray:
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        read = Rotation.from_quat([x, y, z, w], scalar_first=True).as_matrix()  # x is taken for w
        return np.block([[read, pose[:3, 3:]], [pose[3:]]])

    return with_poses(room, folder, change)


@case(Refuses(("the sparse points", "if their coordinates are exchanged to (x, -z, y)")))
def points_with_y_up(room, folder):
    return with_points(room, folder, room.points.positions[:, [0, 2, 1]] * [1.0, 1.0, -1.0])


@case(Refuses(("the sparse points", "scaled by 0.001", "millimetres")))
def points_in_millimetres(room, folder):
    return with_points(room, folder, 1000.0 * room.points.positions)


@case(Refuses(("the sparse points", "of different captures, frames or scales")))
def points_far_from_the_cameras(room, folder):
    return with_points(room, folder, room.points.positions + [500.0, 0.0, 0.0])


@case(Refuses(("gaussians of splat.ply", "their colours do not match")))
def splat_of_another_frame(room, folder):
    room.colmap(folder)
    turn = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
    middle = room.points.positions.mean(axis=0)
    moved = (room.points.positions - middle) @ turn.T + middle
    initialise(Points(moved, room.points.colors)).save_ply(folder / "splat.ply")
    return folder


@case(Refuses(("their colours do not match the photographs",)))
def photographs_of_other_poses(room, folder):
    """The images were renamed in another order than the poses."""
    names = room.names
    pixels = {name: room.pixels[other] for name, other in zip(names, np.roll(names, 3), strict=True)}
    return FieldRoom(room.cameras, pixels, room.masks, room.points).colmap(folder)


@case(Refuses(("the poses do not fit the photographs", FLIPPED)))
def opencv_axes_in_transforms_without_points(room, folder):
    return with_frames(room, folder, lambda matrix: matrix @ FLIP, points=False)


@case(Refuses(("the poses do not fit the photographs", INVERTED)))
def world_to_camera_in_transforms_without_points(room, folder):
    return with_frames(room, folder, np.linalg.inv, points=False)


@case(Reads(points=False))
def points_of_a_random_start(room, folder):
    """As 3DGS writes for captures without points: places and colours at random."""
    generator = np.random.default_rng(0)
    low, high = room.points.positions.min(axis=0), room.points.positions.max(axis=0)
    positions = generator.uniform(low, high, (2000, 3))
    return with_points(room, folder, positions, generator.integers(0, 256, (2000, 3)).astype(np.uint8))


@case(Reads())
def points_of_one_colour(room, folder):
    return with_points(room, folder, room.points.positions, np.full_like(room.points.colors, 128))


@case(Reads(points=False))
def a_handful_of_points(room, folder):
    return with_points(room, folder, room.points.positions[:5])


@case(Reads(points=False))
def a_scan_far_beyond_the_photographs(room, folder):
    """The points of the room are a twentieth of the cloud."""
    generator = np.random.default_rng(0)
    beyond = generator.uniform(-200.0, 200.0, (19 * len(room.points), 3)) + [0.0, 0.0, 500.0]
    colors = generator.integers(0, 256, (len(beyond), 3)).astype(np.uint8)
    return with_points(
        room,
        folder,
        np.concatenate([room.points.positions, beyond]),
        np.concatenate([room.points.colors, colors]),
    )
