"""Filling views through a diffusion prior: sizes, pasting back, starting points, errors."""

import numpy as np
import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.priors.conditioning import Guidance, Prompts
from diga3d_warp.priors.settings import SamplingSettings
from diga3d_warp.priors.views import ViewControl, fill_one, inpaint_views, resize_masks
from gaussian_prior import GaussianPrior

PLAIN = Guidance(Prompts(0.4, 0.0), scale=1.0)
SETTINGS = SamplingSettings(steps=5, batch=2)


@pytest.fixture
def images():
    return list(torch.rand(4, 12, 20, 3, generator=torch.Generator().manual_seed(1)))


@pytest.fixture
def masks():
    masks = torch.zeros(4, 12, 20, dtype=torch.bool)
    for k in range(4):
        masks[k, 3:9, k : k + 7] = True
    return list(masks)


@pytest.mark.parametrize("factor", [1, 2])
def test_masked_pixels_are_invented_and_the_others_are_those_given(images, masks, factor):
    prior = GaussianPrior(factor=factor, attention=0.1)
    filled = list(inpaint_views(prior, images, masks, PLAIN, SETTINGS, references=[1]))
    assert len(filled) == 4
    for image, mask, result in zip(images, masks, filled, strict=True):
        assert torch.equal(result[~mask], image[~mask])
        assert abs(float(result[mask].mean()) - 0.7) < 0.1
        assert float(result[mask].std()) > 0.02
        assert float(result.min()) >= 0.0 and float(result.max()) <= 1.0


