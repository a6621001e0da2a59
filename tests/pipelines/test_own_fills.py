"""Views filled by another program: which are read, and what is said of those that are not the view."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from diga3d_warp.errors import InputError
from diga3d_warp.pipelines.own_fills import CHECK, read_fills


@pytest.fixture
def scene(toy_run):
    """Six training views with masks, over a shaded wall so that shifts and turns show."""
    rows, columns = np.mgrid[:36, :48]
    wall = 60 + 2 * rows[..., None] + np.array([1, 2, 0]) * columns[..., None]
    views = [
        replace(view, pixels=np.clip(view.pixels * 0.5 + wall * 0.5 + 8 * n, 0, 255).astype(np.uint8))
        for n, view in enumerate(toy_run.scene.views)
    ]
    return replace(toy_run.scene, views=views)


def filled(view):
    """The photograph with turf where the mask is."""
    turf = np.random.default_rng(1).integers(80, 160, view.pixels.shape).astype(np.uint8)
    return np.where(view.mask[..., None], turf, view.pixels)


def write(path, pixels, *options):
    assert cv2.imwrite(str(path), np.ascontiguousarray(pixels[..., ::-1]), options)
    return path


def detailed(scene, width, height, blur):
    """The first view with a texture of some pixels, and a mask in the middle."""
    noise = np.random.default_rng(3).integers(0, 256, (height, width, 3)).astype(np.uint8)
    pixels = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), blur), None, 0, 255, cv2.NORM_MINMAX)
    mask = np.zeros((height, width), bool)
    mask[height * 5 // 12 : height * 5 // 8, width * 5 // 12 : width * 5 // 8] = True
    camera = scene.views[0].camera.resized(width, height)
    return replace(scene.views[0], pixels=pixels, mask=mask, camera=camera)


def test_images_are_read_by_name_or_from_a_folder(scene, tmp_path):
    one, two = scene.views[0], scene.views[3]
    folder = tmp_path / "fills"
    folder.mkdir()
    write(folder / f"{two.name}.png", filled(two))
    file = write(tmp_path / "mine.png", filled(one))
    fills = read_fills([f"{one.name}={file}", folder], scene)
    assert list(fills) == [one.name, two.name]
    assert np.array_equal(fills[one.name], filled(one)) and np.array_equal(fills[two.name], filled(two))
    assert read_fills([], scene) == {}


def test_a_name_may_carry_its_ending(scene, tmp_path):
    view = scene.views[0]
    file = write(tmp_path / "mine.png", filled(view))
    assert list(read_fills([f"{view.name}.jpg={file}"], scene)) == [view.name]


def test_a_jpeg_is_the_view_still(scene, tmp_path):
    view = scene.views[1]
    file = write(tmp_path / "mine.jpg", filled(view), cv2.IMWRITE_JPEG_QUALITY, 60)
    assert list(read_fills([f"{view.name}={file}"], scene)) == [view.name]


@pytest.mark.parametrize("quality", [95, 50])
def test_a_jpeg_of_a_small_detailed_view_is_that_view_still(scene, tmp_path, quality):
    """Its blocks are large there, and its colours have half the resolution."""
    view = detailed(scene, 96, 72, 0.8)
    capture = replace(scene, views=[view, *scene.views[1:]])
    file = write(tmp_path / "mine.jpg", filled(view), cv2.IMWRITE_JPEG_QUALITY, quality)
    assert list(read_fills([f"{view.name}={file}"], capture)) == [view.name]
    turned = write(tmp_path / "turned.jpg", np.rot90(filled(view), 2), cv2.IMWRITE_JPEG_QUALITY, quality)
    with pytest.raises(InputError, match="turned by 180 degrees"):
        read_fills([f"{view.name}={turned}"], capture)


def test_without_masks_most_pixels_must_be_the_photographs(scene, tmp_path):
    view = scene.views[0]
    plain = replace(scene, views=[each.with_mask(None) for each in scene.views])
    file = write(tmp_path / "mine.png", filled(view))
    assert list(read_fills([f"{view.name}={file}"], plain)) == [view.name]
    other = write(tmp_path / "other.png", 255 - view.pixels)
    with pytest.raises(InputError, match=r"differs from|other colours"):
        read_fills([f"{view.name}={other}"], plain)


def shifted(pixels):
    return np.roll(pixels, (3, 5), axis=(0, 1))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (np.zeros_like, "is black"),
        (lambda pixels: np.rot90(pixels, 2), "turned by 180 degrees"),
        (lambda pixels: pixels[:, ::-1], "mirrored left to right"),
        (lambda pixels: pixels[::-1], "mirrored upside down"),
        (np.rot90, "36 x 48 px, which is turned by 90 degrees, but view_1 is read at 48 x 36 px"),
        (lambda pixels: pixels[:-4, :-4], "44 x 32 px, but view_1 is read at 48 x 36 px"),
        (lambda pixels: np.clip(pixels.astype(int) + [30, 20, 10], 0, 255).astype(np.uint8), "other colours"),
        (lambda pixels: np.random.default_rng(0).integers(0, 255, pixels.shape).astype(np.uint8), "differs"),
    ],
)
def test_what_is_not_the_view_is_refused_and_named(scene, tmp_path, change, said):
    view = scene.views[0]
    file = write(tmp_path / "mine.png", change(filled(view)))
    with pytest.raises(InputError) as error:
        read_fills([f"{view.name}={file}"], scene)
    assert said in str(error.value) and str(file) in str(error.value) and "\n" not in str(error.value)


def masked(view, color):
    return np.where(view.mask[..., None], np.uint8(color), view.pixels)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_a_hole_that_was_not_filled_is_refused(scene, tmp_path, suffix):
    """The photograph itself, and holes that are black, white or transparent, as masks are exported."""
    view = detailed(scene, 96, 72, 1.5)
    capture = replace(scene, views=[view, *scene.views[1:]])
    file = write(tmp_path / f"mine{suffix}", view.pixels)
    with pytest.raises(InputError, match="view_1 with the object still there; give the image without it"):
        read_fills([f"{view.name}={file}"], capture)
    for color in ((0, 0, 0), (255, 255, 255), (255, 0, 255)):
        write(file, masked(view, color))
        with pytest.raises(InputError, match="one colour fills its mask; give the image with the hole"):
            read_fills([f"{view.name}={file}"], capture)
    transparent = np.dstack([view.pixels, np.where(view.mask, 0, 255).astype(np.uint8)])
    assert cv2.imwrite(str(tmp_path / "hole.png"), transparent[..., [2, 1, 0, 3]])
    with pytest.raises(InputError, match=r"one colour fills|object still there"):
        read_fills([f"{view.name}={tmp_path / 'hole.png'}"], capture)


def test_a_plain_wall_goes_on_in_its_colour(scene, tmp_path):
    view = detailed(scene, 96, 72, 1.5)
    plain = np.full_like(view.pixels, 170)
    object_on_wall = replace(view, pixels=np.where(view.mask[..., None], view.pixels, plain))
    capture = replace(scene, views=[object_on_wall, *scene.views[1:]])
    file = write(tmp_path / "mine.png", plain)
    assert list(read_fills([f"{view.name}={file}"], capture)) == [view.name]


def test_another_view_is_named(scene, tmp_path):
    one, other = scene.views[0], scene.views[4]
    file = write(tmp_path / "mine.png", filled(other))
    with pytest.raises(InputError, match=f"shows {other.name}, not {one.name}"):
        read_fills([f"{one.name}={file}"], scene)


def test_a_shift_is_measured(tmp_path, scene):
    """On a photograph with detail."""
    view = detailed(scene, 192, 144, 2.0)
    capture = replace(scene, views=[view, *scene.views[1:]])
    file = write(tmp_path / "mine.png", shifted(filled(view)))
    with pytest.raises(InputError, match="is shifted against view_1 by 5 px across and 3 px down"):
        read_fills([f"{view.name}={file}"], capture)


def test_arguments_that_name_nothing(scene, tmp_path):
    view = scene.views[0]
    file = write(tmp_path / "mine.png", filled(view))
    empty = tmp_path / "empty"
    empty.mkdir()
    (tmp_path / "text.png").write_text("no image")
    cases = {
        f"nowhere={file}": "there is no view nowhere; views are view_1",
        f"{scene.test_views[0].name}={file}": "held out for testing",
        f"{view.name}={tmp_path / 'none.png'}": "no such file",
        f"{view.name}=": "not of the form VIEW=IMAGE",
        str(file): "not of the form VIEW=IMAGE",
        str(empty): "holds no images",
        f"{view.name}={tmp_path / 'text.png'}": "text.png",
    }
    for entry, said in cases.items():
        with pytest.raises(InputError) as error:
            read_fills([entry], scene)
        assert said in str(error.value) and "\n" not in str(error.value), entry
    with pytest.raises(InputError, match="filled twice"):
        other = write(tmp_path / "other.png", filled(view))
        read_fills([f"{view.name}={file}", f"{view.name}={other}"], scene)


def test_little_of_a_view_outside_the_mask_is_no_evidence(scene, tmp_path):
    view = scene.views[0].with_mask(np.ones((36, 48), bool))
    capture = replace(scene, views=[view, *scene.views[1:]])
    file = write(tmp_path / "mine.png", 255 - view.pixels)
    assert list(read_fills([f"{view.name}={file}"], capture)) == [view.name]
    assert CHECK.least_known > 0.0
