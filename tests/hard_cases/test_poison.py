"""Gaussians that hold NaN, infinity or absurd numbers: they vanish, and the others never notice."""

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from diga3d_warp.config import SPLATTING
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.splatting.render import Rendering, render
from scenes import LENSES, camera_at, random_gaussians

COUNT = 12
POISON = [
    float("nan"), float("inf"), -float("inf"), 0.0, -0.0, 1e-45, -1e-40, 1e-38, 1e38, -1e38, 3.4e38,
    0.01, 1 / 255, 16.0, -16.0, 1e6, -1e6,
]  # fmt: skip
FIELDS = {"means": 3, "log_scales": 3, "quaternions": 4, "opacity_logits": 1, "sh": 48}


def rendered(gaussians: Gaussians, lens: str = "none") -> tuple[Rendering, dict[str, torch.Tensor]]:
    """A rendering after its backward pass, and the leaves that hold the gradients."""
    leaves = gaussians.detached().requires_grad_()
    camera = camera_at(lens, 21, 17)
    pose = camera.world_to_camera.clone().requires_grad_()
    out = render(leaves, camera.with_pose(pose), background=(0.1, 0.2, 0.3))
    weights = torch.randn(out.color.shape, generator=torch.Generator().manual_seed(1))
    ((out.color * weights).sum() + (out.depth * weights[..., 0]).sum() + out.alpha.sum()).backward()
    return out, {**dict(leaves.named()), "pose": pose}


def check(out: Rendering, leaves: dict[str, torch.Tensor]) -> None:
    assert out.color.isfinite().all() and out.alpha.isfinite().all() and out.depth.isfinite().all()
    assert out.color.min() >= 0 and out.color.max() <= SPLATTING.color_max
    assert out.alpha.min() >= 0 and out.alpha.max() <= 1
    culled = out.projection.extents[:, 0] == 0
    for part in out.projection[:5]:
        assert part.isfinite().all()
        assert not part[culled].any()
    for name, leaf in leaves.items():
        assert leaf.grad.isfinite().all(), name
        if name != "pose":
            assert not leaf.grad[culled].any(), name


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 1e38, -1e38])
@pytest.mark.parametrize("field", FIELDS)
def test_a_poisoned_gaussian_changes_nothing_for_the_others(field, value):
    """Image and gradients are those of the scene without it.

    Broken harmonics are black instead, and an infinite logit, which converters write, is an opacity of 1.
    """
    gaussians = random_gaussians(COUNT)
    victim = 4
    getattr(gaussians, field)[victim].view(-1)[-1] = value
    out, leaves = rendered(gaussians)
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
    reference, others = rendered(clean)
    assert reference.alpha.max() > 0.5
    assert torch.equal(out.color, reference.color)
    for name, leaf in leaves.items():
        found = leaf.grad if name == "pose" else leaf.grad[kept]
        assert torch.equal(found, others[name].grad), name


@st.composite
def pokes(draw) -> list[tuple[int, str, int, float]]:
    """Numbers of a scene to overwrite: row, field, component, value."""
    chosen = []
    for _ in range(draw(st.integers(1, 6))):
        field = draw(st.sampled_from(sorted(FIELDS)))
        component = draw(st.integers(0, FIELDS[field] - 1))
        chosen.append((draw(st.integers(0, COUNT - 1)), field, component, draw(st.sampled_from(POISON))))
    return chosen


@settings(max_examples=80, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(pokes(), st.sampled_from(sorted(LENSES)), st.integers(0, 3))
def test_fuzz(changes, lens, seed):
    gaussians = random_gaussians(COUNT, seed=seed)
    for row, field, component, value in changes:
        getattr(gaussians, field)[row].view(-1)[component] = value
    check(*rendered(gaussians, lens))


@settings(max_examples=30, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(st.lists(st.sampled_from(POISON), min_size=14, max_size=14))
def test_fuzz_every_number_of_a_gaussian(values):
    gaussians = random_gaussians(3)
    gaussians.means[1] = torch.tensor(values[:3])
    gaussians.log_scales[1] = torch.tensor(values[3:6])
    gaussians.quaternions[1] = torch.tensor(values[6:10])
    gaussians.opacity_logits[1] = values[10]
    gaussians.sh[1, :] = torch.tensor(values[11:14])
    check(*rendered(gaussians))
