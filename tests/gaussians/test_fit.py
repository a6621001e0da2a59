"""Fitting: it comes closer, the same seed gives the same bytes, also after a kill, and held rows stay."""

from __future__ import annotations

import os
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from diga3d_warp.config import Accuracy
from diga3d_warp.errors import InputError
from diga3d_warp.gaussians import fit as fitting
from diga3d_warp.gaussians.density import DensitySettings
from diga3d_warp.gaussians.fit import CURVE_INTERVAL, FitSettings, fit
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.target import Target
from diga3d_warp.scene.camera import Camera, look_at
from diga3d_warp.splatting.render import render
from scenes import random_gaussians

WIDTH, HEIGHT = 48, 32
SETTINGS = FitSettings(iterations=100, budget=60, density=DensitySettings(interval=20))


def cameras(count: int = 6) -> list[Camera]:
    around = np.linspace(0, 2 * np.pi, count, endpoint=False)
    poses = [look_at(3.0 * np.array([np.cos(a), np.sin(a), 0.3]), np.zeros(3)) for a in around]
    return [Camera(WIDTH, HEIGHT, 45.0, 45.0, 24.0, 16.0, torch.from_numpy(pose)) for pose in poses]


@pytest.fixture(scope="module")
def truth() -> Gaussians:
    gaussians = random_gaussians(40, seed=8, degree=1)
    gaussians.log_scales += 0.5
    return gaussians


@pytest.fixture(scope="module")
def targets(truth) -> list[Target]:
    made = []
    for camera in cameras():
        rendering = render(truth, camera)
        color = (rendering.color.clamp(0, 1) * 255).round().to(torch.uint8)
        assert color.float().std() > 30, "not blank"
        made.append(Target(camera, color))
    return made


@pytest.fixture(scope="module")
def start(truth) -> Gaussians:
    gaussians = truth.detached()
    random = torch.Generator().manual_seed(1)
    gaussians.means += 0.05 * torch.randn(40, 3, generator=random)
    gaussians.log_scales -= 0.3
    gaussians.opacity_logits[:] = 0.0
    gaussians.sh = torch.zeros(40, 4, 3)
    return gaussians


def psnr(gaussians: Gaussians, targets: list[Target]) -> float:
    errors = [((render(gaussians, t.camera).color.detach() - t.color) ** 2).mean() for t in targets]
    return float(-10 * torch.log10(torch.stack(errors).mean()))


def same(a: Gaussians, b: Gaussians) -> bool:
    return len(a) == len(b) and all(
        torch.equal(mine, theirs) for (_, mine), (_, theirs) in zip(a.named(), b.named(), strict=True)
    )


@pytest.fixture(scope="module")
def whole(start, targets):
    """The fit that nothing disturbed."""
    return fit(start, targets, 1.0, SETTINGS, seed=3)


def test_renderings_are_as_accurate_as_wanted(start, targets):
    few = replace(SETTINGS, iterations=3)
    standard = fit(start, targets, 1.0, few).gaussians
    draft = fit(start, targets, 1.0, replace(few, accuracy=Accuracy.DRAFT)).gaussians
    assert 0.0 < (draft.sh - standard.sh).abs().max() < 0.1


def test_the_fit_comes_closer(whole, start, targets):
    assert psnr(whole.gaussians, targets) > psnr(start, targets) + 6.0
    assert whole.curve[-1]["loss"] < 0.75 * whole.curve[0]["loss"]
    assert whole.curve[-1]["psnr"] > whole.curve[0]["psnr"] + 3.0
    assert [point["iteration"] for point in whole.curve] == [25, 50, 75, 100]
    assert whole.curve[-1]["gaussians"] == len(whole.gaussians) == SETTINGS.budget
    assert not any(tensor.requires_grad for _, tensor in whole.gaussians.named())


