"""CLIP_dir on a tiny network, against its definition."""

import math

import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.clip_direction import ClipDirection

SOURCE, EDITED = "a stone bear", "a bear of gold"


@pytest.fixture(scope="module")
def weights(weights_of):
    pytest.importorskip("transformers", reason="needs the extra [metrics]")
    return weights_of("clip")


@pytest.fixture(scope="module")
def measure(weights):
    return ClipDirection(SOURCE, EDITED, weights)


def picture(seed, height=30, width=44):
    return torch.rand(height, width, 3, generator=torch.Generator().manual_seed(seed))


def test_cosine_of_the_differences_of_unit_embeddings(measure, weights):
    """Both embeddings are divided by their lengths first: the result is another one without."""
    from transformers import CLIPModel, CLIPTokenizer

    path = weights / "clip-vit-large-patch14"
    model, tokenizer = CLIPModel.from_pretrained(path).eval(), CLIPTokenizer.from_pretrained(path)
    mean, deviation = (0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)

    def embed(image):
        image = image.permute(2, 0, 1)[None]
        image = torch.nn.functional.interpolate(image, (32, 32), mode="bicubic", align_corners=False)
        image = (image - torch.tensor(mean).view(3, 1, 1)) / torch.tensor(deviation).view(3, 1, 1)
        return model.get_image_features(pixel_values=image).pooler_output[0]

    def words(text):  # one text alone, which needs no padding
        return model.get_text_features(**tokenizer(text, return_tensors="pt")).pooler_output[0]

    with torch.no_grad():
        images, texts = [embed(picture(seed)) for seed in (0, 1)], [words(SOURCE), words(EDITED)]
    unit = [[vector / vector.norm() for vector in pair] for pair in (images, texts)]
    expected, raw = (
        float(torch.dot(a := i[1] - i[0], b := t[1] - t[0]) / a.norm() / b.norm())
        for i, t in (unit, (images, texts))
    )
    score = measure.score(picture(1), picture(0))
    assert score == pytest.approx(expected, abs=1e-5)
    assert abs(score - raw) > 1e-3 and abs(score) > 1e-3


def test_the_way_back_is_the_opposite_direction(measure):
    there, back = measure.score(picture(1), picture(0)), measure.score(picture(0), picture(1))
    assert there == pytest.approx(-back, abs=1e-6) and -1 <= there <= 1


def test_equal_pictures_have_no_direction(measure):
    grey = picture(2).mean(-1, keepdim=True).expand(-1, -1, 3)
    for image in (picture(2), grey, torch.zeros(5, 3, 3), torch.ones(1, 1, 3)):
        assert measure.score(image, image.clone()) == 0.0


def test_texts_that_give_no_direction_are_one_line(weights):
    for source, edited, said in (
        ("", "gold", "one is empty: give --source-prompt"),
        ("stone", "  ", "one is empty"),
        ("stone", " stone", "are the same"),
    ):
        with pytest.raises(InputError, match=said):
            ClipDirection(source, edited, weights)


def test_long_texts_are_cut(weights):
    measure = ClipDirection("a " * 200, EDITED, weights)
    assert math.isfinite(measure.score(picture(1), picture(0)))


def test_missing_weights_are_named_with_size_and_command(tmp_path, monkeypatch):
    import huggingface_hub.constants

    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_CACHE", str(tmp_path))
    with pytest.raises(InputError, match=r"clip-vit-large-patch14 \(1\.7 GB\) .*hf download openai/clip"):
        ClipDirection(SOURCE, EDITED, tmp_path)
