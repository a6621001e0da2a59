"""Loading priors: what is missing, broken or dangerous is said in one line."""

import json
import shutil

import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.priors.protocol import DiffusionPrior
from diga3d_warp.priors.stable_diffusion.load import load_stable_diffusion, read_schedule


@pytest.fixture
def copy(checkpoints, tmp_path):
    """A copy of the 9-channel checkpoint, to be spoilt."""
    return shutil.copytree(checkpoints / "sd", tmp_path / "sd")


@pytest.fixture
def cache(monkeypatch, tmp_path):
    """An empty Hugging Face cache."""
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path / "hub"))
    return tmp_path / "hub"


def line(prior, **options):
    with pytest.raises(InputError) as caught:
        load_stable_diffusion(prior, device="cpu", **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def line_when_used(prior, **options):
    """What only the weights show, or the networks put together, is said when they are opened."""
    loaded = load_stable_diffusion(prior, device="cpu", **options)
    with pytest.raises(InputError) as caught:
        _ = loaded.networks
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("name", "repository"),
    [
        ("sd-inpainting", "stable-diffusion-v1-5/stable-diffusion-inpainting"),
        ("powerpaint", "Sanster/PowerPaint-V1-stable-diffusion-inpainting"),
    ],
)
def test_weights_that_were_never_downloaded(cache, name, repository):
    said = line(name)
    assert (
        f"the weights of {repository} (2.1 GB) are not on this machine: run hf download {repository}" in said
    )
    assert "or give a folder" in said


def test_weights_that_were_downloaded_are_found(checkpoints, cache):
    repository = cache / "models--stable-diffusion-v1-5--stable-diffusion-inpainting"
    (repository / "refs").mkdir(parents=True)
    (repository / "refs" / "main").write_text("0123abcd", encoding="utf-8")
    shutil.copytree(checkpoints / "sd", repository / "snapshots" / "0123abcd")
    prior = load_stable_diffusion("sd-inpainting", device="cpu")
    assert prior.name == "sd-inpainting"
    assert prior.mask_aware


def test_controlnets_that_were_never_downloaded(copy, cache):
    shutil.rmtree(copy / "controlnet-depth")
    said = line(copy, controls=("edges", "depth"))
    assert "the weights of lllyasviel/sd-controlnet-depth (1.4 GB) are not on this machine" in said


def test_controlnets_from_elsewhere(copy, tmp_path):
    shutil.move(copy / "controlnet-edges", tmp_path / "mine")
    prior = load_stable_diffusion(
        copy, controls=("edges",), controlnets={"edges": tmp_path / "mine"}, device="cpu"
    )
    assert set(prior.networks.controlnets) == {"edges"}


def test_a_pickle_is_refused(copy):
    (copy / "unet" / "diffusion_pytorch_model.safetensors").unlink()
    torch.save({}, copy / "unet" / "diffusion_pytorch_model.bin")
    assert "diffusion_pytorch_model.bin is a pickle, which can run code" in line(copy)


@pytest.mark.parametrize("part", ["unet", "vae", "text_encoder", "tokenizer", "scheduler"])
def test_a_missing_part_is_named(copy, part):
    shutil.rmtree(copy / part)
    assert str(copy / part) in line(copy)


@pytest.mark.parametrize("words", [None, "", "{}", "{"])
def test_a_tokenizer_without_words(copy, words):
    """Transformers would make one that knows no word, and every prompt would be the same."""
    file = copy / "tokenizer" / "tokenizer.json"
    file.unlink()
    if words is not None:
        file.write_text(words)
    said = "holds no tokenizer (tokenizer.json)" if words is None else "cannot be read: download it again"
    assert f"{copy / 'tokenizer'} {said}" in line(copy)


def test_networks_are_read_when_one_is_asked(copy):
    """A fit may come first, and a resumed run may need none of them."""
    prior = load_stable_diffusion(copy, device="cpu", controls=("edges",), positive="a vase")
    assert isinstance(prior, DiffusionPrior) and prior.mask_aware and prior.control_kinds == ("edges",)
    assert prior.guidance.prompts.positive.std() > 0.0
    shutil.rmtree(copy / "unet")
    with pytest.raises(InputError, match=r"unet lacks config.json"):
        prior.native_size(40, 60)


def test_a_class_embedding_brings_its_image_encoder(copy):
    from tiny_diffusion import tiny_unet, write_image_encoder

    write_image_encoder(copy / "image_encoder")
    assert load_stable_diffusion(copy, device="cpu").networks.images is None
    unet = tiny_unet(9, class_embed_type="simple_projection", projection_class_embeddings_input_dim=6)
    unet.save_pretrained(copy / "unet")
    networks = load_stable_diffusion(copy, device="cpu").networks
    assert networks.images.width == 6
    assert torch.equal(networks.unet.class_embedding.weight, unet.class_embedding.weight)


def test_missing_weights_are_named(copy):
    (copy / "vae" / "diffusion_pytorch_model.safetensors").unlink()
    assert f"{copy / 'vae'} holds no .safetensors file" in line(copy)


