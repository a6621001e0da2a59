"""LPIPS against the package of its authors, and where its right value is known."""

import math

import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.lpips import ALEX, VGG, Lpips
from tiny_metrics import write_backbone

pytest.importorskip("torchmetrics", reason="needs the extra [metrics]")
pytest.importorskip("torchvision", reason="needs the extra [metrics]")

BACKBONES = {backbone.net: backbone for backbone in (VGG, ALEX)}


@pytest.fixture(scope="module", params=["vgg", "alex"])
def measure(request, weights_of) -> Lpips:
    return Lpips(BACKBONES[request.param], weights_of(request.param))


def pictures(height=34, width=40):
    generator = torch.Generator().manual_seed(7)
    first = torch.rand(height, width, 3, generator=generator)
    return first, (first + 0.3 * torch.rand(height, width, 3, generator=generator)).clamp(0, 1)


def published(measure, spatial):
    """The authors' own network on the same weights."""
    lpips = pytest.importorskip("lpips", reason="the reference")
    with torch.device("meta"):  # their linear layers, read below
        network = lpips.LPIPS(
            net=measure.backbone.net, pretrained=False, pnet_rand=True, spatial=spatial, verbose=False
        )
    network.scaling_layer = lpips.ScalingLayer()
    file = f"{lpips.__path__[0]}/weights/v0.1/{measure.backbone.net}.pth"
    linear = torch.load(file, map_location="cpu", weights_only=True)
    state = {f"net.{name}": value for name, value in measure.network.net.state_dict().items()}
    state |= linear | {name.replace("lin", "lins.", 1): value for name, value in linear.items()}
    state |= {f"scaling_layer.{name}": value for name, value in network.scaling_layer.state_dict().items()}
    network.load_state_dict(state, assign=True)
    return network.eval()


@pytest.mark.filterwarnings("ignore::UserWarning")  # the package names an old argument of torchvision
def test_equal_to_the_authors_package(measure):
    first, second = pictures()
    one, other = (array.permute(2, 0, 1)[None] for array in (first, second))
    with torch.no_grad():
        whole = float(published(measure, False)(one, other, normalize=True))
        around = published(measure, True)(one, other, normalize=True)[0, 0]
    assert whole > 0.01
    assert measure.whole(first, second) == pytest.approx(whole, abs=1e-5)
    torch.testing.assert_close(measure.spatial(first, second), around, atol=1e-5, rtol=0)


def test_regions(measure):
    first, second = pictures()
    mask = torch.zeros(first.shape[:2], dtype=torch.bool)
    mask[2:33, 4:36] = True
    scores = measure.scores(first, second, mask)
    around = measure.spatial(first, second)
    assert list(scores) == ["whole", "masked", "box", "unmasked"]
    assert scores["masked"] == pytest.approx(float(around[mask].mean()), abs=1e-6)
    assert scores["box"] == pytest.approx(measure.whole(first[2:33, 4:36], second[2:33, 4:36]), abs=1e-6)
    for region, value in scores.items():
        assert measure.scores(first, second, mask, (region,)) == pytest.approx({region: value})
    inside = torch.where(mask[..., None], second, first)
    assert measure.scores(inside, first, mask)["unmasked"] == 0.0, "equal outside of the mask"
    assert scores["unmasked"] > 0.001


def test_equal_pictures_have_no_distance(measure):
    first, _ = pictures()
    grey = first.mean(-1, keepdim=True).expand(-1, -1, 3)
    mask = torch.zeros(first.shape[:2], dtype=torch.bool)
    mask[0, 0] = True
    for picture in (grey, torch.zeros_like(first)):
        assert set(measure.scores(picture, picture.clone(), mask).values()) == {0.0}


def test_a_constant_shift_is_small_against_other_contents(measure):
    first, _ = pictures()
    first = 0.8 * first
    shifted, other = measure.whole(first, first + 0.02), measure.whole(first, pictures()[0].flip(0))
    assert 0.0 < shifted < 0.5 * other


def test_one_pixel_and_none(measure):
    first, second = pictures()
    mask = torch.zeros(first.shape[:2], dtype=torch.bool)
    assert set(measure.scores(first, second, mask)) == {"whole", "unmasked"}
    assert set(measure.scores(first, second, ~mask)) == {"whole", "masked", "box"}
    assert set(measure.scores(first, second)) == {"whole"}
    mask[33, 39] = True
    scores = measure.scores(first, second, mask)
    assert scores["masked"] == pytest.approx(float(measure.spatial(first, second)[33, 39]), abs=1e-6)
    side = measure.backbone.smallest
    corner = measure.whole(first[-side:, -side:], second[-side:, -side:])
    assert scores["box"] == pytest.approx(corner, abs=1e-6), "the box is grown to what the network takes"


def test_smallest_picture(measure):
    side = measure.backbone.smallest
    first, second = pictures(side, side)
    assert math.isfinite(measure.scores(first, second)["whole"])
    with pytest.raises(RuntimeError):
        measure.whole(first[:-1], second[:-1])
    assert measure.scores(first[:-1], second[:-1]) == {}


def test_what_is_wrong_with_the_weights_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "hub"))
    with pytest.raises(
        InputError, match=r"alexnet-owt-7be5be79\.pth \(244 MB\) .*curl -L .*download\.pytorch"
    ):
        Lpips(ALEX)
    path = write_backbone(tmp_path, "alex")
    state = torch.load(path, weights_only=True)
    for change, said in (
        ({"features.0.weight": None}, r"lacks slice1\.0\.weight"),
        ({"features.0.bias": torch.zeros(3)}, r"of shape \(3,\), not \(64,\)"),
        ({"features.0.bias": torch.full((64,), math.nan)}, "not finite"),
    ):
        torch.save({**state, **change}, path)
        with pytest.raises(InputError, match=said):
            Lpips(ALEX, tmp_path)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(InputError, match="cannot be read"):
        Lpips(ALEX, tmp_path)
    path.write_bytes(b"")
    with pytest.raises(InputError, match="cannot be read"):
        Lpips(ALEX, tmp_path)


def test_weights_that_run_code_are_refused(tmp_path):
    class Trap:
        def __reduce__(self):
            return (open, (str(tmp_path / "trap"), "w"))

    torch.save({"features.0.weight": Trap()}, tmp_path / ALEX.file.name)
    with pytest.raises(InputError, match="cannot be read"):
        Lpips(ALEX, tmp_path)
    assert not (tmp_path / "trap").exists()


def test_weights_in_torch_hubs_cache_are_found(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    assert ALEX.file.home == tmp_path / "hub" / "checkpoints" / ALEX.file.name
    assert str(torch.hub.get_dir()) == str(tmp_path / "hub")
    write_backbone(ALEX.file.home.parent, "alex")
    assert ALEX.file.find(tmp_path / "elsewhere") == ALEX.file.home
