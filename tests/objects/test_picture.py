"""A photograph as a material: seamless, evenly lit, and refused in one line where it is not usable."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from diga3d_warp.errors import InputError
from diga3d_warp.materials.vocabulary import MATERIALS
from diga3d_warp.objects.picture import chosen_material, opaque_square, picture_material, seamless
from diga3d_warp.objects.solids import solid_of
from written_files import announced


def photograph(name: str) -> np.ndarray:
    """A material that does not repeat within the frame, under light from the right, shape (200, 230, 3)."""
    painted = MATERIALS[name].exemplar(256, 3)[20:220, 10:240]
    return np.clip(painted * np.linspace(0.7, 1.0, 230)[:, None], 0.0, 1.0)


def save(path: Path, image: np.ndarray) -> Path:
    cv2.imwrite(str(path), (image * 255).round().astype(np.uint8)[..., ::-1])
    return path


def jumps(texture: np.ndarray, axis: int) -> tuple[float, float]:
    """Mean difference of neighbours across the edge where repeats meet, and within."""
    steps = np.abs(texture - np.roll(texture, 1, axis)).mean(axis=2)
    return float(steps.take(0, axis).mean()), float(steps.take(range(1, texture.shape[axis]), axis).mean())


@pytest.mark.parametrize("name", ["brick", "grass", "marble", "wood"])
def test_repeats_meet_without_a_seam(name):
    picture = photograph(name)[:, :200]
    texture = seamless(picture)
    assert texture.shape[0] > 100 and texture.std() > 0.02
    for axis in (0, 1):
        seam, within = jumps(texture, axis)
        assert seam < 1.5 * within + 0.01
    before = max(jumps(picture, axis)[0] / jumps(picture, axis)[1] for axis in (0, 1))
    after = max(jumps(texture, axis)[0] / jumps(texture, axis)[1] for axis in (0, 1))
    assert after < 0.75 * before, "there was a seam"


def test_light_from_one_side_is_taken_out():
    picture = photograph("grass")[:, :200]
    texture = seamless(picture)
    assert picture[:, 150:].mean() - picture[:, :50].mean() > 0.05
    third = texture.shape[1] // 3
    assert abs(texture[:, -third:].mean() - texture[:, :third].mean()) < 0.02
    assert np.allclose(texture.mean(axis=(0, 1)), picture.mean(axis=(0, 1)), atol=0.03)


def test_one_colour_stays_one_colour():
    texture = seamless(np.full((64, 64, 3), (0.1, 0.5, 0.9)))
    assert np.allclose(texture, (0.1, 0.5, 0.9))


def test_the_middle_square_at_any_size(tmp_path):
    material = picture_material(save(tmp_path / "blue.png", photograph("brick")[..., ::-1]))
    for side in (64, 512):
        texture = material.exemplar(side, 0)
        assert texture.shape == (side, side, 3) and texture.dtype == np.float32
        assert texture.min() >= 0.0 and texture.max() <= 1.0
        assert texture[..., 2].mean() > 1.5 * texture[..., 0].mean()
        assert np.array_equal(texture, material.exemplar(side, 1))


def test_a_turned_photograph_is_set_upright(tmp_path):
    """Stored lying on its side, as telephones do, with a note how to turn it."""
    from PIL import Image

    stripes = np.zeros((96, 96, 3), np.uint8)
    stripes[:, ::8] = stripes[:, 1::8] = 200  # upright
    picture, exif = Image.fromarray(stripes), Image.Exif()
    exif[0x0112] = 6
    picture.save(tmp_path / "turned.png", exif=exif)
    texture = picture_material(tmp_path / "turned.png").exemplar(64, 0)
    assert texture.mean(axis=1).std() > 5 * texture.mean(axis=0).std(), "they lie when set upright"


def test_a_prompt_is_read_without_a_picture():
    assert chosen_material("white marble", None) is MATERIALS["marble"]


def test_a_solid_takes_the_picture(tmp_path):
    cube = solid_of("a cube", 0, save(tmp_path / "blue.png", photograph("brick")[..., ::-1]))
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (500, 3))
    points[:, 0] = 0.5
    colors = cube.painter(
        np.zeros(500, int), np.ones((500, 3)) / 3, points, np.tile([1.0, 0.0, 0.0], (500, 1))
    )
    assert colors.std(axis=0).max() > 0.05
    assert colors[:, 2].mean() > 1.5 * colors[:, 0].mean()


def cut_out(shape, noise_size=120) -> np.ndarray:
    """Blue bricks where a matte is opaque, noise where it is not, BGR and alpha."""
    rng = np.random.default_rng(0)
    pixels = rng.integers(0, 255, (noise_size, noise_size, 4), np.uint8)
    pixels[..., 3] = 255 * shape
    bricks = (MATERIALS["brick"].exemplar(noise_size, 3) * 255).astype(np.uint8)
    pixels[..., :3] = np.where(shape[..., None], bricks, pixels[..., :3])
    return pixels


def disc(radius: float, size: int = 120) -> np.ndarray:
    y, x = np.mgrid[:size, :size] - size / 2
    return np.hypot(x, y) < radius


def test_only_opaque_pixels_are_used(tmp_path):
    """What lies under transparent pixels is whatever the exporter left there."""
    cv2.imwrite(str(tmp_path / "bricks.png"), cut_out(disc(50)))
    material = picture_material(tmp_path / "bricks.png")
    assert material.notes == ("bricks.png: 71 x 71 px of it are used, the largest opaque square",)
    texture = material.exemplar(64, 0)
    assert texture[..., 2].mean() > 1.5 * texture[..., 0].mean(), "bricks, read as blue"
    whole = (MATERIALS["brick"].exemplar(120, 3)[..., ::-1]).mean((0, 1))
    assert np.allclose(texture.mean((0, 1)), whole, atol=0.06)


def test_a_square_off_the_middle_is_found():
    alpha = np.zeros((90, 140), np.uint8)
    alpha[10:60, 80:135] = 255
    rows, columns = opaque_square(alpha)
    assert rows == slice(10, 59) or rows == slice(11, 60)
    assert columns.stop - columns.start == 49 and columns.start >= 80 and columns.stop <= 135
    assert (alpha[rows, columns] == 255).all()


def test_partly_opaque_pixels_have_their_own_colour(tmp_path):
    picture = np.full((64, 64, 4), (200, 100, 0, 140), np.uint8)
    cv2.imwrite(str(tmp_path / "glass.png"), picture)
    texture = picture_material(tmp_path / "glass.png").exemplar(64, 0)
    assert np.allclose(texture, np.array([0, 100, 200]) / 255, atol=0.01)


def sixteen_bits() -> np.ndarray:
    return (photograph("wood")[..., ::-1] * 65535).astype(np.uint16)


def grey() -> np.ndarray:
    return (photograph("brick").mean(2) * 255).astype(np.uint8)


@pytest.mark.parametrize(("make", "name"), [(sixteen_bits, "wood"), (grey, "brick")])
def test_pictures_of_every_depth(tmp_path, make, name):
    cv2.imwrite(str(tmp_path / "picture.png"), make())
    texture = picture_material(tmp_path / "picture.png").exemplar(128, 0)
    plain = picture_material(save(tmp_path / "plain.png", photograph(name))).exemplar(128, 0)
    if make is grey:
        assert np.ptp(texture, axis=2).max() < 0.01
        plain = plain.mean(2, keepdims=True)
    assert np.allclose(texture.mean((0, 1)), plain.mean((0, 1)), atol=0.02) and texture.std() > 0.02


def test_one_colour_is_noted(tmp_path):
    material = picture_material(save(tmp_path / "red.png", np.full((40, 40, 3), (0.8, 0.1, 0.1))))
    assert material.notes == ("red.png: it shows one colour and no texture",)
    assert solid_of("a cube", 0, tmp_path / "red.png").notes == material.notes


def bomb(path: Path) -> None:
    path.write_bytes(announced(30000, 30000))


def transparent(path: Path) -> None:
    cv2.imwrite(str(path), cut_out(np.zeros((120, 120), bool)))


def hardly_opaque(path: Path) -> None:
    cv2.imwrite(str(path), cut_out(disc(15)))


def one_pixel(path: Path) -> None:
    cv2.imwrite(str(path), np.zeros((1, 1, 3), np.uint8))


def absent(path: Path) -> None:
    path.unlink()


def words(path: Path) -> None:
    path.write_text("hello")


def cut_short(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:400])


def empty(path: Path) -> None:
    path.write_bytes(b"")


def folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def tiny(path: Path) -> None:
    cv2.imwrite(str(path), np.zeros((31, 400, 3), np.uint8))


BAD_PICTURES = {
    absent: "no such picture",
    folder: "no such picture",
    words: "not readable as an image",
    empty: "not readable as an image",
    cut_short: "cut short",
    tiny: "400 x 31 px; give at least 32",
    one_pixel: "1 x 1 px; give at least 32",
    bomb: "30000 x 30000 px; images of more than",
    transparent: "alpha is 0 everywhere",
    hardly_opaque: "its largest square without transparent pixels is 21 x 21 px",
}


@pytest.mark.parametrize("spoil", BAD_PICTURES)
def test_pictures_that_cannot_be_used(tmp_path, spoil):
    path = save(tmp_path / "wood.png", photograph("wood"))
    spoil(path)
    with pytest.raises(InputError, match=f"wood.png: .*{BAD_PICTURES[spoil]}") as error:
        picture_material(path)
    assert "\n" not in str(error.value)
