"""LaMa from ONNX: both published forms, any size of image, seams, and files that are no LaMa."""

import numpy as np
import pytest
import torch
from onnx_networks import FREE, write_lama

from diga3d_warp import cli
from diga3d_warp.errors import InputError
from diga3d_warp.priors.lama import LAMA, LamaSettings, load_lama
from diga3d_warp.priors.named import load_prior

FORMS = {
    "two inputs, fixed, 255": {"size": (64, 64), "unit": 255.0},
    "two inputs, any size": {"size": FREE},
    "one input, any size": {"joined": True, "size": FREE},
    "one input, fixed": {"joined": True, "size": (64, 96)},
}


def picture(height: int, width: int) -> tuple[torch.Tensor, torch.Tensor]:
    """A shaded wall of bricks, and a mask in it."""
    rows, columns = np.mgrid[:height, :width]
    bricks = 0.5 + 0.2 * ((rows // 6 + columns // 12) % 2) + 0.2 * columns / width
    image = torch.from_numpy((bricks[..., None] * [1.0, 0.8, 0.6]).astype(np.float32))
    mask = torch.zeros((height, width), dtype=torch.bool)
    mask[height // 3 : height // 2, width // 4 : width // 2] = True
    return image, mask


@pytest.fixture(params=FORMS.values(), ids=FORMS)
def lama(request, tmp_path):
    return load_lama(write_lama(tmp_path / "lama.onnx", **request.param))


@pytest.mark.parametrize("size", [(48, 64), (31, 45), (200, 330)])
def test_masked_pixels_are_filled_and_no_others_change(lama, size):
    image, mask = picture(*size)
    filled = lama.fill(image, mask)
    assert torch.equal(filled[~mask], image[~mask])
    inside = filled[mask]
    assert bool(inside.isfinite().all()) and float(inside.min()) > 0.2 and float(inside.max()) < 1.0
    assert float(inside.std()) > 0.01  # not one colour
    assert torch.equal(filled, lama.fill(image, mask, seed=3))


def test_what_is_masked_is_not_looked_at(lama):
    image, mask = picture(96, 160)
    spoiled = torch.where(mask[..., None], torch.rand(image.shape), image)
    assert torch.allclose(lama.fill(image, mask), lama.fill(spoiled, mask), atol=2e-2)


def test_the_fill_takes_the_tone_of_its_rim(tmp_path):
    """This network darkens; at the rim the fill still is nearly as light as the wall."""
    prior = load_lama(write_lama(tmp_path / "dark.onnx", scale=0.3))
    image, mask = torch.full((96, 160, 3), 0.7), picture(96, 160)[1]
    filled = prior.fill(image, mask)
    inside = filled[32:48, 40:80].mean(dim=(1, 2))
    assert float(inside[0]) > 0.6 and float(inside[-1]) > 0.6
    assert float(inside[7]) < float(inside[0]) - 0.05


def test_two_holes_far_from_each_other_are_filled_in_windows_of_their_own(tmp_path):
    prior = load_lama(write_lama(tmp_path / "lama.onnx"))
    image, mask = picture(96, 400)
    other = torch.zeros_like(mask)
    other[60:80, 360:380] = True
    both = prior.fill(image, mask | other)
    assert torch.allclose(both[mask], prior.fill(image, mask)[mask])
    assert torch.allclose(both[other], prior.fill(image, other)[other])


def test_an_empty_mask_returns_the_image(lama):
    image, mask = picture(64, 64)
    assert torch.equal(lama.fill(image, torch.zeros_like(mask)), image)


def test_a_full_mask_is_refused(lama):
    image, mask = picture(64, 64)
    with pytest.raises(InputError, match="covers the whole image"):
        lama.fill(image, torch.ones_like(mask))


def test_a_file_is_loaded_by_its_name(tmp_path):
    prior = load_prior(str(write_lama(tmp_path / "big-lama.ONNX")))
    assert prior.name == "lama" and prior.settings == LamaSettings()


def test_missing_weights_are_named_with_their_source(tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path))
    with pytest.raises(InputError, match=r"Carve/LaMa-ONNX.*0.2 GB.*hf download.*lama_fp32.onnx"):
        load_prior("lama")


def test_without_onnxruntime_the_extra_is_named(tmp_path, monkeypatch):
    path = write_lama(tmp_path / "lama.onnx")
    monkeypatch.setattr("diga3d_warp.priors.lama.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"onnxruntime is not installed: pip install 'diga3d-warp\[lama\]'"):
        load_lama(path)


def test_files_that_are_no_lama_are_refused_in_one_line(tmp_path):
    import onnx
    from onnx import TensorProto, helper

    cut = tmp_path / "cut.onnx"
    cut.write_bytes(write_lama(tmp_path / "lama.onnx").read_bytes()[:500])
    empty = tmp_path / "empty.onnx"
    empty.touch()
    other = tmp_path / "other.onnx"
    info = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 3, 64, 64]) for name in ("x", "y")]
    graph = helper.make_graph([helper.make_node("Neg", ["x"], ["y"])], "g", info[:1], info[1:])
    onnx.save(helper.make_model(graph, ir_version=9, opset_imports=[helper.make_opsetid("", 17)]), other)
    cases = {
        cut: "no ONNX network",
        empty: "no ONNX network",
        other: r"takes x \[1, 3, 64, 64\]; LaMa takes",
        tmp_path / "none.onnx": "no such file",
        write_lama(tmp_path / "wide.onnx", unit=9.0): "does not give back what is not masked",
    }
    for path, said in cases.items():
        with pytest.raises(InputError, match=said) as error:
            load_lama(path)
        assert "\n" not in str(error.value)


def test_numbers_that_are_not_finite_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"not finite|does not give back"):
        image, mask = picture(64, 64)
        load_lama(write_lama(tmp_path / "nan.onnx", scale=float("nan"))).fill(image, mask)


def test_the_command_line_refuses_a_missing_file(tmp_path, capfd):
    assert (
        cli.main(["remove", str(tmp_path), "--prior", str(tmp_path / "x.onnx"), "--out", str(tmp_path / "o")])
        == 2
    )
    assert "error" in capfd.readouterr().err
    assert LAMA.command == "hf download Carve/LaMa-ONNX --include 'lama_fp32.onnx'"
