"""How an already inpainted image tells the UNet what others should look like (paper Sec. 3.3, I_p).

The paper encodes it with CLIP and integrates "the image embeddings into the residual blocks of the U-Net". It
does not say how, nor with what weights. Two readings are offered:

class       The embedding, projected, is added to the time embedding, which every residual block takes: what
            diffusers calls a class embedding. The words of the paper, but Stable Diffusion 1.5 has no trained
            projection: where a checkpoint brings none it is zero, and then has no effect at all.
ip-adapter  IP-Adapter (Ye et al. 2023): trained for Stable Diffusion 1.5, but it enters through the
            cross-attentions, not through the residual blocks.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F

from diga3d_warp.errors import InputError

CLIP_MEAN = (0.48145466, 0.4578275, 0.40821073)
CLIP_STD = (0.26862954, 0.26130258, 0.27577711)
"""Mean and standard deviation of CLIP's training images, for models without preprocessor_config.json."""


class ImageEncoder:
    """CLIP's vision model.

    Args:
        model: `transformers.CLIPVisionModelWithProjection`.
        mean: Of RGB in [0, 1], subtracted first.
        std: Divided by then.
    """

    def __init__(
        self, model: Any, mean: tuple[float, ...] = CLIP_MEAN, std: tuple[float, ...] = CLIP_STD
    ) -> None:
        self.model = model
        self.mean, self.std = (torch.tensor(part).view(1, 3, 1, 1) for part in (mean, std))

    @staticmethod
    def load(folder: Path) -> ImageEncoder:
        """An image encoder from its folder.

        Raises:
            InputError: it is not there, or not complete.
        """
        from transformers import CLIPVisionModelWithProjection

        from diga3d_warp.checkpoints import load_model

        model = load_model(CLIPVisionModelWithProjection, folder)
        for beside in (folder, folder.parent / "feature_extractor"):
            file = beside / "preprocessor_config.json"
            if file.is_file():
                settings = json.loads(file.read_text(encoding="utf-8"))
                return ImageEncoder(model, tuple(settings["image_mean"]), tuple(settings["image_std"]))
        return ImageEncoder(model)

    @property
    def width(self) -> int:
        """Length of an embedding."""
        return int(self.model.config.projection_dim)

    @torch.no_grad()
    def embed(self, images: torch.Tensor) -> torch.Tensor:
        """Mean embedding, shape (1, width), of the middle squares of images (B, H, W, 3) in [0, 1]."""
        side = int(self.model.config.image_size)
        height, width = images.shape[1:3]
        scale = side / min(height, width)
        size = [max(side, round(length * scale)) for length in (height, width)]
        pixels = F.interpolate(images.permute(0, 3, 1, 2), size, mode="bicubic", antialias=True).clamp(
            0.0, 1.0
        )
        top, left = (size[0] - side) // 2, (size[1] - side) // 2
        pixels = pixels[..., top : top + side, left : left + side]
        pixels = (pixels - self.mean.to(pixels)) / self.std.to(pixels)
        device, dtype = self.model.device, self.model.dtype
        return self.model(pixels.to(device, dtype)).image_embeds.float().mean(0, keepdim=True)


def attach_class_embedding(unet: Any, width: int) -> None:
    """Give a UNet a class embedding of image embeddings; a projection that it already has is kept.

    A new one is zero: the UNet estimates what it did before.

    Args:
        unet: `diffusers.UNet2DConditionModel`.
        width: Length of an image embedding.

    Raises:
        InputError: the UNet has a class embedding of another kind or width.
    """
    present = unet.class_embedding
    if present is None:
        projection = torch.nn.Linear(width, unet.time_embedding.linear_2.out_features)
        torch.nn.init.zeros_(projection.weight)
        torch.nn.init.zeros_(projection.bias)
        unet.class_embedding = projection.to(unet.device, unet.dtype).requires_grad_(False)
        unet.register_to_config(
            class_embed_type="simple_projection", projection_class_embeddings_input_dim=width
        )
    elif unet.config.class_embed_type != "simple_projection" or present.in_features != width:
        raise InputError(
            f"the UNet's class embedding ({unet.config.class_embed_type or 'classes'}) does not take image "
            f"embeddings of {width} numbers: use the image encoder that it was trained with"
        )


def check_ip_adapter(file: Path) -> None:
    """Refuse a file that is no weights of an IP-Adapter by its name.

    Raises:
        InputError: it is missing, or a pickle.
    """
    if file.suffix != ".safetensors" or not file.is_file():
        raise InputError(
            f"{file} is not a .safetensors file: give ip-adapter_sd15.safetensors of h94/IP-Adapter"
        )


def attach_ip_adapter(unet: Any, file: Path) -> int:
    """Put IP-Adapter's weights into a UNet's cross-attentions.

    It makes all attention processors anew, so a bank has to be installed afterwards.

    Args:
        unet: `diffusers.UNet2DConditionModel`.
        file: For instance ip-adapter_sd15.safetensors of h94/IP-Adapter.

    Returns:
        Length of the image embeddings that it takes.

    Raises:
        InputError: the file is missing, a pickle, or not an IP-Adapter of this UNet.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    check_ip_adapter(file)
    try:
        weights = load_file(file)
        state: dict[str, dict[str, torch.Tensor]] = {"image_proj": {}, "ip_adapter": {}}
        for name, tensor in weights.items():
            part, _, rest = name.partition(".")
            state[part][rest] = tensor
        unet._load_ip_adapter_weights([state], low_cpu_mem_usage=False)
        unet.requires_grad_(False)
        return int(state["image_proj"]["proj.weight"].shape[1])
    except (OSError, KeyError, RuntimeError, ValueError, SafetensorError) as error:
        reason = str(error).strip().split("\n")[0]
        raise InputError(
            f"{file} is no IP-Adapter of this UNet ({reason}): take the one for its version"
        ) from error
