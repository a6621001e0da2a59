"""FID: distance between two sets of pictures, as Gaussians over Inception's features (Heusel et al. 2017).

Whole pictures, 2048 features of torch-fidelity's network, which has the weights and the resizing of the first
implementation. It depends on the number of pictures: compare it between sets of one size only, and within one
program.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.weights import WeightsFile, fill, read_tensors, require
from diga3d_warp.files import to_bytes

INCEPTION = WeightsFile(
    "weights-inception-2015-12-05-6726825d.pth",
    "https://github.com/toshas/torch-fidelity/releases/download/v0.2.0/",
    96,
)


class Inception:
    """Inception's features for FID."""

    title = "FID"

    def __init__(self, weights: Path | None = None, device: str = "cpu") -> None:
        """Load the network.

        Args:
            weights: Folder with the file; torch.hub's cache if None or not there.
            device: Where it runs.

        Raises:
            InputError: a library or the file is missing, or the file is damaged.
        """
        path = INCEPTION.find(weights)
        require("torch_fidelity", "torchvision")
        state = read_tensors(path)  # refuses what runs code, which torch-fidelity does not
        from torch_fidelity.feature_extractor_inceptionv3 import FeatureExtractorInceptionV3

        try:
            self.network = FeatureExtractorInceptionV3("inception-v3-compat", ["2048"], str(path))
        except RuntimeError as error:
            raise InputError(f"{path} is another network's: download it again") from error
        fill(self.network, state, path)
        self.network.to(device)
        self.device = device

    @torch.no_grad()
    def features(self, picture: torch.Tensor) -> np.ndarray:
        """Features of a picture, shape (2048,), float64.

        Args:
            picture: RGB in [0, 1], shape (H, W, 3), rounded to 8 bits as a file of it would be.
        """
        pixels = torch.from_numpy(to_bytes(picture)).permute(2, 0, 1)[None].to(self.device)
        return self.network(pixels)[0][0].double().cpu().numpy()


def frechet_distance(first: np.ndarray, second: np.ndarray) -> float:
    """Squared Fréchet distance of the Gaussians with the mean and covariance of two sets of features.

    |m1 - m2|^2 + tr(C1 + C2 - 2 (C1 C2)^(1/2)). With C = A^T A of the centred features A, the trace of the
    root is the sum of the singular values of A1 A2^T: exact also where there are fewer pictures than
    features, and the root of a singular 2048 x 2048 matrix is not needed.

    Args:
        first, second: Features, shape (N, D) and (M, D), N and M at least 2.
    """
    means = [features.mean(0) for features in (first, second)]
    spreads = [
        (features - mean) / np.sqrt(len(features) - 1)
        for features, mean in zip((first, second), means, strict=True)
    ]
    roots = np.linalg.svd(spreads[0] @ spreads[1].T, compute_uv=False).sum()
    traces = sum(np.square(spread).sum() for spread in spreads)
    return max(float(np.square(means[0] - means[1]).sum() + traces - 2.0 * roots), 0.0)
