"""Text masks: the same boxes and masks as transformers' own processors lead to."""

import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.perception.segmentation import SegmentationSettings, TextSegmenter


@pytest.fixture(scope="module")
def segmenter(models):
    settings = SegmentationSettings(score_min=0.3, short=64, long=128)
    return TextSegmenter.load(models / "detector", models / "cutter", settings=settings)


@pytest.fixture
def image():
    generator = torch.Generator().manual_seed(4)
    coarse = torch.rand(1, 3, 6, 9, generator=generator)
    image = torch.nn.functional.interpolate(coarse, (48, 72), mode="bicubic")
    return image[0].permute(1, 2, 0).clamp(0.0, 1.0)


def as_bytes(image):
    return (image * 255).round().byte().numpy()


def test_boxes(segmenter, image):
    from transformers.models.grounding_dino.image_processing_pil_grounding_dino import (
        GroundingDinoImageProcessorPil,
    )

    # at the size that the detector asks for: it picks its queries by rank, which any resampling upsets
    image = torch.nn.functional.interpolate(image.permute(2, 0, 1)[None], (64, 96))[0].permute(1, 2, 0)
    image = (image * 255).round() / 255
    found = segmenter.boxes(image, " A green vase. ")
    processor = GroundingDinoImageProcessorPil(size={"shortest_edge": 64, "longest_edge": 128})
    inputs = processor(as_bytes(image), return_tensors="pt")
    text = segmenter.tokenizer("a green vase.", return_tensors="pt")
    with torch.no_grad():
        outputs = segmenter.detector(pixel_values=inputs.pixel_values, pixel_mask=inputs.pixel_mask, **text)
    expected = processor.post_process_object_detection(outputs, threshold=0.3, target_sizes=[(64, 96)])[0]
    order = expected["scores"].argsort(descending=True)
    assert len(found.scores) == len(order) > 3
    torch.testing.assert_close(found.scores, expected["scores"][order], atol=1e-3, rtol=0.0)
    corners = expected["boxes"][order].clamp(min=0.0).minimum(torch.tensor([96.0, 64.0, 96.0, 64.0]))
    torch.testing.assert_close(found.corners, corners, atol=0.01, rtol=0.0)


def test_masks(segmenter, image):
    from transformers.models.sam.image_processing_pil_sam import SamImageProcessorPil

    corners = torch.tensor([[5.0, 6.0, 40.0, 30.0], [30.0, 4.0, 70.0, 44.0]])
    processor = SamImageProcessorPil(
        size={"longest_edge": 64}, pad_size={"height": 64, "width": 64}, mask_size={"longest_edge": 16},
        mask_pad_size={"height": 16, "width": 16},
    )  # fmt: skip
    inputs = processor(as_bytes(image), return_tensors="pt")
    boxes = corners * torch.tensor([64 / 72, 43 / 48] * 2)
    with torch.no_grad():
        outputs = segmenter.cutter(
            pixel_values=inputs.pixel_values, input_boxes=boxes[None], multimask_output=False
        )
    expected = processor.post_process_masks(
        outputs.pred_masks, inputs.original_sizes, inputs.reshaped_input_sizes
    )[0]
    each = torch.stack([segmenter.cut_out(image, box[None]) for box in corners])
    assert each.shape == (2, 48, 72)
    for mine, theirs in zip(each, expected[:, 0], strict=True):
        assert 0.02 < float(theirs.float().mean()) < 0.98
        assert float((mine != theirs).float().mean()) < 0.02
    assert torch.equal(segmenter.cut_out(image, corners), each.any(0))


def test_nothing_found_is_an_empty_mask(segmenter, image):
    strict = TextSegmenter(
        segmenter.detector, segmenter.tokenizer, segmenter.cutter, SegmentationSettings(1.0, 64, 128)
    )
    mask = strict.mask(image, "a vase")
    assert mask.shape == (48, 72)
    assert not mask.any()


@pytest.mark.parametrize("prompt", ["", "  . "])
def test_an_empty_prompt(segmenter, image, prompt):
    with pytest.raises(InputError, match="the mask prompt is empty"):
        segmenter.mask(image, prompt)


def test_a_prompt_that_is_too_long(segmenter, image):
    with pytest.raises(InputError, match=r"has 5003 tokens, the detector reads 16: shorten it"):
        segmenter.mask(image, "vase " * 5000)


def test_models_that_were_never_downloaded(monkeypatch, tmp_path, models):
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path))
    with pytest.raises(InputError, match="the weights of IDEA-Research/grounding-dino-tiny"):
        TextSegmenter.load()
    with pytest.raises(InputError, match="the weights of facebook/sam-vit-base"):
        TextSegmenter.load(models / "detector")
