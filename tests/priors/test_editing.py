"""Editing of many views on a prior whose estimates are exact: what changes, and who attends to whom."""

import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.priors.conditioning import Guidance, Prompts
from diga3d_warp.priors.editing import edit_views
from diga3d_warp.priors.settings import SamplingSettings
from diga3d_warp.priors.views import ViewControl
from gaussian_prior import GaussianPrior

SETTINGS = SamplingSettings(steps=6, batch=2)
BRIGHTER = Guidance(Prompts(0.2, 0.0), scale=1.0)


@pytest.fixture
def images():
    return list(0.4 + 0.2 * torch.rand(5, 40, 60, 3, generator=torch.Generator().manual_seed(1)))


@pytest.fixture
def masks():
    """The object moves to the right; the third view does not show it."""
    masks = torch.zeros(5, 40, 60, dtype=torch.bool)
    for k in (0, 1, 3, 4):
        masks[k, 12:22, 8 * k + 4 : 8 * k + 14] = True
    return list(masks)


def edited(images, masks, references, prior=None, **options):
    prior = prior or GaussianPrior(attention=0.05)
    return edit_views(prior, images, masks, BRIGHTER, SETTINGS, references=references, **options)


def test_the_masked_part_follows_the_prompt_and_the_rest_stays(images, masks):
    """The source prompt is 0 and the target 0.2: brighter by 0.1, with the structure that was there."""
    settings = SamplingSettings(steps=100)
    results = edit_views(GaussianPrior(), images, masks, BRIGHTER, settings, references=[0, 3])
    for image, mask, result in zip(images, masks, results, strict=True):
        assert torch.equal(result[~mask], image[~mask])
    assert torch.equal(results[2], images[2]), "does not show the object"
    for k in (0, 1, 3, 4):
        assert float((results[k] - images[k])[masks[k]].sub(0.1).abs().max()) < 0.02


def test_the_same_bytes_each_time(images, masks):
    first, again = (edited(images, masks, [0, 3]) for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))


def changed_by(images, masks, index, references):
    """Which views' edits depend on what a view shows."""
    others = list(images)
    others[index] = 1.0 - images[index]
    before, after = edited(images, masks, references), edited(others, masks, references)
    return {k for k in range(5) if k != index and not torch.equal(before[k][masks[k]], after[k][masks[k]])}


def test_who_attends_to_whom(images, masks):
    """The first reference stands for itself, the second sees the first, the others see both."""
    assert changed_by(images, masks, 0, [0, 3]) == {1, 3, 4}
    assert changed_by(images, masks, 3, [0, 3]) == {1, 4}
    assert changed_by(images, masks, 1, [0, 3]) == set()


def test_a_reference_that_does_not_show_the_object_is_refused(images, masks):
    """Whoever chose it has other views follow it, in the fine stage, too."""
    with pytest.raises(InputError, match=r"references \[2\] have no mask"):
        edited(images, masks, [0, 2])


class Square(GaussianPrior):
    """A prior that is shown squares of 16 px."""

    def native_size(self, height, width):
        return 16, 16


def test_controls_follow_the_windows(images, masks):
    prior = Square()
    seen = []
    exact = prior.predict_noise

    def watch(z, t, text, cond, controls, image_embeds=None):
        seen.extend((c.kind, tuple(c.image.shape[1:]) == tuple(z.shape[2:])) for c in controls)
        seen.append(float(controls[0].image.mean()))
        return exact(z, t, text, cond, controls)

    prior.predict_noise = watch
    depths = [torch.where(mask, 1.0, 2.0) for mask in masks]
    edited(images, masks, [0], prior, controls=[ViewControl("depth", depths, 0.8)])
    kinds = {each for each in seen if isinstance(each, tuple)}
    means = {round(each, 6) for each in seen if isinstance(each, float)}
    assert kinds == {("depth", True)}
    assert means == {round(100 / 256, 6)}, "masks of 10 x 10 in windows of 16 x 16"


def test_plan_and_progress_are_told(images, masks):
    said, steps = [], []
    edited(images, masks, [0, 3], say=said.append, progress=lambda done, total: steps.append((done, total)))
    assert [line.split(",")[0] for line in said] == ["1 views", "2 views", "4 views"]
    assert steps == [(k, 18) for k in range(1, 19)]


def test_an_object_that_shows_nowhere(images, masks):
    with pytest.raises(InputError, match="shows in no view"):
        edited(images, [torch.zeros_like(mask) for mask in masks], [0])


def test_depth_is_normalised_within_the_window(images, masks):
    """Something near at the image's border would leave all that a prior is shown at one grey."""
    prior, seen = GaussianPrior(), []
    exact = prior.predict_noise

    def watch(z, t, text, cond, controls, image_embeds=None):
        seen.extend((float(row.min()), float(row.max())) for row in controls[0].image)
        return exact(z, t, text, cond, controls)

    prior.predict_noise = watch
    depths = [torch.where(mask, 2.0, 3.0) for mask in masks]
    for depth in depths:
        depth[:2] = 0.01
    edited(images, masks, [0], prior, controls=[ViewControl("depth", depths, 1.0)])
    assert seen and set(seen) == {(0.0, 1.0)}


def test_a_view_of_nothing_but_the_object_is_edited_too(images, masks):
    """A close-up has nothing around its mask, but itself to start from, and references to attend to."""
    masks[1][:] = True
    results = edited(images, masks, [0, 3])
    assert results[1].isfinite().all() and not torch.equal(results[1], images[1])
    assert torch.equal(results[2], images[2])


def test_without_inversion_the_views_start_from_the_noise_of_a_seed(images, masks):
    first, again, other = (edited(images, masks, [0, 3], inverted=False, seed=seed) for seed in (1, 1, 2))
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    assert not torch.equal(first[1][masks[1]], other[1][masks[1]])
    settings = SamplingSettings(steps=30)
    moved, kept = (
        edit_views(GaussianPrior(), images, masks, BRIGHTER, settings, references=[0], inverted=inverted)[1]
        for inverted in (False, True)
    )
    far, near = (float((found - images[1])[masks[1]].sub(0.1).abs().mean()) for found in (moved, kept))
    assert far > 3.0 * near, "noise keeps nothing of what a view showed"
