"""Where the object is, from boxes or words: found before the fit, carried to all views, or refused."""

from __future__ import annotations

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from tiny_removal import SETTINGS

from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.record import read_manifest
from diga3d_warp.perception.segmentation import TextSegmenter
from diga3d_warp.pipelines.marking import Marks, Words, mark, quick_masks
from diga3d_warp.pipelines.mask_propagation import SHEET
from diga3d_warp.pipelines.remove import remove_object
from diga3d_warp.pipelines.run import Run
from diga3d_warp.scene.photographs.decoding import turned
from diga3d_warp.scene.photographs.orientation import inverse

COMMANDS = (["remove"], ["retexture", "--prompt", "gold"], ["replace", "--prompt", "a wooden cube"])


def unmasked(scene):
    views, test_views = ([view.with_mask(None) for view in part] for part in (scene.views, scene.test_views))
    return replace(scene, views=views, test_views=test_views)


@pytest.fixture
def hits(removed, models, monkeypatch):
    """`see(*names)`: the models, which are random, find the true object in these views, none in others.

    Returns the names of the views that were looked at, too.
    """
    views = {view.pixels.tobytes(): view for view in removed.scene.views}
    looked: list[str] = []

    def see(*names: str) -> list[str]:
        def mask(_: TextSegmenter, image: torch.Tensor, prompt: str) -> torch.Tensor:
            view = views[(image * 255).round().byte().numpy().tobytes()]
            assert prompt == "a vase"
            looked.append(view.name)
            return torch.from_numpy(view.mask if view.name in names else np.zeros_like(view.mask))

        monkeypatch.setattr(TextSegmenter, "mask", mask)
        return looked

    return see


def test_words_mark_the_object(removed, models, hits, tmp_path):
    """The whole of a removal by words; the fit is taken from one by masks."""
    scene = unmasked(removed.scene)
    marks = Marks(words=Words("a vase", models))
    names = [view.name for view in scene.views]
    hits(*names[:3], *names[4:])
    run = Run(tmp_path / "run", "remove", {"seed": 0})
    shutil.copytree(removed.folder / "stages" / "fit", run.folder / "stages" / "fit")
    remove_object(scene, run, SETTINGS, marks=marks)

    manifest = read_manifest(run.folder)
    stages = [stage["name"] for stage in manifest["stages"]]
    assert stages[:5] == ["find", "effects", "fit", "propagate-masks", "lift"]
    (note,) = [note for note in manifest["notes"] if "mask prompt" in note]
    assert "finds nothing in 1 of 7 views" in note and note.endswith(f": {names[3]}")
    sheet = cv2.imread(str(run.folder / SHEET))
    assert sheet is not None and sheet.std() > 20
    for view in removed.scene.views:
        mask = cv2.imread(str(run.folder / "stages" / "propagate-masks" / f"{view.name}.png"), 0) > 127
        overlap = (mask & view.mask).sum() / (mask | view.mask).sum()
        assert overlap == 1.0 if view.name != names[3] else overlap > 0.45
    before, after = (removed_picture(run, side, names[3]) for side in ("before", "after"))
    inside = removed.scene.views[3].mask
    assert before.std() > 25 and np.abs(before - after)[inside].mean() > 15


def removed_picture(run: Run, side: str, name: str) -> np.ndarray:
    return cv2.imread(str(run.folder / "views" / side / f"{name}.png")).astype(np.float64)


def test_a_killed_search_goes_on(removed, models, hits, tmp_path, monkeypatch):
    scene = unmasked(removed.scene)
    marks = Marks(words=Words("a vase", models))
    names = [view.name for view in scene.views]
    looked = hits(*names)
    found = TextSegmenter.mask

    def killed(segmenter: TextSegmenter, image: torch.Tensor, prompt: str) -> torch.Tensor:
        if len(looked) == 4:
            raise KeyboardInterrupt
        return found(segmenter, image, prompt)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(TextSegmenter, "mask", killed)
        mark(Run(tmp_path / "run", "remove", {}), scene, marks)
    marked = mark(Run(tmp_path / "run", "remove", {}, resume=True), scene, marks)
    assert looked == names, "each view once"
    for view, true in zip(marked.views, removed.scene.views, strict=True):
        assert np.array_equal(view.mask, true.mask)
    assert all(view.mask is None for view in marked.test_views)


