import numpy as np
import pytest

from diga3d_warp.errors import InputError
from diga3d_warp.propagation.references import References, select_references, usable_views


def three_groups():
    rng = np.random.default_rng(0)
    sizes, middles = (4, 12, 7), np.array([[0.0, 0, 0], [5.0, 0, 0], [0.0, 6, 1]])
    group = np.repeat(np.arange(3), sizes)
    order = rng.permutation(len(group))
    return (middles[group] + rng.normal(0, 0.3, (len(group), 3)))[order], group[order]


@pytest.mark.parametrize("seed", range(5))
def test_kmeans_finds_the_groups_and_takes_the_view_nearest_each_middle(seed):
    centers, group = three_groups()
    references = select_references(centers, 3, seed)
    assert [int(group[i]) for i in references.indices] == [1, 2, 0]  # largest first
    for k, index in enumerate(references.indices):
        members = references.cluster == k
        np.testing.assert_array_equal(members, group == group[index])
        to_middle = np.linalg.norm(centers - centers[members].mean(0), axis=1)
        assert index == to_middle.argmin()


def test_random_gives_each_view_to_the_nearest_reference():
    centers, _ = three_groups()
    references = select_references(centers, 4, seed=7, method="random")
    assert len(set(references.indices)) == 4
    nearest = np.linalg.norm(centers[:, None] - centers[references.indices][None], axis=-1).argmin(1)
    np.testing.assert_array_equal(references.cluster, nearest)
    sizes = np.bincount(references.cluster, minlength=4)
    assert (np.diff(sizes) <= 0).all()
    other = select_references(centers, 4, seed=8, method="random")
    assert set(other.indices) != set(references.indices)


@pytest.mark.parametrize("method", ["kmeans", "random"])
@pytest.mark.parametrize("count", [1, 2, 5, 6])
def test_cameras_at_one_place_still_give_distinct_references(method, count):
    centers = np.zeros((6, 3))
    centers[5] = 1.0
    references = select_references(centers, count, method=method)
    assert len(set(references.indices)) == count
    assert set(references.cluster.tolist()) == set(range(count))
    again = select_references(centers, count, method=method)
    assert again.indices == references.indices


@pytest.mark.parametrize("count", [0, 24])
def test_more_references_than_views_are_refused(count):
    with pytest.raises(InputError, match="23 views"):
        select_references(three_groups()[0], count)


def test_an_unknown_method_is_refused():
    with pytest.raises(InputError, match="kmeans"):
        select_references(three_groups()[0], 3, method="best")


@pytest.mark.parametrize("method", ["kmeans", "random"])
def test_references_are_views_that_show_what_is_edited(method):
    """The others still follow the nearest of them."""
    centers, group = three_groups()
    usable = group != 1
    references = select_references(centers, 3, 0, method, usable.tolist())
    assert len(references.indices) == 3 and all(usable[i] for i in references.indices)
    nearest = np.linalg.norm(centers[:, None] - centers[references.indices][None], axis=-1).argmin(1)
    np.testing.assert_array_equal(references.cluster, nearest)


def test_few_usable_views_are_all_references():
    centers, _ = three_groups()
    references = select_references(centers, 3, 0, usable=[index == 4 for index in range(len(centers))])
    assert references.indices == [4] and not references.cluster.any()
    assert isinstance(references, References)
    with pytest.raises(InputError, match="no view shows anything to edit"):
        select_references(centers, 3, 0, usable=[False] * len(centers))


def test_tips_at_the_border_and_views_of_nothing_else_are_not_usable():
    def area(rows: int) -> np.ndarray:
        mask = np.zeros((100, 80), bool)
        mask[:rows] = True
        return mask

    assert usable_views([area(40), area(0), area(1), area(20), area(100)]) == [
        True,
        False,
        False,
        True,
        False,
    ]
    assert usable_views([area(0), area(100)]) == [False, True], "better than none"
    assert usable_views([area(0), area(0)]) == [False, False]
    assert usable_views([np.ones((0, 0), bool)][:0]) == []
