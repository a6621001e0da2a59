"""The training of the room prior: it goes on exactly where it was stopped, and refuses what is broken."""

import json
import shutil

import cv2
import numpy as np
import pytest
import torch
from lessons import RUN, TINY, WORDS, made_up_windows
from training.autoencoder import FROZEN, AutoencoderLesson, DecoderLesson, Encoder
from training.card import read_curve
from training.checkpoint import load_checkpoint, save_checkpoint
from training.controls import open_controls
from training.curve import draw_curves
from training.denoiser import open_denoiser
from training.export import export
from training.latents import encode_samples, open_latents
from training.loop import Training
from training.recipe import RunRecipe
from training.store import Store
from training.windows import open_windows
from training.workers import Workers

from diga3d_warp.errors import InputError


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A folder in which each network was trained for a few steps."""
    folder = tmp_path_factory.mktemp("work")
    (folder / "words.json").write_text(json.dumps(sorted(WORDS)))
    windows = made_up_windows(folder)
    made_up_windows(folder, "held_out")
    train(AutoencoderLesson(TINY, windows), folder, 4)
    encode_samples(folder, TINY, 12)
    train(open_denoiser(folder, TINY), folder, 4)
    for kind in ("edges", "depth"):
        train(open_controls(kind, folder, TINY), folder, 4)
    return folder


def train(lesson, folder, steps, every=1e9):
    return Training(lesson, RUN, TINY.seed, folder).run(steps, every, 1e9, progress=False)


def test_a_training_goes_on_with_the_same_losses(tmp_path):
    windows = made_up_windows(tmp_path)
    whole = train(AutoencoderLesson(TINY, windows), tmp_path / "whole", 6)
    parts = [train(AutoencoderLesson(TINY, windows), tmp_path / "parts", steps) for steps in (3, 6)]
    assert len(set(whole)) == 6
    assert parts[0] + parts[1] == whole


def test_a_training_that_was_killed_repeats_its_steps_although_data_was_added(tmp_path):
    windows = made_up_windows(tmp_path)
    first = Training(AutoencoderLesson(TINY, windows), RUN, 0, tmp_path)
    first.run(2, 1e9, 1e9, progress=False)
    lost = [first._step(4)["loss"] for _ in range(2)]
    windows.append(
        [{**row, "window": row["window"] + 9} for row in windows.rows],
        {name: np.array(windows.array(name)) for name in windows.layout},
    )
    assert train(AutoencoderLesson(TINY, windows), tmp_path, 4) == lost


def test_the_rate_rises_stays_and_falls_and_goes_on_with_more_steps():
    recipe = RunRecipe(batch=1, rate=2.0, warm_up=10, cooling=0.2)
    rates = [recipe.rate_at(step, 100) for step in range(100)]
    assert rates[0] == pytest.approx(0.2) and rates[9:81] == [2.0] * 72
    assert rates[90] == pytest.approx(1.0) and rates[99] == pytest.approx(0.1)
    assert rates[80:] == sorted(rates[80:], reverse=True)
    assert recipe.rate_at(99, 1000) == 2.0


class Second(Workers):
    """The second of two processes, without the first."""

    def __init__(self):
        super().__init__(rank=1, count=2)

    def agree(self, value):
        return 10 if value == 0 else value

    def average(self, tensors):
        for tensor in tensors:
            tensor.zero_()


def test_another_process_draws_its_own_samples_follows_the_mean_and_writes_nothing(tmp_path):
    windows = made_up_windows(tmp_path)
    alone = train(AutoencoderLesson(TINY, windows), tmp_path / "alone", 1)
    second = Training(AutoencoderLesson(TINY, windows), RUN, 0, tmp_path / "second", Second())
    before = {name: weights.clone() for name, weights in second.lesson.module.state_dict().items()}
    decay = 1 - RUN.decay * RUN.rate / RUN.warm_up
    assert second.run(1, 1e9, 1e9, progress=False) != alone
    assert not (tmp_path / "second").exists()
    for name, weights in second.lesson.module.state_dict().items():
        torch.testing.assert_close(weights, decay * before[name])


def test_the_denoiser_and_its_controls_learn(work):
    lesson = open_denoiser(work, TINY)
    training = Training(lesson, RUN, 0, work)
    assert training.step == 4
    before = lesson.module.unet.conv_in.weight.clone()
    words = lesson.module.text.get_input_embeddings().weight.clone()
    training._step(9)
    assert not torch.equal(before, lesson.module.unet.conv_in.weight)
    assert not torch.equal(words, lesson.module.text.get_input_embeddings().weight)
    control = Training(open_controls("edges", work, TINY), RUN, 0, work)
    before = control.lesson.module.controlnet_mid_block.weight.clone()
    control._step(9)
    assert not torch.equal(before, control.lesson.module.controlnet_mid_block.weight)


@pytest.mark.parametrize(
    ("spoil", "line"),
    [
        (lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]), "cannot be read"),
        (lambda path: path.write_bytes(b""), "cannot be read"),
        (lambda path: edited(path, lambda s: s.update(version=99)), "version 99 of the recipe"),
        (lambda path: edited(path, lambda s: first(s["module"]).fill_(float("nan"))), "not finite"),
        (lambda path: edited(path, lambda s: s["module"].popitem()), "network of another size"),
    ],
)
def test_a_broken_checkpoint_is_refused_in_one_line(work, tmp_path, spoil, line):
    path = tmp_path / "autoencoder.ckpt"
    path.write_bytes((work / "autoencoder.ckpt").read_bytes())
    spoil(path)
    windows = made_up_windows(tmp_path)
    with pytest.raises(InputError, match=line) as error:
        Training(AutoencoderLesson(TINY, windows), RUN, 0, tmp_path)
    assert "\n" not in str(error.value)


def edited(path, change):
    state = torch.load(path, weights_only=True)
    change(state)
    torch.save(state, path)


def first(weights):
    return next(iter(weights.values()))


def test_what_is_not_trained_yet_is_named(tmp_path):
    with pytest.raises(InputError, match="train the autoencoder first"):
        encode_samples(tmp_path, TINY, 4)
    windows = open_windows(tmp_path, TINY.data)
    with pytest.raises(InputError, match="make its data first"):
        train(AutoencoderLesson(TINY, windows), tmp_path, 1)


def test_a_record_that_was_cut_short_is_written_again(tmp_path):
    layout = {"number": ((2,), "int16")}
    store = Store(tmp_path, layout, 1)
    store.append([{"n": 0}], {"number": np.array([[1, 2]])})
    with (tmp_path / "number.raw").open("ab") as file:
        file.write(b"abc")
    with (tmp_path / "rows.jsonl").open("ab") as file:
        file.write(b'{"n": ')
    store = Store(tmp_path, layout, 1)
    assert len(store.rows) == 1
    store.append([{"n": 1}], {"number": np.array([[3, 4]])})
    assert Store(tmp_path, layout, 1).array("number").tolist() == [[1, 2], [3, 4]]
    with pytest.raises(InputError, match="version 1 of the recipe, not 2"):
        Store(tmp_path, layout, 2)


def test_samples_are_masked_where_objects_stand_or_might_have(work):
    store = open_latents(work, TINY)
    assert len(store.rows) == 12
    masked = np.unpackbits(store.array("mask"), axis=-1).mean((1, 2))
    assert (masked > 0).all()
    assert np.isfinite(store.array("latent")).all() and store.array("latent").std() > 0
    assert not np.array_equal(store.array("latent"), store.array("known"))
    assert {row["thing"] for row in store.rows} >= {None, 0}
    assert store.array("edges").any() and store.array("depth").std() > 0


def test_samples_of_another_autoencoder_are_refused(work, tmp_path):
    folder = tmp_path / "work"
    shutil.copytree(work, folder)
    state = load_checkpoint(folder / FROZEN)
    save_checkpoint(folder / FROZEN, {**state, "scale": 2 * state["scale"]})
    with pytest.raises(InputError, match="latents was made by version 1, autoencoder"):
        open_denoiser(folder, TINY)


def test_the_exported_folder_loads_as_a_prior(work, tmp_path):
    from diffusers import AutoencoderTiny, ControlNetModel, DDIMScheduler, UNet2DConditionModel

    from diga3d_warp.priors.stable_diffusion.load import load_stable_diffusion

    folder = tmp_path / "room"
    assert export(work, TINY, folder) == []
    card = (folder / "README.md").read_text()
    assert "| UNet and text encoder | 8 |" in card and "10 images of 1 rooms" in card
    UNet2DConditionModel.from_pretrained(folder / "unet", variant="fp16")
    AutoencoderTiny.from_pretrained(folder / "vae", variant="fp16")
    ControlNetModel.from_pretrained(folder / "controlnet-depth", variant="fp16")
    assert DDIMScheduler.from_pretrained(folder / "scheduler").config.prediction_type == "v_prediction"
    prior = load_stable_diffusion(folder, controls=("edges", "depth"), positive="a golden ball")
    assert prior.mask_aware
    image, mask = torch.rand(64, 64, 3), torch.zeros(64, 64, dtype=torch.bool)
    mask[20:40, 20:40] = True
    filled = prior.fill(image, mask)
    assert torch.equal(filled[~mask], image[~mask]) and filled[mask].std() > 0
    with pytest.raises(InputError, match=r"never taught 'zebra', 'velvet': use its words only, a an ball"):
        prior.encode_prompts("a zebra velvet vase", "", "replace")


def test_the_curves_are_drawn_once_for_each_step(work, tmp_path):
    draw_curves(work, tmp_path / "curve.png")
    assert cv2.imread(str(tmp_path / "curve.png")).std() > 10
    (tmp_path / "denoiser.jsonl").write_text('{"step": 2}\n{"step": 4}\n{"step": 3}\n')
    assert read_curve(tmp_path / "denoiser.jsonl") == [{"step": 2}, {"step": 3}]
    with pytest.raises(InputError, match="train a network first"):
        draw_curves(tmp_path / "empty", tmp_path / "curve.png")


def test_export_replaces_only_what_it_wrote(work, tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(InputError, match="holds something else"):
        export(work, TINY, tmp_path)
    assert (tmp_path / "thesis.txt").exists()


def test_the_decoder_learns_further_and_latents_stay(work):
    encoder, image = Encoder.frozen(work, TINY), torch.rand(1, 64, 64, 3)
    before = encoder(image)
    lesson = DecoderLesson(TINY, open_windows(work, TINY.data), encoder)
    decoder = lesson.module.decoder.layers[0].weight.clone()
    train(lesson, work, 2)
    assert not torch.equal(decoder, lesson.module.decoder.layers[0].weight)
    taught = Encoder.frozen(work, TINY)
    assert torch.equal(taught(image), before)
    assert not torch.equal(taught.model.decoder.layers[0].weight, decoder)


def test_a_sheet_shows_held_out_windows_filled(work):
    lesson = open_denoiser(work, TINY)
    sheet = lesson.picture(lesson.module)
    assert sheet.shape == (5 * 64, 6 * 64, 3) and sheet.std() > 10
