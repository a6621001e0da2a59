"""Gaussians that hold NaN, infinity or absurd numbers: they vanish, and the others never notice."""

import pytest
import torch

from poison import FIELDS, SHARED, check, rendered
from scenes import camera_at, random_gaussians

COUNT = 12
CAMERA = camera_at("none", 21, 17)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 1e38, -1e38])
@pytest.mark.parametrize("field", FIELDS)
def test_a_poisoned_gaussian_changes_nothing_for_the_others(field, value):
    """Image and gradients are those of the scene without it.

    Broken harmonics are black instead, and an infinite logit, which converters write, is an opacity of 1.
    """
    gaussians = random_gaussians(COUNT)
    victim = 4
    getattr(gaussians, field)[victim].view(-1)[-1] = value
    out, leaves = rendered(gaussians, CAMERA)
    check(out, leaves)
    kept = torch.arange(COUNT) != victim
    if field == "sh":
        kept[victim] = True
        clean = gaussians.detached()
        clean.sh[victim] = 0.0
        clean.sh[victim, 0] = -100.0
    elif field == "opacity_logits" and value > 0:
        kept[victim] = True
        clean = gaussians.detached()
        clean.opacity_logits[victim] = 200.0
    else:
        assert out.projection.extents[victim, 0] == 0
        clean = gaussians.select(kept)
    reference, others = rendered(clean, CAMERA)
    assert reference.alpha.max() > 0.5
    assert torch.equal(out.color, reference.color)
    for name, leaf in leaves.items():
        found = leaf.grad if name in SHARED else leaf.grad[kept]
        assert torch.equal(found, others[name].grad), name
