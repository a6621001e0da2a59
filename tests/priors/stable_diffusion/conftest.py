"""Tiny checkpoints in the real format, written once."""

import pytest
import torch

from tiny_diffusion import write_checkpoint, write_image_encoder, write_ip_adapter


@pytest.fixture(scope="session")
def checkpoints(tmp_path_factory):
    """sd has 9 channels; sd4 has 4, predicts v and has the tiny autoencoder."""
    root = tmp_path_factory.mktemp("checkpoints")
    write_checkpoint(root / "sd")
    write_checkpoint(root / "sd4", channels=4, vae="tiny", prediction="v_prediction")
    write_checkpoint(root / "powerpaint", powerpaint=True)
    write_image_encoder(root / "clip")
    write_ip_adapter(root / "ip-adapter.safetensors")
    return root


@pytest.fixture
def photo():
    """Two photographs (2, 32, 48, 3)."""
    return torch.rand(2, 32, 48, 3, generator=torch.Generator().manual_seed(21))


@pytest.fixture
def holes():
    """Masks along the cells of the latents, which diffusers and we see alike, shape (2, 32, 48)."""
    holes = torch.zeros(2, 32, 48, dtype=torch.bool)
    holes[0, 8:24, 12:40] = True
    holes[1, 4:12, 20:44] = True
    return holes
