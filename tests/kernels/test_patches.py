"""Patch search and vote against plain loops in float64."""

import numpy as np
import pytest
import warp as wp

from diga3d_warp.kernels.patches import FAR, LANES, Keys, PatchForm, Queries, search, vote

FORM = PatchForm(radius=2, channels=4, kept=3)
HEIGHT, WIDTH = 15, 19
SOURCE_HEIGHT, SOURCE_WIDTH = 17, 13
ALONG = (0.01, 0.03, 0.5, -1.5)


class Case:
    """A query image, some of whose patches look for those of a source; oracle and kernels side by side."""

    def __init__(self, device: str, seed: int = 0) -> None:
        random = np.random.default_rng(seed)
        r, c = FORM.radius, FORM.channels
        self.device = device
        padded = (HEIGHT + 2 * r, WIDTH + 2 * r, c)
        self.image = random.random(padded).astype(np.float32)
        self.weights = random.random(padded).astype(np.float32)
        self.weights[:r] = self.weights[-r:] = 0.0
        self.weights[:, :r] = self.weights[:, -r:] = 0.0
        self.source = random.random((SOURCE_HEIGHT, SOURCE_WIDTH, c)).astype(np.float32)
        self.scale = random.uniform(0.5, 2.0, (SOURCE_HEIGHT, SOURCE_WIDTH)).astype(np.float32)
        self.scale[:r] = self.scale[-r:] = 0.0
        self.scale[:, :r] = self.scale[:, -r:] = 0.0
        self.scale[6:8, 4:6] = 0.0
        self.pixels = np.flatnonzero(random.random(HEIGHT * WIDTH) < 0.5).astype(np.int32)
        self.slots = np.full(HEIGHT * WIDTH, -1, np.int32)
        self.slots[self.pixels] = np.arange(len(self.pixels))

    def distances(self) -> np.ndarray:
        """From every query to every pixel of the source, shape (N, H W); infinite where there is no key."""
        r, side = FORM.radius, FORM.side
        far = np.full((len(self.pixels), SOURCE_HEIGHT * SOURCE_WIDTH), np.inf)
        for i, pixel in enumerate(self.pixels):
            y, x = divmod(int(pixel), WIDTH)
            q, w = (a[y : y + side, x : x + side].astype(float) for a in (self.image, self.weights))
            for key in np.flatnonzero(self.scale > 0.0):
                ky, kx = divmod(int(key), SOURCE_WIDTH)
                k = self.source[ky - r : ky + r + 1, kx - r : kx + r + 1].astype(float)
                way = ALONG[0] * (kx - x - ALONG[2]) ** 2 + ALONG[1] * (ky - y - ALONG[3]) ** 2
                far[i, key] = self.scale[ky, kx] * ((w * (q - k) ** 2).sum() + way)
        return far

    def queries(self) -> Queries:
        return Queries(
            self.array(self.pixels, wp.int32), self.array(self.slots, wp.int32),
            self.array(self.image.ravel()), self.array(self.weights.ravel()), WIDTH,
        )  # fmt: skip

    def keys(self) -> Keys:
        slack = np.full(LANES, 7.0, np.float32)  # whatever lies there must not count
        values = np.concatenate([self.source.ravel(), slack])
        return Keys(self.array(values), self.array(self.scale.ravel()), SOURCE_WIDTH)

    def array(self, values, dtype=wp.float32) -> wp.array:
        return wp.array(values, dtype=dtype, device=self.device)

    def search(
        self, candidates: np.ndarray, seed: int = 0, draws: int = 6, spread: float = 8.0, apart: float = 0.0
    ):
        """Candidates and distances after one step, shape (N, kept)."""
        outputs = [
            self.array(np.zeros(candidates.size), wp.int32),
            self.array(np.zeros(candidates.size), wp.float32),
        ]
        search(
            FORM, self.queries(), self.keys(), ALONG, self.array(candidates.ravel(), wp.int32), outputs,
            apart=apart, draws=draws, spread=spread, seed=seed,
        )  # fmt: skip
        found, distances = (output.numpy().reshape(candidates.shape) for output in outputs)
        return found, distances

    def none(self) -> np.ndarray:
        return np.full((len(self.pixels), FORM.kept), -1, np.int32)


def test_distances_are_those_of_plain_loops(device):
    case = Case(device)
    found, distances = case.search(case.none(), draws=12)
    expected = case.distances()
    present = found >= 0
    assert present.mean() > 0.8
    rows = np.nonzero(present)[0]
    np.testing.assert_allclose(distances[present], expected[rows, found[present]], rtol=2e-5)
    assert (distances[~present] == float(FAR)).all()


def test_candidates_are_distinct_sorted_keys(device):
    case = Case(device)
    candidates = case.none()
    for seed in range(5):
        candidates, distances = case.search(candidates, seed)
        assert (np.diff(distances, axis=1) >= 0.0).all()
        for row in candidates:
            kept = row[row >= 0]
            assert len(set(kept)) == len(kept)
            assert (case.scale.ravel()[kept] > 0.0).all()


