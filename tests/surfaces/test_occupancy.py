"""Where a surface ends in what nobody saw."""

import numpy as np
import pytest

from diga3d_warp.surfaces.occupancy import _by_ellipse, _by_polygon, occupancy


def split(surface: np.ndarray, hole: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return surface & ~hole, ~surface & ~hole


PLACES = np.indices((60, 80))
HOLE = np.hypot(PLACES[0] - 30, PLACES[1] - 40) < 14


@pytest.mark.parametrize("slope", [0.0, 0.3, -0.8])
def test_a_straight_edge_goes_on(slope):
    surface = PLACES[0] > 30 + slope * (PLACES[1] - 40)
    found = occupancy(*split(surface, HOLE), HOLE, 0).solid
    assert (found == surface).mean() > 0.985


def spotted(surface: np.ndarray, spots: list[tuple[int, int]]) -> np.ndarray:
    """A surface with spots where depth says that something behind it is seen."""
    for row, column in spots:
        surface = surface & (np.hypot(PLACES[0] - row, PLACES[1] - column) >= 3.5)
    return surface


def test_spots_of_wrong_depth_do_not_end_a_straight_edge():
    edge = PLACES[0] > 30
    spots = [(42, 40), (47, 26), (48, 52), (38, 55)]
    known, through = split(spotted(edge, spots), HOLE)
    found = occupancy(known, through, HOLE, 0, trusted=0.75)
    assert found.trusted and (found.solid == edge).mean() > 0.985


def test_the_gaps_of_a_lattice_stay_open():
    gaps = [(row, column) for row in range(6, 60, 10) for column in range(5, 80, 10)]
    known, through = split(spotted(np.ones_like(HOLE), gaps), HOLE)
    assert not occupancy(known, through, HOLE, 0).solid[through].any()


def test_the_corner_of_a_table_goes_on():
    surface = (PLACES[0] > 28) & (PLACES[1] < 42)
    found = occupancy(*split(surface, HOLE), HOLE, 0).solid
    assert (found == surface)[HOLE].mean() > 0.95


def test_the_corner_of_an_opening_goes_on():
    surface = (PLACES[0] > 28) | (PLACES[1] < 42)
    found = occupancy(*split(surface, HOLE), HOLE, 0).solid
    assert (found == surface)[HOLE].mean() > 0.95


@pytest.mark.parametrize("slope", [0.0, 0.4])
def test_a_surface_ends_at_the_feet_of_what_stands_on_it(slope):
    """Books hide the board behind their fronts from all photographs; the hole reaches behind these."""
    board = PLACES[0] > 24 + slope * (PLACES[1] - 40)
    known, covered = split(board, HOLE)
    nothing = np.zeros_like(HOLE)
    found = occupancy(known, nothing, HOLE, 0, covered=covered).solid
    assert (found == board)[HOLE].mean() > 0.95
    assert occupancy(known, nothing, HOLE, 0).solid[HOLE].all()


def test_a_surface_goes_on_past_a_thing_that_hides_some_of_it():
    hidden = np.hypot(PLACES[0] - 20, PLACES[1] - 14) < 9
    nothing = np.zeros_like(HOLE)
    found = occupancy(~HOLE & ~hidden, nothing, HOLE, 0, covered=hidden).solid
    assert found[HOLE].all()


@pytest.mark.parametrize("flat", [1.0, 0.6])
def test_the_rim_of_a_round_table_goes_on(flat):
    """Its back is hidden all along the hole: what is seen of its rim tells where it ends."""
    surface = np.hypot((PLACES[0] - 34) / flat, PLACES[1] - 40) < 22
    hole = (PLACES[0] < 34) & (np.abs(PLACES[1] - 40) < 17)
    found = occupancy(*split(surface, hole), hole, 0, trusted=0.75)
    assert found.trusted and (found.solid == surface)[hole].mean() > 0.95


def test_a_jagged_rim_is_no_ellipse():
    rng = np.random.default_rng(0)
    surface = PLACES[0] > 30 + np.repeat(rng.integers(-12, 12, 10), 8)[None]
    known, through = split(surface, HOLE)
    assert _by_ellipse(known, through, HOLE, 0) is None


def test_a_round_rim_goes_on_smoothly():
    surface = np.hypot(PLACES[0] - 60, PLACES[1] - 40) < 34
    found = occupancy(*split(surface, HOLE), HOLE, 0).solid
    assert (found == surface)[HOLE].mean() > 0.85


def test_all_of_it_where_nothing_is_seen_through():
    known = ~HOLE
    assert occupancy(known, np.zeros_like(HOLE), HOLE, 0).solid.all()


def test_nothing_where_nothing_is_known_or_all_is_seen_through():
    none = np.zeros_like(HOLE)
    assert not occupancy(none, none, HOLE, 0).solid.any()
    assert not occupancy(none, ~HOLE, HOLE, 0).solid.any()


def test_scattered_depth_is_not_trusted():
    """A hedge agrees with any plane here and there; nothing is filled in between."""
    rng = np.random.default_rng(0)
    known = (rng.uniform(size=HOLE.shape) < 0.5) & ~HOLE
    through = ~known & ~HOLE
    assert occupancy(known, through, HOLE, 0, trusted=0.75).solid[HOLE].sum() == 0
    known, through = ~HOLE & (rng.uniform(size=HOLE.shape) < 0.97), np.zeros_like(HOLE)
    through = ~HOLE & ~known
    assert occupancy(known, through, HOLE, 0, trusted=0.75).solid[HOLE].mean() > 0.95


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (1, 40)])
def test_a_chart_of_a_few_texels(shape):
    known = np.ones(shape, bool)
    known.flat[-1] = False
    found = occupancy(known, np.zeros(shape, bool), ~known, 0).solid
    assert found.shape == shape
    assert occupancy(known, ~known, np.zeros(shape, bool), 0).solid.sum() == known.sum()


