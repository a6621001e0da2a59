"""What a user may choose, and what is refused."""

import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.pipelines.choices import Choices
from diga3d_warp.pipelines.method import PAPER, WARPED, Method, usual_method
from diga3d_warp.priors.classical import ClassicalPrior
from diga3d_warp.priors.exemplar.prior import ExemplarPrior
from tiny_diffusion import write_checkpoint


def test_a_prior_without_noise_estimates_warps_the_fill():
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


@pytest.mark.parametrize(
    ("choices", "said"),
    [
        ({"steps": 20}, "--steps: prior exemplar is no network"),
        ({"guidance": 3.0, "ip_adapter": "a.safetensors"}, "--guidance and --ip-adapter: prior exemplar is"),
        ({"afp_weight": 0.3}, "--afp-weight: only --propagation attention reads it"),
        ({"inversion": "fill"}, "--inversion: --propagation warp samples no view"),
        ({"sds_weight": 0.1}, "--sds-weight: without score distillation nothing reads it"),
        ({"edges_scale": 0.0}, "--edges-scale: without score distillation"),
        ({"propagation": "attention", "inversion": "photograph"}, "only redraws details"),
    ],
)
def test_an_option_that_nothing_would_read_is_refused(choices, said):
    """Zero is a choice, too."""
    chosen = Choices(**choices)
    with pytest.raises(InputError, match=said):
        chosen.choose_method(chosen.load_prior("remove"))


def test_a_prior_that_is_given_has_its_own_settings():
    with pytest.raises(InputError, match="--guidance: a prior that is given has its own"):
        Choices(prior=ExemplarPrior(), guidance=2.0).load_prior("remove")


def test_weights_reach_the_method_and_the_network(tmp_path):
    folder = str(write_checkpoint(tmp_path / "sd"))
    chosen = Choices(
        prior=folder, steps=7, guidance=2.5, afp_weight=0.2, sds_weight=0.01,
        edges_scale=0.3, depth_scale=0.0, inversion="fill",
    )  # fmt: skip
    prior = chosen.load_prior("remove", "bare boards")
    method = chosen.choose_method(prior)
    assert (prior.sampling.steps, prior.guidance.scale) == (7, 2.5)
    assert method.sampling_for(prior).steps == 7
    assert (method.afp_weight, method.distillation.weight, method.inversion) == (0.2, 0.01, "fill")
    assert (method.scales.edges, method.scales.depth) == (0.3, 0.0)
    plain = Choices(prior=folder).load_prior("remove")
    assert not torch.equal(prior.guidance.prompts.positive, plain.guidance.prompts.positive)
    assert Choices().choose_method(ExemplarPrior()).scales == PAPER.scales


def test_controls_without_score_distillation():
    """A change of material follows them while it repaints."""
    chosen = Choices(tg_sds=False, edges_scale=0.1, propagation="attention")
    assert chosen.choose_method(ExemplarPrior(), controlled=True).scales.edges == 0.1