def test_repeated_steps_find_a_copy(device):
    """The query shows a part of the source two rows up and one column to the right of its place there."""
    case = Case(device)
    r = FORM.radius
    case.scale[:] = 0.0
    case.scale[r:-r, r:-r] = 1.0
    case.pixels = case.slots = np.arange(HEIGHT * WIDTH, dtype=np.int32)
    case.image[r + 2 : r + 13, r + 1 : r + 12] = case.source[4:15, 0:11]
    candidates, previous = case.none(), np.full(len(case.pixels), np.inf)
    for seed in range(12):
        candidates, distances = case.search(candidates, seed, spread=16.0)
        assert (distances[:, 0] <= previous * (1 + 1e-6)).all(), "the nearest is never lost"
        previous = distances[:, 0]
    y, x = case.pixels // WIDTH, case.pixels % WIDTH
    inside = (y >= 2 + r) & (y < 13 - r) & (x >= 1 + r) & (x < 12 - r)
    assert inside.sum() > 40
    expected = (y + 2) * SOURCE_WIDTH + x - 1
    np.testing.assert_array_equal(candidates[inside, 0], expected[inside])
    way = ALONG[0] * (-1 - ALONG[2]) ** 2 + ALONG[1] * (2 - ALONG[3]) ** 2
    np.testing.assert_allclose(distances[inside, 0], way, rtol=1e-4)


def test_neighbours_hand_on_what_they_found(device):
    """Without random candidates, one good one spreads over its neighbourhood, moved along."""
    case = Case(device)
    case.pixels = case.slots = np.arange(HEIGHT * WIDTH, dtype=np.int32)
    r = FORM.radius
    case.scale[:] = 0.0
    case.scale[r:-r, r:-r] = 1.0
    candidates = case.none()
    middle = 7 * WIDTH + 8
    candidates[middle, 0] = 8 * SOURCE_WIDTH + 6
    found, _ = case.search(candidates, draws=0)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            assert found[middle + dy * WIDTH + dx, 0] == (8 + dy) * SOURCE_WIDTH + 6 + dx
    assert (found >= 0).sum() == 9


def test_a_way_that_neighbours_do_not_take_costs(device):
    """Distances exceed the plain ones by the share of neighbours that go apart."""
    case = Case(device)
    apart = 0.5
    candidates = case.none()
    for seed in range(4):
        candidates, _ = case.search(candidates, seed, apart=apart)
    found, distances = case.search(candidates, 9, apart=apart)
    plain, scale = case.distances(), case.scale.ravel()
    differs = 0
    for i, pixel in enumerate(case.pixels):
        y, x = divmod(int(pixel), WIDTH)
        led = []
        for dy, dx in ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)):
            if 0 <= y + dy < HEIGHT and 0 <= x + dx < WIDTH:
                other = case.slots[(y + dy) * WIDTH + x + dx]
                if other >= 0 and candidates[other, 0] >= 0:
                    ky, kx = divmod(int(candidates[other, 0]), SOURCE_WIDTH)
                    if 0 <= ky - dy < SOURCE_HEIGHT and 0 <= kx - dx < SOURCE_WIDTH:
                        led.append((ky - dy) * SOURCE_WIDTH + kx - dx)
        for key, distance in zip(found[i], distances[i], strict=True):
            if key >= 0:
                share = sum(way != key for way in led) / len(led) if led else 0.0
                assert np.isclose(distance, plain[i, key] + scale[key] * apart * share, rtol=2e-5)
                differs += 0.0 < share < 1.0
    assert differs > 10


def test_the_result_does_not_depend_on_threads(threads):
    case = Case("cpu")
    results = []
    for count in (1, 3):
        threads(count)
        candidates = case.none()
        for seed in range(3):
            candidates, _ = case.search(candidates, seed)
        results.append(candidates)
    np.testing.assert_array_equal(*results)


def test_the_vote_is_the_weighted_mean_of_all_patches_over_a_pixel(device):
    case = Case(device)
    random = np.random.default_rng(3)
    candidates = case.none()
    for seed in range(3):
        candidates, _ = case.search(candidates, seed)
    attention = random.random(candidates.shape).astype(np.float32)
    attention[::5, 1] = 0.0
    window = random.random(FORM.side**2).astype(np.float32)
    targets = np.arange(HEIGHT * WIDTH, dtype=np.int32)
    colors = case.array(np.full((len(targets), 3), 9.0, np.float32), wp.vec3)
    vote(
        FORM, case.queries(), case.keys(), case.array(targets, wp.int32),
        case.array(candidates.ravel(), wp.int32), case.array(attention.ravel()), case.array(window), colors,
    )  # fmt: skip
    r, side = FORM.radius, FORM.side
    total, share = np.zeros((HEIGHT, WIDTH, 3)), np.zeros((HEIGHT, WIDTH, 1))
    for i, pixel in enumerate(case.pixels):
        y, x = divmod(int(pixel), WIDTH)
        for key, weight in zip(candidates[i], attention[i], strict=True):
            for row in range(side):
                for column in range(side):
                    ty, tx = y + row - r, x + column - r
                    if key >= 0 and 0 <= ty < HEIGHT and 0 <= tx < WIDTH:
                        ky, kx = divmod(int(key), SOURCE_WIDTH)
                        part = float(weight) * float(window[row * side + column])
                        total[ty, tx] += part * case.source[ky + row - r, kx + column - r, :3]
                        share[ty, tx] += part
    expected = np.where(share > 0.0, total / np.maximum(share, 1e-30), 9.0)
    np.testing.assert_allclose(colors.numpy().reshape(HEIGHT, WIDTH, 3), expected, rtol=1e-4)


@pytest.mark.parametrize("count", [0, 1])
def test_hardly_any_query(device, count):
    case = Case(device)
    case.pixels, case.slots[:] = case.pixels[:count], -1
    case.slots[case.pixels] = np.arange(count)
    found, _ = case.search(case.none())
    assert found.shape == (count, FORM.kept)
