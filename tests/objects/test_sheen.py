"""What polished metal mirrors."""

import numpy as np

from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.materials.vocabulary import MATERIALS
from diga3d_warp.objects.frame import Frame
from diga3d_warp.objects.sheen import SURROUNDINGS, polished
from diga3d_warp.objects.wrapping import wrap

GREY = np.full((1, 3), 0.5)


def ball(count: int = 4000) -> np.ndarray:
    """Normals spread evenly over a ball."""
    k = np.arange(count) + 0.5
    z, around = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(around), flat * np.sin(around), z], -1)


def looking(azimuth: float, elevation: float) -> np.ndarray:
    a, e = np.radians([azimuth, elevation])
    return np.array([[np.cos(e) * np.sin(a), -np.cos(e) * np.cos(a), np.sin(e)]])


def test_what_is_not_polished_stays_as_it_is():
    colors = np.random.default_rng(0).random((50, 3))
    assert np.array_equal(polished(colors, ball(50), 0.0), colors)


def test_a_metal_is_about_as_bright_as_it_was_matte():
    normals = ball()
    linear = polished(np.repeat(GREY, len(normals), 0), normals, 1.0) ** GAMMA
    assert 0.85 < linear.mean() / 0.5**GAMMA < 1.2


def test_the_floor_ends_in_a_dark_band_and_the_ceiling_is_bright():
    shown = {e: float(polished(GREY, looking(180, e), 1.0)[0, 0]) for e in (-45, -7, 30, 60)}
    assert shown[-7] < 0.75 * shown[-45] < shown[30]
    assert abs(shown[60] - shown[30]) < 0.1, "from 45 degrees on, it is the ceiling straight above"


def test_the_window_is_seen_from_the_front_alone():
    front = np.array([SURROUNDINGS.window]) / np.linalg.norm(SURROUNDINGS.window)
    back = front * [-1.0, -1.0, 1.0]
    gold = np.array([[0.8, 0.6, 0.2]])
    lit, other = polished(gold, front, 1.0)[0], polished(gold, back, 1.0)[0]
    assert lit[2] > other[2] + 0.3, "white light"
    assert other[0] > 1.5 * other[2], "gold"


def test_gold_is_smooth():
    """Dents that stand out one by one look like scales: neighbours on a ball differ little."""
    gold = MATERIALS["gold"]
    assert gold.polish == 1.0
    texture = gold.exemplar(256, 0).astype(float)
    normals = ball(20000)
    colors = wrap(texture, 0.5 * normals, normals, Frame(np.zeros(3), np.eye(3), np.ones(3)), 1.0)
    steps = np.abs(np.diff(texture, axis=1)).mean()
    assert steps < 0.02
    assert colors.std(axis=0)[0] > 0.02, "not of one colour"
