"""Prompts as text embeddings, plain and with PowerPaint's task words."""

import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.priors.stable_diffusion.load import load_stable_diffusion
from diga3d_warp.priors.stable_diffusion.powerpaint import QUALITY, SHAPE_FIT, task_prompts
from diga3d_warp.priors.stable_diffusion.text import TextEncoder


@pytest.fixture(scope="module")
def plain(checkpoints):
    return load_stable_diffusion(checkpoints / "sd", device="cpu")


@pytest.fixture(scope="module")
def powerpaint(checkpoints):
    return load_stable_diffusion(checkpoints / "powerpaint", device="cpu")


def spelled(prior, words, task_word):
    return prior.parts.text.encode(" ".join([words, *(f"{task_word}_{k}" for k in range(10))]).strip())


def test_plain_prompts(plain):
    prompts = plain.encode_prompts("a wooden cube", "a vase", "replace")
    assert prompts.positive.shape == (1, 48, 8)
    assert torch.equal(prompts.positive, plain.parts.text.encode("a wooden cube"))
    assert torch.equal(prompts.negative, plain.parts.text.encode("a vase"))
    assert not torch.allclose(prompts.positive, prompts.negative, atol=1e-2)


def test_each_task_word_is_ten_tokens_of_its_own(powerpaint):
    tokenizer = powerpaint.parts.text.tokenizer
    ids = tokenizer(" ".join(f"P_obj_{k}" for k in range(10))).input_ids
    assert len(ids) == 12
    assert len(set(ids[1:-1])) == 10


def test_removal_asks_for_context_and_against_objects(powerpaint):
    prompts = powerpaint.encode_prompts("", "a vase", "remove")
    assert torch.equal(prompts.positive, spelled(powerpaint, "empty scene blur", "P_ctxt"))
    assert torch.equal(prompts.negative, spelled(powerpaint, "a vase", "P_obj"))
    nothing = powerpaint.encode_prompts("a scene", "", "remove")
    assert torch.equal(nothing.positive, spelled(powerpaint, "empty scene blur a scene", "P_ctxt"))
    assert torch.equal(nothing.negative, spelled(powerpaint, "", "P_obj"))


def test_replacement_asks_for_an_object(powerpaint):
    prompts = powerpaint.encode_prompts("a wooden cube", "", "replace")
    assert torch.equal(prompts.positive, spelled(powerpaint, "a wooden cube", "P_obj"))


def test_retexturing_mixes_shape_and_context(powerpaint, monkeypatch):
    asked = []
    monkeypatch.setattr(
        powerpaint.parts.text,
        "encode",
        lambda prompt: asked.append(prompt) or torch.full((1, 2, 3), float("P_shape" in prompt)),
    )
    prompts = powerpaint.encode_prompts("a cube", "bad", "retexture")
    torch.testing.assert_close(prompts.positive, torch.full((1, 2, 3), SHAPE_FIT))
    torch.testing.assert_close(prompts.negative, torch.full((1, 2, 3), SHAPE_FIT))
    assert [prompt.split(" P_")[0] for prompt in asked] == ["a cube", f"bad, {QUALITY}"] * 2


def test_a_prompt_that_is_too_long(plain, powerpaint):
    for prior in (plain, powerpaint):
        with pytest.raises(InputError, match=r"has \d+ tokens, the model reads 48: shorten it"):
            prior.encode_prompts("a vase " * 5000, "", "replace")


@pytest.mark.parametrize("task", ["replace", "retexture"])
def test_a_prompt_that_is_missing(plain, task):
    with pytest.raises(InputError, match=f"{task} needs a prompt"):
        plain.encode_prompts("  ", "a vase", task)


def test_task_prompts_need_the_task_words(plain):
    with pytest.raises(InputError, match="does not know PowerPaint's task words"):
        task_prompts(plain.parts.text, "", "", "remove")


def test_a_model_of_few_words_refuses_others(plain):
    encoder = TextEncoder(plain.parts.text.tokenizer, plain.parts.text.model, ["a", "wooden", "cube"])
    assert torch.equal(encoder.encode("A wooden cube"), plain.parts.text.encode("A wooden cube"))
    with pytest.raises(InputError, match=r"never taught 'glass', '7': use its words only, a cube wooden"):
        encoder.encode("a glass cube, glass 7")
