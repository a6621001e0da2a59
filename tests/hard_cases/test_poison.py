"""Gaussians that hold NaN, infinity or absurd numbers: they vanish, and the others never notice."""

import pytest
import torch

from poison import FIELDS, check, rendered
from scenes import camera_at, random_gaussians

COUNT = 12
CAMERA = camera_at("none", 21, 17)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 1e38, -1e38])
@pytest.mark.parametrize("number", [0, -1])
@pytest.mark.parametrize("field", FIELDS)
def test_a_poisoned_gaussian_changes_nothing_for_the_others(field, number, value):
    """Image and gradients are, to the bit, those of the scene in which it is behind the camera.

    Broken harmonics are black instead, and an infinite logit, which converters write, is an opacity of 1.
    """
    gaussians = random_gaussians(COUNT)
    victim = 4
    getattr(gaussians, field)[victim].view(-1)[number] = value
    out, leaves = rendered(gaussians, CAMERA)
    check(out, leaves)
    clean = gaussians.detached()
    if field == "sh":
        clean.sh[victim] = 0.0
        clean.sh[victim, 0] = -100.0
    elif field == "opacity_logits" and value > 0:
        clean.opacity_logits[victim] = 200.0
    else:
        assert out.projection.extents[victim, 0] == 0
        for name, tensor in random_gaussians(COUNT).named():
            getattr(clean, name)[victim] = tensor[victim]
        clean.means[victim] = torch.as_tensor(CAMERA.center) - CAMERA.world_to_camera[2, :3]
    reference, others = rendered(clean, CAMERA)
    assert reference.alpha.max() > 0.5
    assert torch.equal(out.color, reference.color)
    for name, leaf in leaves.items():
        assert torch.equal(leaf.grad, others[name].grad), name