def corners_of_a_plinth() -> tuple[np.ndarray, np.ndarray]:
    """A rectangle, and what an object hides of it: all but two opposite corners, and a whole side."""
    down, across = np.indices((180, 240)) - np.array([90, 120])[:, None, None]
    plinth = (abs(down) < 48) & (abs(across) < 78)
    hidden = plinth & ((np.abs(down + 0.62 * across) < 48) | (down > 36))
    jagged = np.random.default_rng(0).random(plinth.shape) < 0.3
    return plinth, hidden | (jagged & (abs(down - 48) < 4) & (abs(across) < 78))


def test_a_plinth_of_which_some_corners_are_seen_goes_on():
    plinth, hidden = corners_of_a_plinth()
    found = occupancy(*split(plinth, hidden), hidden, 0, trusted=0.75)
    assert found.trusted
    assert found.solid[hidden & plinth].mean() > 0.95


def test_leaves_that_lie_in_a_plane_here_and_there_are_no_plinth():
    plinth, hidden = corners_of_a_plinth()
    leaves = plinth & (np.random.default_rng(1).random(plinth.shape) < 0.3)
    found = occupancy(*split(leaves, hidden), hidden, 0, trusted=0.75)
    assert not found.trusted and not found.solid[hidden].any()


def test_a_spot_amid_what_is_seen_through_is_no_plinth():
    """Around a hole anything is a polygon; next to nothing of this one is known."""
    spot = (abs(PLACES[0] - 30) < 4) & (abs(PLACES[1] - 24) < 4)
    assert _by_polygon(*split(spot, HOLE), HOLE, 0) is None


def no_polygon(known: np.ndarray, hidden: np.ndarray) -> bool:
    through = ~known & ~hidden
    return _by_polygon(known, through, hidden, 0) is None


def test_next_to_nothing_known_of_a_large_polygon_is_no_plinth():
    plinth, hidden = corners_of_a_plinth()
    across = np.indices(plinth.shape)[1] - 120
    few = plinth & ~hidden & (abs(across) > 70)
    assert few.sum() > 300 and no_polygon(few, plinth & ~few | hidden)


def test_one_straight_edge_is_no_plinth():
    plinth, _ = corners_of_a_plinth()
    across = np.indices(plinth.shape)[1] - 120
    band = plinth & (across < -50)
    middle = band & (abs(np.indices(plinth.shape)[0] - 90) < 30)
    assert no_polygon(middle, plinth & ~middle)


def test_a_side_of_a_polygon_leaves_out_little_of_what_is_wanted():
    """The hole's own rim is dented over more than half of the hidden side."""
    plinth, hidden = corners_of_a_plinth()
    down, across = np.indices(plinth.shape) - np.array([90, 120])[:, None, None]
    dented = hidden & plinth & ~((across < 15) & (down > 22) & (across > -75))
    known = plinth & ~hidden
    found = _by_polygon(known, ~known & ~dented, dented, 0)
    assert found is not None and found[dented].mean() > 0.95
