"""What suits a prior."""

from diga3d_warp.pipelines.method import PAPER, WARPED, usual_method
from diga3d_warp.priors.classical import ClassicalPrior


def test_a_prior_without_noise_estimates_carries_the_fill():
    assert usual_method(ClassicalPrior()) == WARPED


def test_the_manifest_tells_the_switches():
    assert PAPER.summary() == {
        "references": 3, "selection": "kmeans", "propagation": "attention", "inversion": None, "tg_sds": True,
        "surfaces": True,
    }  # fmt: skip
    assert WARPED.summary()["tg_sds"] is False
