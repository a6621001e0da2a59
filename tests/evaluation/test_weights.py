"""Weights files: where they are found, and what is refused."""

import random

import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.weights import WeightsFile, fill, read_tensors

FILE = WeightsFile("small.pth", "https://example.org/weights/", 3)


def saved(path, state, zipped=True):
    torch.save(state, path, _use_new_zipfile_serialization=zipped)
    return path


def test_the_given_folder_comes_before_the_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "cache"))
    FILE.home.parent.mkdir(parents=True)
    saved(FILE.home, {})
    assert FILE.find() == FILE.find(tmp_path) == FILE.home
    saved(tmp_path / "small.pth", {})
    assert FILE.find(tmp_path) == tmp_path / "small.pth"


def test_what_is_missing_is_named_with_size_and_command(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    (tmp_path / "small.pth").mkdir()
    with pytest.raises(InputError) as refused:
        FILE.find(tmp_path)
    assert str(refused.value) == (
        "small.pth (3 MB) is not on this machine: curl -L --create-dirs "
        f"-o {tmp_path}/hub/checkpoints/small.pth https://example.org/weights/small.pth"
    )


def test_torch_hubs_cache_is_where_torch_looks(monkeypatch, tmp_path):
    for name, value in (("TORCH_HOME", None), ("XDG_CACHE_HOME", str(tmp_path))):
        monkeypatch.delenv(name, raising=False) if value is None else monkeypatch.setenv(name, value)
    assert str(FILE.home.parent) == f"{torch.hub.get_dir()}/checkpoints"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert str(FILE.home.parent) == f"{torch.hub.get_dir()}/checkpoints"


@pytest.mark.parametrize("zipped", [True, False])
def test_a_part_of_a_file_or_the_whole(tmp_path, zipped):
    state = {"weight": torch.arange(6.0).reshape(2, 3)}
    path = saved(tmp_path / "x.pth", {"params": state, "epoch": 3}, zipped)
    torch.testing.assert_close(read_tensors(path, "params")["weight"], state["weight"])
    path = saved(tmp_path / "y.pth", state, zipped)
    assert list(read_tensors(path, "params")) == list(read_tensors(path)) == ["weight"]


@pytest.mark.parametrize("zipped", [True, False])
def test_damaged_files_are_one_line(tmp_path, zipped):
    path = saved(tmp_path / "x.pth", {f"layer{i}.weight": torch.rand(7, 3) for i in range(5)}, zipped)
    good, chance = path.read_bytes(), random.Random(4)
    for _ in range(60):
        damaged = bytearray(good[: chance.randrange(len(good))] if chance.random() < 0.4 else good)
        for _ in range(chance.choice((0, 3, 20)) if damaged else 0):
            damaged[chance.randrange(len(damaged))] = chance.randrange(256)
        path.write_bytes(damaged)
        try:
            read_tensors(path)
        except InputError as error:
            assert "\n" not in str(error) and str(path) in str(error)


@pytest.mark.parametrize(
    "content",
    [b"", b"PK", b"\x80\x02.", b"<html>404</html>", b"version https://git-lfs.github.com/spec/v1\n"],
)
def test_other_files_are_one_line(tmp_path, content):
    path = tmp_path / "x.pth"
    path.write_bytes(content)
    with pytest.raises(InputError, match="cannot be read: it is damaged, or holds more than tensors"):
        read_tensors(path)


@pytest.mark.parametrize("content", [3, [torch.zeros(2)], torch.zeros(2)])
def test_no_dictionary_is_one_line(tmp_path, content):
    with pytest.raises(InputError, match="holds no state dictionary"):
        read_tensors(saved(tmp_path / "x.pth", content))


@pytest.mark.parametrize(
    ("state", "said"),
    [
        ({"weight": torch.zeros(2, 3)}, "lacks bias"),
        ({"weight": torch.zeros(2, 3), "bias": [0.0, 0.0]}, "lacks bias"),
        ({"weight": torch.zeros(3, 2), "bias": torch.zeros(2)}, r"shape \(3, 2\), not \(2, 3\)"),
        ({"weight": torch.full((2, 3), float("inf")), "bias": torch.zeros(2)}, "not finite"),
        ({1: torch.zeros(2)}, "lacks weight"),
    ],
)
def test_another_networks_weights_are_one_line(tmp_path, state, said):
    with pytest.raises(InputError, match=said):
        fill(torch.nn.Linear(3, 2), state, tmp_path)


def test_half_precision_is_read_as_single(tmp_path):
    network = torch.nn.Linear(3, 2)
    state = {"weight": torch.ones(2, 3).half(), "bias": torch.zeros(2).half(), "other": torch.zeros(1)}
    fill(network, state, tmp_path)
    assert network.weight.dtype == torch.float32 and not network.weight.requires_grad
    assert network(torch.ones(3)).tolist() == [3.0, 3.0]
