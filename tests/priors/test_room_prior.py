"""The room prior of the repository in rooms that it was never trained on: it has learned something."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from training.evaluate import Case, cases
from training.recipe import RECIPE
from training.store import Store
from training.windows import open_windows, render_rooms

from diga3d_warp.evaluation.metrics import psnr
from diga3d_warp.priors.classical import mean_color_fill
from diga3d_warp.priors.conditioning import Guidance, Prompts
from diga3d_warp.priors.inversion import invert
from diga3d_warp.priors.named import ROOM, load_prior
from diga3d_warp.priors.sampling import ViewLatents, initial_noise, sample_views
from diga3d_warp.priors.settings import AFP_WEIGHT, SamplingSettings
from diga3d_warp.priors.views import inpaint_views

HELD_OUT = replace(RECIPE.data, tested_seed=9_043, windows=4, cameras=4)
"""A corner, which is quick to light."""

QUICK = SamplingSettings(steps=10)


@pytest.fixture(scope="module")
def windows(tmp_path_factory) -> Store:
    folder = tmp_path_factory.mktemp("rooms")
    render_rooms(folder, HELD_OUT, 1, "tested")
    return open_windows(folder, HELD_OUT, "tested")


@pytest.fixture(scope="module")
def prior():
    return load_prior("room")


@pytest.fixture(scope="module")
def case(windows) -> Case:
    return cases(windows, 4)[0]


def filled(prior, case: Case, prompt: str, purpose: str = "replace", scale: float = 4.0) -> torch.Tensor:
    guidance = Guidance(prior.encode_prompts(prompt, "", purpose), scale)
    return next(inpaint_views(prior, [case.image], [case.mask], guidance, QUICK))


def test_it_is_small_enough_for_the_repository():
    size = sum(path.stat().st_size for path in ROOM.rglob("*") if path.is_file())
    assert 1e6 < size < 26e6


def test_without_a_prompt_it_continues_the_room(prior, windows):
    """Nearer to the truth than the mean colour around, and with detail, which that has not."""
    gains, details = [], []
    for case in cases(windows, 4):
        found = filled(prior, case, "", "remove", 1.0)
        assert torch.equal(found[~case.mask], case.image[~case.mask])
        mean = mean_color_fill(case.image, case.mask)
        gains.append(psnr(found, case.truth, case.mask) - psnr(mean, case.truth, case.mask))
        details.append(float(found[case.mask].std() / case.truth[case.mask].std()))
    assert np.mean(gains) > 0.5
    assert np.median(details) > 0.5


def test_the_prompt_decides_the_colour(prior, case):
    red, green = (filled(prior, case, f"a {color} ball")[case.mask].mean(dim=0) for color in ("red", "green"))
    assert red[0] - red[1] > 0.1 and green[1] - green[0] > 0.05
    assert float((red - green).abs().max()) > 0.15


@torch.no_grad()
def test_inversion_and_sampling_give_the_image_back(prior, case):
    """What edits start from: without guidance, DDIM runs the same way back."""
    text = prior.encode_prompts("", "", "remove").positive
    cond = prior.conditioning(case.truth[None], torch.ones(1, *case.mask.shape, dtype=torch.bool))
    clean = prior.encode_image(case.truth[None])
    settings = SamplingSettings(steps=20, afp_weight=0.0)
    errors = []
    for noise in (invert(prior, clean, text, cond, steps=20), initial_noise(clean.shape, 0)):
        found = sample_views(prior, ViewLatents(noise, cond), Guidance(Prompts(text, text), 1.0), settings)
        errors.append(psnr(prior.decode_latent(found)[0], prior.decode_latent(clean)[0]))
    assert errors[0] > 30.0 and errors[0] > errors[1] + 10.0, errors


def test_attention_propagation_makes_views_agree(prior, windows):
    """On a ball of any colour, in the same place shifted: noise stays where it is, so that fills differ."""
    guidance, apart = Guidance(prior.encode_prompts("a ball", "", "replace"), 2.0), {0.0: [], AFP_WEIGHT: []}
    for case in cases(windows, 3):
        shifts = (0, 12, -20)
        images = [torch.roll(case.image, shift, 1) for shift in shifts]
        masks = [torch.roll(case.mask, shift, 1) for shift in shifts]
        for weight, found in apart.items():
            settings = replace(QUICK, afp_weight=weight)
            views = inpaint_views(prior, images, masks, guidance, settings, references=[0])
            first, *others = (torch.roll(view, -shift, 1) for view, shift in zip(views, shifts, strict=True))
            found += [float((view - first)[case.mask].abs().mean()) for view in others]
    assert np.mean(apart[0.0]) > 0.02
    assert np.mean(apart[AFP_WEIGHT]) < 0.9 * np.mean(apart[0.0])
