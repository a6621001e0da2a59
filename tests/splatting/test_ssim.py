"""Structural similarity against float64 NumPy, torch's convolution and kornia."""

import numpy as np
import pytest
import torch

from diga3d_warp.splatting.ssim import ssim

SIZES = [(48, 64), (29, 37), (7, 131), (3, 5), (1, 1)]


def pair(height: int, width: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """A random image, smooth in places, and a noisy copy."""
    random = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(0, 3, width), np.linspace(0, 2, height))
    image = 0.5 + 0.4 * np.sin(x[..., None] * [3, 5, 7] + y[..., None] * [2, 1, 4])
    image[:, : width // 2] = random.uniform(0, 1, (height, width // 2, 3))
    target = np.clip(image + random.normal(0, 0.1, image.shape), 0, 1)
    return torch.tensor(image, dtype=torch.float32), torch.tensor(target, dtype=torch.float32)


def window() -> np.ndarray:
    weights = np.exp(-(np.arange(-5, 6) ** 2) / (2 * 1.5**2))
    return np.outer(weights, weights) / weights.sum() ** 2


def numpy_ssim(image: np.ndarray, target: np.ndarray) -> np.ndarray:
    height, width, _ = image.shape
    weights = window()

    def blur(values: np.ndarray) -> np.ndarray:
        padded = np.pad(values, ((5, 5), (5, 5), (0, 0)))
        return sum(
            weights[i, j] * padded[i : i + height, j : j + width] for i in range(11) for j in range(11)
        )

    mx, my = blur(image), blur(target)
    vx, vy, cxy = blur(image**2) - mx**2, blur(target**2) - my**2, blur(image * target) - mx * my
    return (2 * mx * my + 1e-4) * (2 * cxy + 9e-4) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4))


def torch_ssim(image: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """The plain form of 3DGS, in the precision of its input."""
    kernel = torch.as_tensor(window(), dtype=image.dtype).expand(3, 1, 11, 11)

    def blur(values: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.conv2d(values.permute(2, 0, 1)[None], kernel, padding=5, groups=3)

    mx, my = blur(image), blur(target)
    vx, vy, cxy = blur(image**2) - mx**2, blur(target**2) - my**2, blur(image * target) - mx * my
    value = (2 * mx * my + 1e-4) * (2 * cxy + 9e-4) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4))
    return value[0].permute(1, 2, 0)


@pytest.mark.parametrize("height,width", SIZES)
def test_map_agrees_with_float64(height, width):
    image, target = pair(height, width)
    found = ssim(image, target, reduce=False).numpy()
    expected = numpy_ssim(image.double().numpy(), target.double().numpy())
    np.testing.assert_allclose(found, expected, atol=1e-4)
    assert expected.min() < 0.99


@pytest.mark.parametrize("height,width", SIZES)
def test_gradient_agrees_with_autograd_of_the_plain_form(height, width):
    image, target = pair(height, width)
    weights = torch.rand(image.shape, generator=torch.Generator().manual_seed(1))
    image.requires_grad_()
    (ssim(image, target, reduce=False) * weights).sum().backward()
    double = image.detach().double().requires_grad_()
    (torch_ssim(double, target.double()) * weights).sum().backward()
    scale = double.grad.abs().max()
    assert scale > 0.01
    torch.testing.assert_close(image.grad.double() / scale, double.grad / scale, atol=1e-4, rtol=0)


def test_mean_is_that_of_the_map_and_so_is_its_gradient():
    image, target = pair(29, 37)
    first, second = image.clone().requires_grad_(), image.clone().requires_grad_()
    mean = ssim(first, target)
    assert mean.shape == ()
    assert mean.item() == pytest.approx(ssim(image, target, reduce=False).mean().item(), abs=1e-6)
    mean.backward()
    torch_ssim(second, target).mean().backward()
    torch.testing.assert_close(first.grad, second.grad, atol=1e-6, rtol=1e-3)


def test_agrees_with_kornia_inside_the_image():
    import kornia

    image, target = pair(48, 64)
    found = ssim(image, target, reduce=False)
    expected = kornia.metrics.ssim(image.permute(2, 0, 1)[None], target.permute(2, 0, 1)[None], 11)
    inside = (slice(5, -5), slice(5, -5))  # kornia mirrors at the border, 3DGS pads with zeros
    torch.testing.assert_close(found[inside], expected[0].permute(1, 2, 0)[inside], atol=1e-3, rtol=0)


def test_an_image_is_like_itself():
    image, _ = pair(29, 37)
    image.requires_grad_()
    mean = ssim(image, image.detach())
    mean.backward()
    assert mean.item() == pytest.approx(1.0, abs=1e-6)
    assert image.grad.abs().max() < 1e-6


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_flat_images_give_finite_results(value):
    image = torch.full((20, 30, 3), value, requires_grad=True)
    mean = ssim(image, torch.full((20, 30, 3), 1.0 - value))
    mean.backward()
    assert 0.0 <= mean.item() < 0.1
    assert image.grad.isfinite().all()


def test_bits_do_not_depend_on_the_number_of_threads(threads):
    image, target = pair(64, 300)
    results = []
    for count in (1, 2, 3):
        threads(count)
        leaf = image.clone().requires_grad_()
        values = ssim(leaf, target, reduce=False)
        values.square().sum().backward()
        results.append((values.detach(), leaf.grad))
    for values, gradient in results[1:]:
        assert torch.equal(values, results[0][0])
        assert torch.equal(gradient, results[0][1])


def test_wrong_shapes_are_refused():
    with pytest.raises(ValueError, match=r"one shape \(H, W, 3\)"):
        ssim(torch.zeros(4, 5, 3), torch.zeros(5, 4, 3))
    with pytest.raises(ValueError, match=r"one shape \(H, W, 3\)"):
        ssim(torch.zeros(4, 5), torch.zeros(4, 5))
