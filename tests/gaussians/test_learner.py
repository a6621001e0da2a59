"""Learning: what density control knows of the images."""

from __future__ import annotations

import torch

from diga3d_warp.gaussians import learner as learning
from diga3d_warp.gaussians.density import DensitySettings
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.gaussians.learner import Fitting, GaussianLearner
from scenes import random_gaussians

SETTINGS = FitSettings(iterations=100, budget=60, density=DensitySettings(interval=20))
IMAGES, COUNT = 6, 40


def learner() -> GaussianLearner:
    fitting = Fitting(SETTINGS, 1.0, IMAGES, None, torch.Generator().manual_seed(0))
    return GaussianLearner(random_gaussians(COUNT, seed=8), fitting)


def test_pulls_are_means_over_the_images_that_show_a_gaussian(monkeypatch):
    """Over all images, a gaussian that few of them show would seem to need no company."""
    pulls, mine = [], learner()

    def watch(optimiser, wanted, pull, *others):
        pulls.append(pull)
        return torch.zeros(0, dtype=torch.int64)

    monkeypatch.setattr(learning, "relocate_and_grow", watch)
    for shown in ((), range(10)):
        visible = torch.zeros(COUNT, dtype=torch.bool)
        visible[list(shown)] = True
        mine.note(torch.where(visible, 3.0, 0.0), visible, 0)
    mine.control_density(20, 0.2, 0.0)
    assert pulls[0].tolist() == [3.0] * 10 + [0.0] * (COUNT - 10)


def test_no_gaussian_counts_as_unseen_before_every_image_had_its_turn():
    mine = learner()
    for iteration in (0, 5, 11):
        assert not mine.unseen(iteration).any()
    assert mine.unseen(12).all()
