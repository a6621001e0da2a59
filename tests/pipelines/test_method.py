"""What suits a prior, what a user may choose, and what is refused."""

import pytest

from diga3d_warp.errors import InputError
from diga3d_warp.pipelines.method import PAPER, WARPED, Choices, Method, usual_method
from diga3d_warp.priors.classical import ClassicalPrior
from diga3d_warp.priors.exemplar.prior import ExemplarPrior


def test_a_prior_without_noise_estimates_carries_the_fill():
    assert usual_method(ClassicalPrior()) == WARPED
    assert Choices(prior="classical").choose_method(ClassicalPrior()) == WARPED


@pytest.mark.parametrize("choices", [{"propagation": "attention"}, {"propagation": "none"}, {"tg_sds": True}])
def test_what_a_prior_cannot_do_is_refused(choices):
    with pytest.raises(InputError, match="prior classical estimates no noise: give it --propagation warp"):
        Choices(prior="classical", **choices).choose_method(ClassicalPrior())


def test_choices_win_over_what_suits():
    prior = ExemplarPrior()
    chosen = Choices(propagation="none", tg_sds=False, references=2, selection="random").choose_method(prior)
    assert chosen == Method(2, "random", "none", distillation=None)
    assert Choices(tg_sds=True).choose_method(prior).distillation is not None
    assert Choices().choose_method(prior) == usual_method(prior)


def test_a_negative_prompt_reaches_the_prior():
    assert Choices(negative="brick").load_prior("remove").guidance.scale > 1.0
    assert Choices().load_prior("remove").guidance.scale == 1.0
    with pytest.raises(InputError, match="10000 characters"):
        Choices(negative="x" * 10_000).load_prior("remove")


@pytest.mark.parametrize(
    ("name", "switches", "said"),
    [
        ("classical", {}, "prior classical reads no prompts: leave --negative out"),
        ("exemplar", {}, "--negative is heeded where prior exemplar estimates noise"),
        ("exemplar", {"propagation": "warp", "tg_sds": False}, "add --propagation attention or --tg-sds"),
    ],
)
def test_a_negative_prompt_that_nothing_would_read_is_refused(name, switches, said):
    choices = Choices(prior=name, negative="brick", **switches)
    with pytest.raises(InputError, match=said):
        choices.choose_method(choices.load_prior("remove"))


@pytest.mark.parametrize(
    "switches", [{"propagation": "attention"}, {"propagation": "none"}, {"tg_sds": True}]
)
def test_a_negative_prompt_that_noise_estimates_read(switches):
    choices = Choices(negative="brick", **switches)
    assert choices.choose_method(choices.load_prior("remove"))


def test_the_manifest_tells_the_switches():
    assert PAPER.summary() == {
        "references": 3, "selection": "kmeans", "propagation": "attention", "tg_sds": True,
        "surfaces": True,
    }  # fmt: skip
    assert WARPED.summary()["tg_sds"] is False