def test_a_glance_ends_at_the_first_hit(removed, models, hits):
    scene = unmasked(removed.scene)
    names = [view.name for view in scene.views]
    looked = hits(names[1], names[5])
    quick = quick_masks(scene, Marks(words=Words("a vase", models)))
    assert [view.name for view in quick.views if view.mask is not None] == [names[1]]
    assert looked == names[:2]


def test_words_that_no_view_shows(removed, models, hits, tmp_path, room, refused):
    hits()
    marks = Marks(words=Words("a vase", models))
    with pytest.raises(InputError, match="no view shows 'a vase'"):
        mark(Run(tmp_path / "api", "remove", {}), removed.scene, marks)
    words = ["--mask-prompt", "a vase", "--mask-models", str(models)]
    refused(["remove", str(room), *words], "no view shows 'a vase'; say it in other words")


@pytest.mark.parametrize("command", COMMANDS)
def test_weights_that_were_never_downloaded(room, tmp_path, refused, monkeypatch, command):
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path))
    said = (
        "the weights of IDEA-Research/grounding-dino-tiny (0.7 GB) are not on this machine: run hf download"
    )
    refused([*command, str(room), "--mask-prompt", "a vase"], said)


def without_cutter(folder):
    shutil.rmtree(folder / "cutter")


def pickled(folder):
    weights = folder / "detector" / "model.safetensors"
    weights.rename(weights.with_name("pytorch_model.bin"))


def cut_short(folder):
    weights = folder / "cutter" / "model.safetensors"
    weights.write_bytes(weights.read_bytes()[:1000])


def without_tokenizer(folder):
    for file in (folder / "detector").glob("*token*"):
        file.unlink()


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (shutil.rmtree, "detector is not a folder"),
        (without_cutter, "hf download facebook/sam-vit-base"),
        (pickled, "pytorch_model.bin is a pickle"),
        (cut_short, "cutter cannot be read"),
        (without_tokenizer, "detector holds no tokenizer"),
    ],
)
def test_models_that_cannot_be_used(room, models, tmp_path, refused, spoil, said):
    shutil.copytree(models, tmp_path / "models")
    spoil(tmp_path / "models")
    words = ["--mask-prompt", "a vase", "--mask-models", str(tmp_path / "models")]
    refused(["remove", str(room), *words], said)


@pytest.mark.parametrize(
    ("prompt", "said"),
    [("", "the mask prompt is empty"), (" . ", "is empty"), ("vase " * 2000, "shorten it")],
)
def test_prompts_that_cannot_be_used(room, models, refused, prompt, said):
    words = ["--mask-prompt", prompt, "--mask-models", str(models)]
    refused(["remove", str(room), *words], said)


BOX = ["--mask-box", "view_001", "1", "2", "30", "40"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([*BOX, "--masks", "masks"], "--masks and --mask-box each say where the object is"),
        ([*BOX, "--mask-prompt", "a vase"], "--mask-box and --mask-prompt each say"),
        (["--masks", "masks", "--mask-prompt", "a vase"], "--masks and --mask-prompt each say"),
        (["--mask-models", "models"], "--mask-models is read for --mask-prompt only"),
    ],
)
@pytest.mark.parametrize("command", COMMANDS)
def test_one_thing_says_where_the_object_is(room, refused, command, words, said):
    refused([*command, str(room), *words], said)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nobody", "1", "2", "30", "40"], "there is no view 'nobody'"),
        (["view_001", "1", "2", "300", "40"], "is not within its 96 x 72 px"),
        (["view_001", "30", "2", "30", "40"], "is not within its 96 x 72 px"),
        (["view_001", "-4", "2", "30", "40"], "is not within its 96 x 72 px"),
        (["view_001", "1", "2", "3", "x"], "are not four whole numbers"),
    ],
)
@pytest.mark.parametrize("command", COMMANDS)
def test_boxes_that_cannot_be_used(room, refused, command, words, said):
    refused([*command, str(room), "--mask-box", *words], said)


@pytest.mark.parametrize("orientation", [3, 6])
def test_words_are_looked_for_in_the_upright_photograph(removed, models, hits, orientation):
    """A photograph that is kept as stored is shown to the models as viewers show it."""
    view = removed.scene.views[0]
    hits(view.name)
    stored = replace(
        view, pixels=turned(view.pixels, inverse(orientation)), mask=None, orientation=orientation
    )
    quick = quick_masks(replace(removed.scene, views=[stored]), Marks(words=Words("a vase", models)))
    np.testing.assert_array_equal(quick.views[0].mask, turned(view.mask, inverse(orientation)))