def test_the_same_seed_gives_the_same_bytes(whole, start, targets, threads):
    threads(1)
    again = fit(start, targets, 1.0, SETTINGS, seed=3)
    assert same(again.gaussians, whole.gaussians)
    assert again.curve == whole.curve
    threads(2)
    two = fit(start, targets, 1.0, SETTINGS, seed=3)
    assert same(two.gaussians, whole.gaussians), "also on another number of threads"


def test_another_seed_gives_other_bytes(whole, start, targets):
    assert not same(fit(start, targets, 1.0, SETTINGS, seed=4).gaussians, whole.gaussians)


class Stop(Exception):
    """Ends a fit from within."""


def stopped_at(step: int, monkeypatch, *arguments, **options) -> None:
    """Run a fit that saves a checkpoint after every step and breaks before `step`."""
    settings = replace(SETTINGS, checkpoint_seconds=-1.0)
    original = fitting._Fit.step

    def stop(self) -> None:
        if self.iteration == step:
            raise Stop
        original(self)

    monkeypatch.setattr(fitting._Fit, "step", stop)
    with pytest.raises(Stop):
        fit(*arguments, 1.0, settings, **options)
    monkeypatch.undo()


# In the coarse part, between a growth and its next step, in the middle of a round of images, near the end.
@pytest.mark.parametrize("step", [7, 21, 50, 99])
def test_an_interrupted_fit_ends_with_the_same_bytes(whole, start, targets, tmp_path, monkeypatch, step):
    checkpoint = tmp_path / "checkpoint.pt"
    stopped_at(step, monkeypatch, start, targets, seed=3, checkpoint=checkpoint)
    assert [file.name for file in tmp_path.iterdir()] == ["checkpoint.pt"]
    resumed = fit(start, targets, 1.0, SETTINGS, seed=3, checkpoint=checkpoint)
    assert same(resumed.gaussians, whole.gaussians)
    assert resumed.curve == whole.curve