def test_fill_is_the_same_bytes_for_a_seed(images, masks):
    prior = GaussianPrior()
    first, again, other = (
        fill_one(prior, images[0], masks[0], PLAIN, SETTINGS, seed=seed) for seed in (1, 1, 2)
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_an_empty_mask_changes_nothing(images):
    assert torch.equal(
        fill_one(GaussianPrior(), images[0], torch.zeros(12, 20, dtype=torch.bool), PLAIN), images[0]
    )


def test_settled_references_stay_as_they_are(images, masks):
    """They leave what they show at each timestep, as noisy as the other views are then."""
    prior = GaussianPrior(attention=0.3)
    free, kept = (
        list(inpaint_views(prior, images, masks, PLAIN, SETTINGS, references=[0], inpainted=inpainted))
        for inpainted in (False, True)
    )
    torch.testing.assert_close(kept[0], images[0])
    assert (free[0] - images[0]).abs().max() > 0.05
    assert not torch.equal(kept[1], free[1]), "what the reference shows is read by the other view"
    torch.testing.assert_close(kept[1][~masks[1]], images[1][~masks[1]])


def test_the_others_are_told_what_inpainted_references_show(images, masks):
    """The paper's I_p: embedded once, given to the positive half of all views."""
    prior, given = GaussianPrior(), []
    exact = prior.predict_noise
    prior.embed_images = lambda shown: shown.mean((0, 1, 2))

    def watch(z, t, text, cond, controls=(), image_embeds=None):
        given.append((text, image_embeds))
        return exact(z, t, text, cond, controls)

    prior.predict_noise = watch
    guided = Guidance(Prompts(0.4, 0.0), scale=2.0)
    list(inpaint_views(prior, images, masks, guided, SETTINGS, references=[0, 2], inpainted=True))
    expected = torch.stack([images[0], images[2]]).mean((0, 1, 2))
    positive = [embeds for text, embeds in given if text == 0.4]
    assert positive and all(torch.equal(embeds, expected) for embeds in positive)
    assert {embeds for text, embeds in given if text == 0.0} == {None}
    given.clear()
    list(inpaint_views(prior, images, masks, guided, SETTINGS, references=[0]))
    assert {embeds for _, embeds in given} == {None}, "nothing is inpainted yet"


def test_a_fill_is_made_within_a_window_around_its_mask():
    """A prior of a fixed size is shown a small hole enlarged, and the rest of the image stays."""

    class Square(GaussianPrior):
        def native_size(self, height, width):
            return 16, 16

    prior, shown = Square(), []
    exact = prior.conditioning
    prior.conditioning = lambda images, masks: (
        shown.append(float(masks.float().mean())) or exact(images, masks)
    )
    image = torch.rand(60, 80, 3, generator=torch.Generator().manual_seed(4))
    mask = torch.zeros(60, 80, dtype=torch.bool)
    mask[20:30, 50:60] = True
    filled = fill_one(prior, image, mask, PLAIN, SETTINGS)
    assert shown == [pytest.approx(100 / 256, abs=0.1)], "10 x 10 px of 16 x 16, not of 60 x 80"
    assert torch.equal(filled[~mask], image[~mask])
    assert abs(float(filled[mask].mean()) - 0.7) < 0.1


def test_sampling_starts_from_what_is_begun(images, masks):
    """And the known part is still that of the images."""
    weak = SamplingSettings(steps=10, strength=0.2)
    init_images = [torch.full_like(image, 0.9) for image in images]
    found = list(inpaint_views(GaussianPrior(), images, masks, PLAIN, weak, init_images=init_images))
    for image, mask, result in zip(images, masks, found, strict=True):
        assert torch.equal(result[~mask], image[~mask])
        assert float((result[mask] - 0.9).abs().mean()) < 0.15 < float((image[mask] - 0.9).abs().mean())


def test_from_inverted_images_an_unchanged_prompt_changes_little(images, masks):
    """And a changed one moves the image by as much as the means differ, keeping its structure."""
    prior, settings = GaussianPrior(), SamplingSettings(steps=100)
    images = [(0.5 + 0.2 * (image - 0.5)) for image in images]
    same = next(inpaint_views(prior, images, masks, PLAIN, settings, source=0.4))
    mask = masks[0]
    assert float((same - images[0])[mask].abs().max()) < 0.02
    changed = Guidance(Prompts(0.2, 0.0), scale=1.0)
    moved = next(inpaint_views(prior, images, masks, changed, settings, source=0.4))
    assert float((moved - images[0] + 0.1)[mask].abs().max()) < 0.02


def test_a_weaker_start_stays_nearer_to_the_image(images, masks):
    mask, moved = masks[0], []
    for strength in (0.2, 0.5, 1.0):
        settings = SamplingSettings(steps=20, strength=strength)
        filled = fill_one(GaussianPrior(), images[0], mask, PLAIN, settings)
        moved.append(float((filled - images[0])[mask].square().mean()))
    assert moved[0] < moved[1] < moved[2]


def test_controls_are_made_at_the_size_of_the_prior(images, masks):
    """A line that is resized is grey; edges that are found at the size have no grey."""
    prior = GaussianPrior(factor=2)
    pictures = [torch.full((12, 20, 3), 0.1) for _ in range(4)]
    for k, picture in enumerate(pictures):
        picture[:, 6 + 2 * k :] = 0.9
    controls = [ViewControl("edges", pictures, 0.8), ViewControl("depth", [p[..., 0] for p in pictures], 1.0)]
    seen = {}
    exact = prior.predict_noise

    def watch(z, t, text, cond, controls, image_embeds=None):
        for c in controls:
            assert tuple(c.image.shape[1:]) == (6, 10)
            seen.setdefault((c.kind, c.scale), []).append(c.image[0])
        return exact(z, t, text, cond, controls)

    prior.predict_noise = watch
    settings = SamplingSettings(steps=2, batch=1)
    list(inpaint_views(prior, images, masks, PLAIN, settings, controls=controls))
    edges, depth = (seen[key][-4:] for key in (("edges", 0.8), ("depth", 1.0)))
    assert all(set(image.unique().tolist()) == {0.0, 1.0} for image in edges)
    assert all((float(image.min()), float(image.max())) == (0.0, 1.0) for image in depth)
    places = [int(image[3].nonzero()[0]) for image in edges]
    assert np.diff(places).tolist() == [1, 1, 1], "each view its own"


def test_the_plan_is_said_before_sampling(images, masks):
    said = []
    filled = inpaint_views(
        GaussianPrior(),
        images,
        masks,
        PLAIN,
        SETTINGS,
        say=said.append,
        progress=lambda done: said.append(done),
    )
    next(filled)
    assert said[0].startswith("4 views, 0 of them references, 5 steps: 20 noise estimates")
    assert said[1:] == [1, 2, 3, 4, 5]


def test_a_mask_keeps_every_pixel_that_it_touched():
    mask = torch.zeros(1, 64, 64, dtype=torch.bool)
    mask[0, 17, 30] = True
    small = resize_masks(mask, (8, 8))
    assert small[0, 2, 3]
    assert int(small.sum()) <= 4


def test_input_that_does_not_fit(images, masks):
    with pytest.raises(InputError, match="numbers of images, masks and controls differ or are zero"):
        next(inpaint_views(GaussianPrior(), images, masks[:2], PLAIN))
    with pytest.raises(InputError, match="numbers of images, masks and controls differ or are zero"):
        next(inpaint_views(GaussianPrior(), [], [], PLAIN))
    with pytest.raises(InputError, match="the mask covers the whole image"):
        next(inpaint_views(GaussianPrior(), images, [torch.ones_like(m) for m in masks], PLAIN))
