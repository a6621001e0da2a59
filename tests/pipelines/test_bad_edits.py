"""Edits that cannot be made: refused in one line before the fit, or after it with the fit kept."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from diga3d_warp import cli
from diga3d_warp.scene.layouts.cameras_file import CameraSet, save_cameras
from diga3d_warp.scene.load import load_scene
from scenes import random_gaussians
from tiny_diffusion import write_checkpoint

EDITS = (["remove"], ["retexture", "--prompt", "gold"], ["replace", "--prompt", "a wooden cube"])

FILLED = (EDITS[0], EDITS[2])
"""Edits that have a prior fill the hole."""

LONG = "gold " * 2000


@pytest.mark.parametrize("command", EDITS)
def test_more_references_than_views(room, refused, command):
    refused([*command, str(room), "--references", "8"], "8 references cannot be chosen from 7 views")


@pytest.mark.parametrize("command", ["retexture", "replace"])
@pytest.mark.parametrize(
    ("prompt", "said"),
    [
        ("", "the prompt is empty"),
        (" ,.", "the prompt is empty"),
        (LONG, "the prompt has 10000 characters: give at most 1000"),
        ("a kryptonite cube", "names no built-in material"),
    ],
)
def test_prompts(room, refused, command, prompt, said):
    refused([command, str(room), "--prompt", prompt], said)


def test_a_prompt_without_a_solid(room, refused):
    refused(["replace", str(room), "--prompt", "a wooden unicorn"], "names no built-in solid")


@pytest.mark.parametrize("command", [["retexture"], ["replace", "--prompt", "a cube"]])
def test_pictures_of_a_material(room, refused, tmp_path, command):
    (tmp_path / "wood.jpg").write_text("hello")
    for file, said in (("wood.jpg", "not readable as an image"), ("absent.jpg", "no such picture")):
        refused([*command, str(room), "--exemplar", str(tmp_path / file)], f"{file}: {said}")


def test_a_picture_is_for_a_built_in_solid(room, refused):
    words = ["replace", str(room), "--asset", "a.glb", "--exemplar", "b.jpg"]
    refused(words, "--exemplar is the material of a built-in solid")


def test_a_material_is_named_or_shown(capsys):
    for words in ([], ["--prompt", "gold", "--exemplar", "gold.jpg"]):
        with pytest.raises(SystemExit) as stop:
            cli.main(["retexture", "scene", "--out", "run", *words])
        assert stop.value.code == 2
        error = capsys.readouterr().err
        assert "--exemplar" in error and error.count("\n") == 1


def absent(path: Path) -> None:
    """No file."""


def text(path: Path) -> None:
    path.write_text("this is no mesh")


def empty(path: Path) -> None:
    path.write_bytes(b"")


def cut_short(path: Path) -> None:
    trimesh.creation.icosphere().export(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 3])


def half_a_splat(path: Path) -> None:
    random_gaussians(60).save_ply(path)
    path.write_bytes(path.read_bytes()[:-7])


def splat_of_nothing(path: Path) -> None:
    gaussians = random_gaussians(60)
    gaussians.opacity_logits.fill_(float("nan"))
    gaussians.save_ply(path)


@pytest.mark.parametrize(
    ("name", "spoil"),
    [
        ("absent.glb", absent),
        ("folder.glb", Path.mkdir),
        ("text.glb", text),
        ("text.obj", text),
        ("text.stl", text),
        ("text.ply", text),
        ("text.docx", text),
        ("empty.glb", empty),
        ("empty.ply", empty),
        ("half.glb", cut_short),
        ("half.stl", cut_short),
        ("half.ply", half_a_splat),
        ("nan.ply", splat_of_nothing),
    ],
)
def test_assets(room, refused, tmp_path, name, spoil):
    spoil(tmp_path / name)
    refused(["replace", str(room), "--asset", str(tmp_path / name)], name)


@pytest.fixture(scope="module")
def prior(tmp_path_factory) -> Path:
    """A tiny inpainting prior with both ControlNets; not to be changed."""
    folder = tmp_path_factory.mktemp("priors") / "sd"
    write_checkpoint(folder)
    return folder


def without(part: str):
    def spoil(folder: Path) -> None:
        shutil.rmtree(folder / part)

    return spoil


def pickled(folder: Path) -> None:
    weights = folder / "unet" / "diffusion_pytorch_model.safetensors"
    weights.rename(weights.with_suffix(".bin"))


def cut_weights(folder: Path) -> None:
    weights = folder / "vae" / "diffusion_pytorch_model.safetensors"
    weights.write_bytes(weights.read_bytes()[:-500])


def emptied(folder: Path) -> None:
    shutil.rmtree(folder)
    folder.mkdir()


def a_file(folder: Path) -> None:
    shutil.rmtree(folder)
    folder.write_text("weights")


def no_words(folder: Path) -> None:
    (folder / "tokenizer" / "tokenizer.json").unlink()


@pytest.mark.parametrize("command", FILLED)
@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (shutil.rmtree, "there is no prior or folder"),
        (a_file, "is not a folder"),
        (emptied, "lacks config.json"),
        (pickled, "diffusion_pytorch_model.bin is a pickle"),
        (cut_weights, "vae/diffusion_pytorch_model.safetensors cannot be read"),
        (no_words, "holds no tokenizer"),
        *((without(part), part) for part in ("unet", "vae", "text_encoder", "tokenizer", "scheduler")),
        (without("controlnet-edges"), "lllyasviel/sd-controlnet-canny"),
        (without("controlnet-depth"), "lllyasviel/sd-controlnet-depth"),
    ],
)
def test_prior_folders(room, refused, prior, tmp_path, monkeypatch, command, spoil, said):
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path))
    shutil.copytree(prior, tmp_path / "prior")
    spoil(tmp_path / "prior")
    refused([*command, str(room), "--prior", str(tmp_path / "prior")], said)


@pytest.mark.parametrize("command", FILLED)
@pytest.mark.parametrize("name", ["sd-inpainting", "powerpaint"])
def test_priors_that_were_never_downloaded(room, refused, tmp_path, monkeypatch, command, name):
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path))
    refused([*command, str(room), "--prior", name], "GB) are not on this machine: run hf download")


@pytest.mark.parametrize("command", FILLED)
def test_negative_prompts(room, refused, prior, command):
    refused([*command, str(room), "--negative", LONG], "10000 characters")
    refused([*command, str(room), "--negative", LONG, "--prior", str(prior)], "shorten it")


@pytest.mark.parametrize("command", EDITS)
def test_masks_that_lift_to_no_gaussian(room, tmp_path, capfd, command):
    """Only a splat can tell. What was done until then is kept; nothing looks like a result."""
    scene, run = tmp_path / "scene", tmp_path / "run"
    shutil.copytree(room, scene, ignore=shutil.ignore_patterns("ground_truth"))
    save_cameras(scene / "cameras.json", CameraSet.of(load_scene(scene)))
    shutil.rmtree(scene / "sparse")
    random_gaussians(60).save_ply(scene / "splat.ply")
    for file in (scene / "masks").iterdir():
        mask = np.zeros((72, 96), np.uint8)
        mask[:2, :2] = 255
        cv2.imwrite(str(file), mask)
    assert cli.main([*command, str(scene), "--out", str(run)]) == 2
    written = capfd.readouterr()
    (line,) = [line for line in written.err.replace("\r", "\n").splitlines() if "error" in line]
    assert "the masks lift to no gaussian; do they belong to these images?" in line
    assert "Traceback" not in written.err and written.out == ""
    assert (run / "stages" / "fit" / "point_cloud.ply").is_file()
    assert not (run / "point_cloud.ply").exists() and not (run / "views").exists()
