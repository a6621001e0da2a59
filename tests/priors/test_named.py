"""Priors by name: those that are built in, and one line for names that mean none."""

import pytest

from diga3d_warp.errors import InputError
from diga3d_warp.priors import named
from diga3d_warp.priors.named import BUILT_IN, load_prior


@pytest.mark.parametrize("name", BUILT_IN)
def test_built_in_priors_by_name(name):
    assert load_prior(name).name == name


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("", "the name of the prior is empty: give exemplar, classical, lama, sd-inpainting"),
        (" \t\n", "the name of the prior is empty"),
        ("nowhere", "there is no prior or folder nowhere: give exemplar, classical, lama, sd-inpainting"),
        ("Exemplar", "there is no prior or folder Exemplar: give exemplar"),
    ],
)
def test_names_that_mean_no_prior(name, said):
    with pytest.raises(InputError) as caught:
        load_prior(name)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_the_room_prior_where_it_is_not_trained(monkeypatch, tmp_path):
    monkeypatch.setattr(named, "ROOM", tmp_path / "room")
    with pytest.raises(InputError, match=r"the room prior is not in .*: train it"):
        load_prior("room")