def test_weights_cut_short(copy):
    file = copy / "unet" / "diffusion_pytorch_model.safetensors"
    file.write_bytes(file.read_bytes()[:-500])
    assert f"{file} cannot be read" in line(copy)


def test_weights_that_do_not_fit_the_configuration(copy):
    config = copy / "unet" / "config.json"
    settings = json.loads(config.read_text(encoding="utf-8"))
    config.write_text(json.dumps({**settings, "block_out_channels": [8, 32]}), encoding="utf-8")
    assert f"{copy / 'unet'} cannot be read" in line_when_used(copy)


def test_parameters_that_are_missing_are_not_made_up(copy):
    from safetensors.torch import load_file, save_file

    file = copy / "text_encoder" / "model.safetensors"
    weights = load_file(file)
    gone = next(name for name in sorted(weights) if name.endswith("k_proj.weight"))
    save_file(
        {name: tensor for name, tensor in weights.items() if name != gone}, file, metadata={"format": "pt"}
    )
    assert "lacks 1 parameters" in line(copy)


def test_weights_that_are_not_finite(copy):
    from safetensors.torch import load_file, save_file

    file = copy / "unet" / "diffusion_pytorch_model.safetensors"
    weights = load_file(file)
    name = sorted(weights)[0]
    save_file({**weights, name: weights[name] * float("nan")}, file, metadata={"format": "pt"})
    assert f"{copy / 'unet'} holds numbers that are not finite ({name})" in line_when_used(copy)


def test_half_precision_is_read_where_there_is_nothing_else(copy, photo, holes):
    from safetensors.torch import load_file, save_file

    file = copy / "unet" / "diffusion_pytorch_model.safetensors"
    halves = {name: tensor.half() for name, tensor in load_file(file).items()}
    save_file(halves, file.with_name("diffusion_pytorch_model.fp16.safetensors"), metadata={"format": "pt"})
    file.unlink()
    prior = load_stable_diffusion(copy, device="cpu")
    assert prior.networks.unet.dtype == torch.float32
    assert torch.equal(prior.networks.unet.conv_in.weight, halves["conv_in.weight"].float())


def test_what_is_no_prior(tmp_path):
    assert line("sd-inpaintin") == (
        "there is no prior or folder sd-inpaintin: give sd-inpainting, powerpaint or a folder"
    )
    file = tmp_path / "model.ckpt"
    file.touch()
    assert f"{file} is not a folder" in line(file)


def test_a_unet_of_another_task(copy):
    from tiny_diffusion import tiny_unet

    tiny_unet(8).save_pretrained(copy / "unet")
    assert "has 8 input channels for 4 of the autoencoder: give one with 4 or 9" in line(copy)


def test_an_ip_adapter_that_does_not_fit(checkpoints, tmp_path):
    from tiny_diffusion import write_image_encoder, write_ip_adapter

    adapter = checkpoints / "ip-adapter.safetensors"
    assert "needs an image encoder" in line(checkpoints / "sd", ip_adapter=adapter)
    other = write_image_encoder(tmp_path / "clip", width=10)
    assert "takes image embeddings of 6 numbers, the encoder gives 10" in line_when_used(
        checkpoints / "sd", ip_adapter=adapter, image_encoder=other
    )
    pickle = tmp_path / "ip-adapter_sd15.bin"
    pickle.touch()
    assert f"{pickle} is not a .safetensors file" in line(
        checkpoints / "sd", ip_adapter=pickle, image_encoder=other
    )
    torn = write_ip_adapter(tmp_path / "torn.safetensors")
    torn.write_bytes(torn.read_bytes()[:-9])
    assert f"{torn} is no IP-Adapter of this UNet" in line_when_used(
        checkpoints / "sd", ip_adapter=torn, image_encoder=other
    )


def test_libraries_that_are_not_installed(checkpoints, monkeypatch):
    monkeypatch.setattr("diga3d_warp.checkpoints.find_spec", lambda name: None)
    assert line(checkpoints / "sd").endswith("not installed: pip install 'diga3d-warp[diffusion]'")


def test_the_schedule_is_that_of_the_file(tmp_path):
    from diffusers import DDIMScheduler

    scheduler = DDIMScheduler(beta_schedule="linear", steps_offset=0, prediction_type="v_prediction")
    scheduler.save_pretrained(tmp_path)
    schedule, prediction = read_schedule(tmp_path / "scheduler_config.json")
    torch.testing.assert_close(schedule.alphas_cumprod.float(), scheduler.alphas_cumprod)
    assert (schedule.final, schedule.offset, prediction) == (1.0, 0, "v_prediction")


def test_schedules_that_ddim_cannot_use(tmp_path):
    file = tmp_path / "scheduler_config.json"
    for settings, said in (
        ({"beta_schedule": "squaredcos_cap_v2"}, "noise levels 'squaredcos_cap_v2' are not supported"),
        ({"rescale_betas_zero_snr": True}, "are not supported"),
        ({"prediction_type": "flow"}, "prediction 'flow' is not supported"),
    ):
        file.write_text(json.dumps(settings), encoding="utf-8")
        with pytest.raises(InputError, match=said):
            read_schedule(file)
