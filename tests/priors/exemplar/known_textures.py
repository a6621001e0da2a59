"""Images whose missing part is known from their structure."""

import numpy as np
import torch
from scipy.ndimage import gaussian_filter

HEIGHT, WIDTH = 96, 128


def grid() -> tuple[np.ndarray, np.ndarray]:
    return np.mgrid[:HEIGHT, :WIDTH].astype(float)


def stripes() -> torch.Tensor:
    """Slanted stripes of two colours, 11 px wide."""
    rows, columns = grid()
    wave = (np.sin((columns + 0.4 * rows) * 2 * np.pi / 22) > 0)[..., None]
    return _image(np.where(wave, [0.8, 0.6, 0.2], [0.2, 0.3, 0.6]))


def bricks() -> torch.Tensor:
    """Red bricks of 10 x 20 px in running bond with light joints."""
    rows, columns = grid()
    course = rows // 10
    along = columns + 10 * (course % 2)
    joint = (rows % 10 < 2) | (along % 20 < 2)
    return _image(np.where(joint[..., None], [0.8, 0.78, 0.7], [0.6, 0.25, 0.2]))


def boundary() -> torch.Tensor:
    """Dark grass below light gravel, both rough, with a level edge between."""
    rows, _ = grid()
    random = np.random.default_rng(1)
    fine = random.standard_normal((HEIGHT, WIDTH, 1))
    coarse = 2.5 * gaussian_filter(random.standard_normal((HEIGHT, WIDTH, 1)), (1.5, 1.5, 0))
    below = (rows > 50)[..., None]
    return _image(np.where(below, [0.2, 0.4, 0.15] + 0.1 * coarse, [0.7, 0.68, 0.65] + 0.05 * fine))


def ground() -> torch.Tensor:
    """Boards that lie across, lit from the right: colours change slowly along them."""
    rows, columns = grid()
    light = 0.35 + 0.5 * columns / WIDTH
    board = np.where((rows // 12) % 2 > 0, 0.9, 0.7) * np.where(rows % 12 < 1.5, 0.4, 1.0)
    return _image((light * board)[..., None] * np.array([1.0, 0.8, 0.6]))


TEXTURES = {"stripes": stripes, "bricks": bricks, "boundary": boundary, "ground": ground}


def hole() -> torch.Tensor:
    """A disc of 12 % of the image, off its middle."""
    rows, columns = grid()
    return torch.from_numpy((rows - 45) ** 2 + (columns - 58) ** 2 < 21.5**2)


def spoilt(truth: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """The image with a glaring colour where it is masked."""
    return torch.where(mask[..., None], torch.tensor([1.0, 0.0, 1.0]), truth)


def error_db(filled: torch.Tensor, truth: torch.Tensor, mask: torch.Tensor) -> float:
    """PSNR within the mask [dB]."""
    return float(-10 * torch.log10((filled - truth)[mask].square().mean()))


def _image(colors: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.clip(colors, 0.0, 1.0).astype(np.float32))
