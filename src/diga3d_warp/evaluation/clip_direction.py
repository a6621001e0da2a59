"""CLIP_dir: whether the pictures changed in the direction in which the text says they should.

With E a CLIP embedding of length 1, the cosine of E(edited picture) - E(source picture) and E(text of the
edit) - E(text of the source). As the metrics of InstructPix2Pix compute it (Brooks et al. 2023): ViT-L/14,
every embedding normalised before the difference, the whole picture resized to the network's square by bicubic
interpolation.
"""

from __future__ import annotations

from pathlib import Path

import torch
from torch.nn.functional import cosine_similarity, interpolate, normalize

from diga3d_warp.checkpoints import Checkpoint, load_model, load_tokenizer, locate
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.weights import require

CLIP = Checkpoint("openai/clip-vit-large-patch14", 1.7)


class ClipDirection:
    """CLIP_dir of one edit."""

    title = "CLIP_dir"

    def __init__(self, source: str, edited: str, weights: Path | None = None, device: str = "cpu") -> None:
        """Load the network and embed the texts.

        Args:
            source: What the scene shows before the edit.
            edited: What it shows after it.
            weights: Folder that holds the folder "clip-vit-large-patch14"; the Hugging Face cache if None or
                not there.
            device: Where it runs.

        Raises:
            InputError: a library or the weights are missing or damaged, or the texts are empty or the same.
        """
        if not source.strip() or not edited.strip():
            raise InputError(
                "CLIP_dir compares two texts and one is empty: give --source-prompt and a prompt"
            )
        if source.strip() == edited.strip():
            raise InputError(f"the text of the source and of the edit are the same ({source}): change one")
        require("transformers", "safetensors")
        from transformers import CLIPModel, CLIPTokenizer

        own = None if weights is None else weights / CLIP.repository.split("/")[1]
        folder = locate(CLIP, own if own is not None and own.is_dir() else None)
        tokenizer = load_tokenizer(CLIPTokenizer, folder)
        self.network, self.device = load_model(CLIPModel, folder).to(device), device
        tokens = tokenizer([source, edited], padding=True, truncation=True, return_tensors="pt").to(device)
        with torch.no_grad():
            texts = normalize(self.network.get_text_features(**tokens).pooler_output, dim=-1)
        self.direction = texts[1] - texts[0]

    def score(self, picture: torch.Tensor, source: torch.Tensor) -> float:
        """CLIP_dir in [-1, 1]; 0 for equal pictures, which have no direction.

        Args:
            picture: The edited one, RGB in [0, 1], shape (H, W, 3).
            source: The same view before the edit.
        """
        embeddings = self._embed(torch.stack([source, picture]))
        return float(cosine_similarity(embeddings[1] - embeddings[0], self.direction, dim=0))

    @torch.no_grad()
    def _embed(self, pictures: torch.Tensor) -> torch.Tensor:
        """Embeddings of length 1 of pictures (B, H, W, 3), shape (B, D)."""
        from transformers.image_utils import OPENAI_CLIP_MEAN, OPENAI_CLIP_STD

        side = self.network.config.vision_config.image_size
        images = pictures.to(self.device, torch.float32).permute(0, 3, 1, 2)
        images = interpolate(images, (side, side), mode="bicubic", align_corners=False)
        mean, deviation = (images.new_tensor(v)[:, None, None] for v in (OPENAI_CLIP_MEAN, OPENAI_CLIP_STD))
        features = self.network.get_image_features(pixel_values=(images - mean) / deviation)
        return normalize(features.pooler_output, dim=-1)
