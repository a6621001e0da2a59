"""Weights files of the metrics' networks in the real formats, with random numbers."""

from __future__ import annotations

from pathlib import Path

import torch


def write_backbone(folder: Path, net: str) -> Path:
    """VGG16 or AlexNet as torchvision publishes it, without the classifier, which is not read."""
    import torchvision

    from diga3d_warp.evaluation.lpips import ALEX, VGG

    make, backbone = {"vgg": (torchvision.models.vgg16, VGG), "alex": (torchvision.models.alexnet, ALEX)}[net]
    with torch.device("meta"):
        shapes = make(weights=None).state_dict()
    return _write(
        folder / backbone.file.name, {k: v.shape for k, v in shapes.items() if k.startswith("features.")}
    )


def _write(path: Path, shapes: dict[str, torch.Size]) -> Path:
    """Random numbers of He's deviation for each shape, biases small."""
    generator = torch.Generator().manual_seed(41)
    state = {}
    for name, shape in shapes.items():
        deviation = (2.0 / shape[1:].numel()) ** 0.5 if len(shape) > 1 else 0.02
        # Norms divide by deviations and multiply by their weights, the only ones of one dimension.
        mean = 1.0 if name.endswith("running_var") or (len(shape) == 1 and name.endswith("weight")) else 0.0
        state[name] = mean + deviation * torch.randn(shape, generator=generator)
        if name.endswith("num_batches_tracked"):
            state[name] = torch.tensor(0)
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save(state, path)
    return path


def write_loftr(folder: Path) -> Path:
    """LoFTR whose last layer speaks up, so that some random features match."""
    from kornia.feature import LoFTR

    from diga3d_warp.evaluation.correspondences import LOFTR

    with torch.random.fork_rng():
        torch.manual_seed(43)
        state = LoFTR(pretrained=None).state_dict()
    state["loftr_coarse.layers.7.norm2.weight"] *= 200
    folder.mkdir(parents=True, exist_ok=True)
    torch.save({"state_dict": state}, folder / LOFTR.name)
    return folder / LOFTR.name


def write_clip(folder: Path) -> Path:
    """CLIP for images of 32 px that knows a few letters, in the folder where the metric looks."""
    from transformers import CLIPConfig, CLIPModel, CLIPTokenizer

    from diga3d_warp.evaluation.clip_direction import CLIP

    path = folder / CLIP.repository.split("/")[1]
    path.mkdir(parents=True)
    letters = [chr(code) for code in range(97, 123)]
    words = [*letters, *(f"{letter}</w>" for letter in letters), "<|startoftext|>", "<|endoftext|>"]
    vocabulary = {word: number for number, word in enumerate(words)}
    CLIPTokenizer(vocab=vocabulary, merges=[], model_max_length=77).save_pretrained(path)
    shape = {"hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 2, "num_attention_heads": 2}
    ends = {"bos_token_id": len(words) - 2, "eos_token_id": len(words) - 1, "pad_token_id": len(words) - 1}
    with torch.random.fork_rng():
        torch.manual_seed(45)
        model = CLIPModel(
            CLIPConfig(
                text_config={**shape, **ends, "vocab_size": len(words), "max_position_embeddings": 77},
                vision_config={**shape, "image_size": 32, "patch_size": 8},
                projection_dim=8,
            )
        )
        for parameter in model.parameters():
            if parameter.ndim > 1:
                torch.nn.init.normal_(parameter, std=0.3)
        model.save_pretrained(path)
    return path


def write_musiq(folder: Path) -> Path:
    """MUSIQ as IQA-PyTorch publishes it."""
    from diga3d_warp.evaluation.musiq import KONIQ, _Network

    with torch.device("meta"):
        shapes = {name: value.shape for name, value in _Network().state_dict().items()}
    path = _write(folder / KONIQ.name, shapes)
    torch.save({"params": torch.load(path, weights_only=True)}, path)
    return path


def write_inception(folder: Path) -> Path:
    """Inception as torch-fidelity publishes it."""
    from torch_fidelity.feature_extractor_inceptionv3 import FeatureExtractorInceptionV3

    from diga3d_warp.evaluation.frechet import INCEPTION

    class Bare(FeatureExtractorInceptionV3):
        def load_state_dict(self, state):
            pass

    folder.mkdir(parents=True, exist_ok=True)
    path = folder / INCEPTION.name
    torch.save({}, path)
    with torch.device("meta"):
        shapes = Bare("inception-v3-compat", ["2048"], str(path)).state_dict()
    return _write(path, {name: value.shape for name, value in shapes.items()})