def test_an_old_checkpoint_survives_a_kill_while_saving(whole, start, targets, tmp_path, monkeypatch):
    checkpoint = tmp_path / "checkpoint.pt"
    stopped_at(30, monkeypatch, start, targets, seed=3, checkpoint=checkpoint)
    before = checkpoint.read_bytes()

    def half(path: Path, data: bytes) -> None:
        with path.open("wb") as file:
            file.write(data[: len(data) // 2])
        raise Stop

    monkeypatch.setattr(Path, "write_bytes", half)
    with pytest.raises(Stop):
        fit(start, targets, 1.0, replace(SETTINGS, checkpoint_seconds=-1.0), seed=3, checkpoint=checkpoint)
    monkeypatch.undo()
    assert checkpoint.read_bytes() == before
    assert same(fit(start, targets, 1.0, SETTINGS, seed=3, checkpoint=checkpoint).gaussians, whole.gaussians)


def cut(checkpoint: Path) -> None:
    os.truncate(checkpoint, checkpoint.stat().st_size // 2)


def one_byte_flipped(checkpoint: Path) -> None:
    """In the largest tensor: between tensors there are gaps, whose bytes mean nothing."""
    data = bytearray(checkpoint.read_bytes())
    with zipfile.ZipFile(checkpoint) as archive:
        largest = archive.read(max(archive.infolist(), key=lambda entry: entry.file_size))
    data[data.index(largest) + len(largest) // 2] ^= 255
    checkpoint.write_bytes(data)


def of_another_seed(checkpoint: Path) -> None:
    state = torch.load(checkpoint, weights_only=True)
    torch.save({**state, "origin": "another"}, checkpoint)


def a_pickle(checkpoint: Path) -> None:
    checkpoint.write_bytes(b"cos\nsystem\n(S'exit 1'\ntR.")


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (cut, "damaged"),
        (one_byte_flipped, "damaged"),
        (of_another_seed, "of another fit"),
        (a_pickle, "damaged"),
        (lambda checkpoint: checkpoint.write_bytes(b""), "damaged"),
        (lambda checkpoint: torch.save([1, 2], checkpoint), "damaged"),
    ],
)
def test_an_unusable_checkpoint_is_noted_and_the_fit_begins_anew(
    whole, start, targets, tmp_path, monkeypatch, spoil, said
):
    checkpoint = tmp_path / "checkpoint.pt"
    stopped_at(30, monkeypatch, start, targets, seed=3, checkpoint=checkpoint)
    spoil(checkpoint)
    notes: list[str] = []
    again = fit(start, targets, 1.0, SETTINGS, seed=3, checkpoint=checkpoint, note=notes.append)
    assert notes == [f"{checkpoint} is {said}: that stage starts again"]
    assert same(again.gaussians, whole.gaussians)


def test_a_finished_fit_is_not_repeated(whole, start, targets, tmp_path, monkeypatch):
    checkpoint = tmp_path / "checkpoint.pt"
    fit(start, targets, 1.0, replace(SETTINGS, checkpoint_seconds=-1.0), seed=3, checkpoint=checkpoint)

    def step(self) -> None:
        raise AssertionError("another step")

    monkeypatch.setattr(fitting._Fit, "step", step)
    again = fit(start, targets, 1.0, SETTINGS, seed=3, checkpoint=checkpoint)
    assert same(again.gaussians, whole.gaussians)


def test_held_rows_keep_their_bits(start, targets):
    held = torch.arange(40) % 3 == 0
    result = fit(start, targets, 1.0, SETTINGS, held=held)
    assert len(result.gaussians) == SETTINGS.budget
    for (name, now), (_, then) in zip(result.gaussians.named(), start.named(), strict=True):
        assert torch.equal(now[:40][held], then[held]), name
        assert (now[:40][~held] != then[~held]).flatten(1).any() if now.ndim > 1 else True, name
    assert psnr(result.gaussians, targets) > psnr(start, targets) + 1.0


def test_untrusted_pixels_do_not_pull(start, targets):
    """Whatever colour stands at weight 0, the fit is the same."""
    weight = torch.ones(HEIGHT, WIDTH)
    weight[8:24, 12:36] = 0.0
    settings = replace(SETTINGS, iterations=15, coarse_part=0.0, ssim_weight=0.0)
    results = []
    for value in (0, 255):
        changed = []
        for target in targets:
            image = target.image.clone()
            image[8:24, 12:36] = value
            changed.append(replace(target, image=image, weight=weight))
        results.append(fit(start, changed, 1.0, settings).gaussians)
    assert same(*results)
    assert not same(results[0], fit(start, targets, 1.0, settings).gaussians)


def test_depth_pulls_gaussians_to_it():
    """Where one camera sees a single colour, only depth can tell how far the gaussians are."""
    camera = cameras(1)[0]
    steps = torch.linspace(-0.6, 0.6, 9)
    y, z = (axis.reshape(-1) for axis in torch.meshgrid(steps, steps[2:7], indexing="ij"))
    wall = random_gaussians(45, degree=0)
    wall.means = torch.stack([torch.zeros(45), y, z], dim=1)
    wall.log_scales[:], wall.opacity_logits[:], wall.sh[:] = -1.8, 3.0, 0.5
    rendering = render(wall, camera)
    image, depth = rendering.color.detach(), rendering.depth.detach()
    wanted = torch.where(rendering.alpha > 0.9, depth + 0.05, 0.0).detach()
    assert (wanted > 0.0).float().mean() > 0.1
    settings = FitSettings(
        iterations=60, budget=0, coarse_part=0.0, opacity_weight=0.0, scale_weight=0.0,
        density=DensitySettings(begin=2.0, end=0.0),
    )  # fmt: skip

    def distance(depth_weight: float) -> float:
        target = Target(camera, image, depth=wanted)
        result = fit(wall, [target], 10.0, replace(settings, depth_weight=depth_weight))
        after = render(result.gaussians, camera).depth
        return float((after - wanted)[wanted > 0.0].abs().mean())

    assert distance(0.0) == pytest.approx(0.05, abs=0.01)
    assert distance(1.0) < 0.03


@pytest.mark.parametrize(("first", "budget"), [(40, 40), (40, 10), (40, 77), (7, 131), (11, 60)])
def test_the_budget_is_met_and_nothing_is_dropped(targets, first, budget):
    settings = FitSettings(iterations=40, budget=budget, density=DensitySettings(interval=4))
    result = fit(random_gaussians(first), targets, 1.0, settings)
    assert len(result.gaussians) == max(first, budget)


def test_halved_targets_show_the_same_scene(truth, targets):
    target = replace(targets[0], weight=torch.ones(HEIGHT, WIDTH), depth=torch.ones(HEIGHT, WIDTH))
    small = target.halved()
    assert small.image.shape == (16, 24, 3) and small.image.dtype == torch.uint8
    assert (small.camera.width, small.camera.fx) == (24, 22.5)
    assert small.depth is None
    assert small.weight is not None and small.weight.eq(1.0).all()
    expected = target.color.reshape(16, 2, 24, 2, 3).mean(dim=(1, 3))
    torch.testing.assert_close(small.color, expected, atol=1 / 255, rtol=0)
    error = (render(truth, small.camera).color - small.color).abs()
    assert error.mean() < 0.04


def test_the_curve_is_the_mean_over_its_interval(start, targets, monkeypatch):
    losses: list[float] = []
    record = fitting._Fit._record

    def listen(self, loss, *others) -> None:
        losses.append(loss)
        record(self, loss, *others)

    monkeypatch.setattr(fitting._Fit, "_record", listen)
    result = fit(start, targets, 1.0, replace(SETTINGS, iterations=CURVE_INTERVAL + 5))
    assert len(result.curve) == 1
    assert result.curve[0]["loss"] == pytest.approx(np.mean(losses[:CURVE_INTERVAL]))


def test_a_guide_pulls_and_resumes_with_the_same_bytes(start, targets, tmp_path):
    """A guide draws random numbers; an interrupted fit goes on with the ones that were due."""
    done_parts = []

    def guide(image, done, generator):
        done_parts.append(done)
        return (
            5.0 * (image - torch.rand(3, generator=generator) * torch.tensor([1.0, 0.0, 0.0])).square().mean()
        )

    guided = [replace(target, guide=guide) for target in targets]
    settings = replace(SETTINGS, iterations=20, coarse_part=0.0)
    whole = fit(start, guided, 1.0, settings).gaussians
    assert done_parts == [k / 20 for k in range(20)]
    plain = fit(start, targets, 1.0, settings).gaussians
    red = [float(render(g, targets[0].camera).color[..., 1:].mean()) for g in (whole, plain)]
    assert red[0] < red[1] - 0.02

    file = tmp_path / "checkpoint.pt"
    stopped = fitting._Fit(start, guided, 1.0, settings, 0, None)
    for _ in range(7):
        stopped.step()
    stopped.save(file)
    resumed = fit(start, guided, 1.0, settings, checkpoint=file).gaussians
    assert torch.equal(resumed.means, whole.means)
    assert torch.equal(resumed.sh, whole.sh)


def test_a_guide_is_not_asked_about_coarse_images(start, targets):
    def guide(image, done, generator):
        assert image.shape == (HEIGHT, WIDTH, 3)
        return image.sum() * 0.0

    guided = [replace(target, guide=guide) for target in targets]
    fit(start, guided, 1.0, replace(SETTINGS, iterations=10, coarse_part=0.5))


@pytest.fixture(scope="module")
def with_outsiders(start) -> Gaussians:
    """The start, and ten gaussians more that lie before some of the cameras but in no image."""
    outsiders = random_gaussians(10, degree=1)
    outsiders.means += torch.tensor([0.0, 0.0, -20.0])
    both = start.joined(outsiders)
    shown = torch.zeros(50)
    ahead = torch.zeros(50)
    for camera in cameras():
        shown += render(both, camera).projection.visible
        ahead += (both.means @ camera.world_to_camera[2, :3].float() + camera.world_to_camera[2, 3]) > 0.1
    assert (shown[:40] > 0).sum() > 35 and not shown[40:].any() and ahead[40:].any()
    return both


def test_what_no_image_shows_keeps_its_bits(with_outsiders, targets):
    still = replace(SETTINGS, iterations=20, density=DensitySettings(begin=2.0, end=0.0))
    result = fit(with_outsiders, targets, 1.0, still).gaussians
    for (name, now), (_, then) in zip(result.named(), with_outsiders.named(), strict=True):
        assert torch.equal(now[40:], then[40:]), name
        assert not torch.equal(now[:40], then[:40]), name


@pytest.mark.parametrize("held_too", [False, True])
def test_what_no_image_ever_shows_is_moved_to_where_images_pull(with_outsiders, targets, held_too):
    """Regularisers do not reach it, and so it would never fade; held rows stay where they are."""
    settings = replace(SETTINGS, budget=50)
    held = torch.arange(50) >= (45 if held_too else 50)
    result = fit(with_outsiders, targets, 1.0, settings, held=held).gaussians
    assert len(result) == 50
    assert (result.means[40:][~held[40:]].norm(dim=1) < 5.0).all()
    assert torch.equal(result.means[held], with_outsiders.means[held])
    visible = torch.stack([render(result, camera).projection.visible for camera in cameras()]).any(dim=0)
    assert visible[~held].all()


class Poison(torch.autograd.Function):
    """A loss of zero whose gradient is not a number."""

    @staticmethod
    def forward(ctx, image):
        ctx.save_for_backward(image)
        return image.new_zeros(())

    @staticmethod
    def backward(ctx, _):
        return torch.full_like(ctx.saved_tensors[0], torch.nan)


def once(iteration: int, broken):
    """A guide that breaks at an iteration of `POISONED`."""

    def guide(image, done, generator):
        return broken(image) if round(done * POISONED.iterations) == iteration else image.sum() * 0.0

    return guide


POISONED = replace(SETTINGS, iterations=30, coarse_part=0.0, depth_weight=1.0, checkpoint_seconds=-1.0)
NAN = torch.full((HEIGHT, WIDTH), torch.nan)


@pytest.mark.parametrize(
    ("term", "change", "iteration"),
    [
        ("photometric loss", {"image": NAN[..., None].expand(-1, -1, 3)}, 1),
        ("photometric loss", {"weight": NAN}, 1),
        ("guide", {"guide": once(9, lambda image: image.sum() * torch.inf)}, 10),
        ("gradient of the guide", {"guide": once(9, Poison.apply)}, 10),
    ],
    ids=["image", "weight", "guide", "gradient of a guide"],
)
def test_a_loss_that_is_not_finite_stops_the_fit(start, targets, tmp_path, term, change, iteration):
    checkpoint = tmp_path / "checkpoint.pt"
    broken = [replace(target, **change) for target in targets]
    wanted = rf"refit: the {term} of image \d of 6 is (nan|inf|-inf) at iteration {iteration} of 30: \w+"
    with pytest.raises(InputError, match=wanted):
        fit(start, broken, 1.0, POISONED, checkpoint=checkpoint, label="refit")
    assert checkpoint.exists() == (iteration > 1)
    if iteration > 1:
        state = torch.load(checkpoint)
        assert state["iteration"] == iteration - 1
        assert all(tensor.isfinite().all() for tensor in state["learner"]["optimiser"]["tensors"].values())
        # Mended, the fit goes on from there.
        assert len(fit(start, targets, 1.0, POISONED, checkpoint=checkpoint).gaussians) == SETTINGS.budget


def test_a_gradient_that_is_not_finite_stops_the_fit(start, targets, monkeypatch):
    def loss(color, *others):
        return Poison.apply(color)

    monkeypatch.setattr(fitting, "photometric_loss", loss)
    with pytest.raises(InputError, match=r"the gradient of image \d of 6 is nan at iteration 1"):
        fit(start, targets, 1.0, SETTINGS)
