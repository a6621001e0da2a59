"""Cameras, photographs and points of one frame are told from those of several."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from diga3d_warp.errors import InputError
from diga3d_warp.scene.camera import Camera, Distortion, look_at
from diga3d_warp.scene.checks.frame import FRAME, agreement, check_frame, likely_poses
from diga3d_warp.scene.checks.frame_suspects import CONVENTIONS, FLIP, POSES
from diga3d_warp.scene.scene import Points, View
from diga3d_warp.scene.visible_points import visible_points

WIDTH, HEIGHT = 64, 48


def colored_ball(count: int = 1500) -> Points:
    """Points on a sphere, their colours as smooth as their places."""
    places = np.random.default_rng(3).normal(size=(count, 3))
    places /= np.linalg.norm(places, axis=1, keepdims=True)
    return Points(places, (127.5 + 127.5 * np.sin(3.0 * places)).astype(np.uint8))


def picture(camera: Camera, points: Points) -> np.ndarray:
    """Points as discs, the nearest in front."""
    pixels = np.full((camera.height, camera.width, 3), 40, np.uint8)
    visible = visible_points(camera, points.positions)
    for number in np.argsort(-visible.depth):
        center = visible.place[number].astype(int).tolist()
        cv2.circle(pixels, center, 2, points.colors[visible.index[number]].tolist(), cv2.FILLED)
    return pixels


def ring(points: Points, lens: Distortion | None = None) -> dict[str, View]:
    """Six views around the ball, at different heights."""
    views = {}
    for number in range(6):
        angle = number * np.pi / 3.0
        pose = look_at(np.array([3.0 * np.cos(angle), 3.0 * np.sin(angle), 1.0 + 0.3 * number]), np.zeros(3))
        camera = Camera(WIDTH, HEIGHT, 60.0, 60.0, WIDTH / 2, HEIGHT / 2, pose, lens)
        views[f"view_{number}"] = View(f"view_{number}", camera, picture(camera, points))
    return views


def check(views, points):
    return check_frame(views, points, "images.txt", "the sparse points", CONVENTIONS["colmap"])


@pytest.mark.parametrize(
    "lens", [None, Distortion("brown", (0.1, 0.02, 0.01, -0.01)), Distortion("fisheye", (0.1, 0.0, 0.0, 0.0))]
)
def test_points_of_the_frame_agree(lens):
    points = colored_ball()
    views = ring(points, lens)
    read = agreement(list(views.values()), points)
    assert read.fits and read.correlation > 0.7 and read.seen > 0.99
    assert check(views, points) == []


@pytest.mark.parametrize("suspect", POSES, ids=range(len(POSES)))
def test_each_suspect_is_refused_and_named(suspect):
    """A capture for which the suspect is the truth: it maps the poses as read to the right ones."""
    points = colored_ball()
    views = ring(points)
    wrong = {}
    for key, view in views.items():
        read = _mapped_to(suspect, view.camera.pose)
        wrong[key] = replace(view, camera=view.camera.with_pose(read))
    with pytest.raises(InputError, match="do not fit the cameras") as error:
        check(wrong, points)
    assert suspect.fault in str(error.value)


def _mapped_to(suspect, pose: np.ndarray) -> np.ndarray:
    """The pose that `suspect` turns into `pose`: one of the suspects or of their inverses gives it."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
    scalar_first = pose.copy()
    scalar_first[:3, :3] = Rotation.from_quat([x, y, z, w], scalar_first=True).as_matrix()
    center = pose.copy()
    center[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    tried = [*(other.pose(pose) for other in POSES), scalar_first, center]
    return next(read for read in tried if np.allclose(suspect.pose(read), pose))


def test_a_view_that_sees_nothing_is_noted():
    points = colored_ball()
    views = ring(points)
    turned = views["view_3"]
    views["view_3"] = replace(turned, camera=turned.camera.with_pose(FLIP @ turned.camera.pose))
    [note] = check(views, points)
    assert note.startswith("1 of 6 views see none of the sparse points: view_3")


def test_colours_that_agree_little_are_noted():
    """Between right and wrong: a part of the colours is of another pattern."""
    points = colored_ball()
    views = ring(points)
    other = 127.5 + 127.5 * np.sin(7.0 * points.positions[:, [1, 2, 0]] + 1.0)
    for share in np.linspace(0.4, 1.0, 61):
        blended = (share * other + (1.0 - share) * points.colors).astype(np.uint8)
        little = Points(points.positions, blended)
        if agreement(list(views.values()), little).correlation < FRAME.agrees:
            break
    [note] = check(views, little)
    assert "the colours of the sparse points hardly match the photographs" in note


def test_points_that_lie_behind_others_do_not_count():
    """Inside the ball lie points of the opposite colours: with all of them, nothing would agree."""
    points = colored_ball()
    views = ring(points)
    inner = Points(0.5 * points.positions, 255 - points.colors)
    both = Points(
        np.concatenate([points.positions, inner.positions]), np.concatenate([points.colors, inner.colors])
    )
    assert agreement(list(views.values()), both).correlation > 0.4


def test_transparent_pixels_are_not_compared():
    points = colored_ball()
    views = list(ring(points).values())
    spoiled = []
    for view in views:
        alpha = np.full((HEIGHT, WIDTH), 255, np.uint8)
        alpha[: HEIGHT // 2] = 0
        pixels = view.pixels.copy()
        pixels[: HEIGHT // 2] = np.random.default_rng(1).integers(0, 256, (HEIGHT // 2, WIDTH, 3))
        spoiled.append(replace(view, pixels=pixels, alpha=alpha))
    assert agreement(spoiled, points).correlation > 0.7
    opaque = [replace(view, alpha=None) for view in spoiled]
    assert agreement(opaque, points).correlation < 0.6


@pytest.mark.parametrize("found, likely", [(3, True), (40, False)])
def test_suspects_are_tried_where_few_points_agree(found, likely):
    views = ring(colored_ball(50))
    right = {key: FLIP @ view.camera.pose for key, view in views.items()}
    tried = []

    def count(changed):
        tried.append(changed)
        return 100 if all(np.allclose(changed[key].camera.pose, right[key]) for key in views) else 2

    suspect = likely_poses(views, found, count)
    assert (suspect is POSES[0]) == likely and bool(tried) == likely


def test_a_lens_moves_what_is_off_the_axis():
    place = np.array([[1.0, 0.5, 2.0], [0.0, 0.0, 2.0], [0.0, 0.0, -1.0], [30.0, 0.0, 2.0]])
    camera = Camera(100, 80, 50.0, 50.0, 50.0, 40.0, np.eye(4))
    plain = visible_points(camera, place)
    assert plain.index.tolist() == [0, 1] and plain.in_front == 3
    np.testing.assert_allclose(plain.place, [[75.0, 52.5], [50.0, 40.0]])
    bent = visible_points(replace(camera, distortion=Distortion("brown", (-0.2, 0.0, 0.0, 0.0))), place)
    assert bent.index.tolist() == [0, 1]  # the far one folds back into the image, and is beyond the lens
    factor = 1.0 - 0.2 * (0.5**2 + 0.25**2)
    np.testing.assert_allclose(bent.place[0], [50.0 + 25.0 * factor, 40.0 + 12.5 * factor])
