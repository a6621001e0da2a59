"""What a prompt says to those who know words only, and what of it is not followed."""

import numpy as np
import pytest

from diga3d_warp.errors import InputError
from diga3d_warp.materials.prompt import PROMPT_MOST, material_of, read_prompt
from diga3d_warp.materials.tint import COLORS, SHADES, Tint, from_oklab, oklab
from diga3d_warp.materials.vocabulary import MATERIALS

THINGS = {"cube": "cube", "box": "cube", "sphere": "sphere", "ball": "sphere"}


def test_every_word_of_the_vocabulary_names_its_material():
    for name, material in MATERIALS.items():
        for words in (name, *material.also):
            assert material_of(words) is material
    assert not set(COLORS) & {words for m in MATERIALS.values() for words in (m.name, *m.also)}


@pytest.mark.parametrize(
    ("prompt", "name"),
    [
        ("a bear made of White MARBLE", "marble"),
        ("polished black marble", "black marble"),
        ("a golden sphere on wooden legs", "gold"),
        ("Wood", "wood"),
        ("wool, knitted by hand", "knitted wool"),
    ],
)
def test_a_prompt_names_a_material(prompt, name):
    assert material_of(prompt).name == name


@pytest.mark.parametrize(
    ("prompt", "said"),
    [
        ("", "the prompt is empty"),
        (" \n\t?!", "the prompt is empty"),
        ("wood " * 2000, f"the prompt has 10000 characters: give at most {PROMPT_MOST}"),
        ("made of kryptonite", "'made of kryptonite' names no built-in material: use one of wood, walnut"),
        ("krypton\nite " * 60, "names no built-in material"),
    ],
)
def test_prompts_that_cannot_be_used(prompt, said):
    with pytest.raises(InputError) as caught:
        material_of(prompt)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_an_unknown_material_lists_all_and_names_the_priors_that_read_free_text():
    with pytest.raises(InputError) as caught:
        material_of("kryptonite")
    assert all(name in str(caught.value) for name in MATERIALS)
    assert "sd-inpainting" in str(caught.value) and "powerpaint" in str(caught.value)


def said(prompt: str, things=None) -> tuple[str | None, str | None, float, str]:
    """Material, colour, shade and thing that a prompt names."""
    reading = read_prompt(prompt, things)
    if reading.material is None:
        return None, None, 1.0, reading.thing
    tint = reading.material.tint or Tint()
    return reading.material.name, tint.color, tint.shade, reading.thing


@pytest.mark.parametrize(
    ("prompt", "material", "color", "shade"),
    [
        ("red wood", "wood", "red", 1.0),
        ("wood in red", "wood", "red", 1.0),
        ("wood, painted red", "wood", "red", 1.0),
        ("GREEN Marble!", "marble", "green", 1.0),
        ("dark-green marble", "marble", "green", SHADES["dark"]),
        ("light granite", "granite", None, SHADES["light"]),
        ("dark wood", "walnut", None, 1.0),
        ("white marble", "marble", None, 1.0),
        ("a bluish-grey slate", "slate", "grey", 1.0),
        ("brick red leather", "leather", "brick red", 1.0),
        ("red brick", "brick", "red", 1.0),
        ("bricks", "brick", None, 1.0),
        ("polka-dots", "polka dots", None, 1.0),
        ("wood-like", "wood", None, 1.0),
        ("lapis_lazuli", "lapis lazuli", None, 1.0),
        ("\uff37\uff4f\uff4f\uff44", "wood", None, 1.0),
        ("wood and blue steel", "wood", None, 1.0),
        ("red and white tiles", "tiles", "white", 1.0),
        ("steel with red stripes", "steel", None, 1.0),
        ("turquoise", "plaster", "turquoise", 1.0),
    ],
)
def test_a_colour_is_the_materials(prompt, material, color, shade):
    assert said(prompt)[:3] == (material, color, shade)


@pytest.mark.parametrize(
    ("prompt", "material", "color", "thing"),
    [
        ("a wooden cube on a marble table", "wood", None, "cube"),
        ("on a marble table, a wooden cube", "wood", None, "cube"),
        ("a red cube on a green wooden table", "wood", "green", "cube"),
        ("a big red marble ball", "marble", "red", "sphere"),
        ("two golden boxes and a wooden sphere", "gold", None, "cube"),
        ("a red cube of green marble", "marble", "green", "cube"),
        ("a cube made of red wood", "wood", "red", "cube"),
        ("a red cube", "plaster", "red", "cube"),
        ("a sphere; golden", "gold", None, "sphere"),
        ("a cube next to a ball of brass", "bronze", None, "cube"),
    ],
)
def test_a_material_is_that_of_the_thing(prompt, material, color, thing):
    name, tint, _, found = said(prompt, THINGS)
    assert (name, tint, found) == (material, color, thing)


@pytest.mark.parametrize(
    ("prompt", "notes"),
    [
        ("white marble", []),
        ("a sphere made of the finest of gold", ["not used of the prompt: 'finest'"]),
        ("a big polished wooden cube", ["not used of the prompt: 'big', 'polished'"]),
        ("3 wooden cubes", ["not used of the prompt: '3'"]),
        (
            "a wooden cube on a marble table",
            [
                "the prompt names several materials: wooden is used, not 'marble'",
                "not used of the prompt: 'table'",
            ],
        ),
        (
            "a golden cube beside a golden sphere",
            ["the prompt names several things: cube is used, not 'sphere'"],
        ),
        ("red and white tiles", ["not used of the prompt: 'red'"]),
        ("a cube on wood", ["the prompt names a material only for what stands beside the object: wood"]),
        ("a red cube", ["the prompt names a colour without a material: red plaster is used"]),
        ("wood " * 100, []),
        ("brass and bronze", []),
    ],
)
def test_what_is_not_followed_is_said(prompt, notes):
    assert list(read_prompt(prompt, THINGS).notes) == notes


@pytest.mark.parametrize(
    "prompt",
    [
        "not wood", "no wood", "Not WOOD.", "marble, without veins", "anything but gold", "it isn't wood",
        "it isn\u2019t wood", "non-wood", "wood-free", "free of wood", "steel instead of wood",
        "neither wood nor gold", "except marble", "don't use wood", "rather marble than wood",
        "other than wood", "hardly wood", "kein Gold",
    ],
)  # fmt: skip
def test_a_prompt_that_denies_is_refused(prompt):
    with pytest.raises(InputError, match="name the material that is wanted, not one that is not") as caught:
        material_of(prompt)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("prompt", "material", "unused"),
    [
        ("turn wood into marble", "marble", "'wood'"),
        ("replace the red oak with green marble", "marble", "'red', 'oak'"),
        ("from gold to steel", "steel", "'gold'"),
        ("wood turned to gold", "gold", "'wood'"),
        ("Change it to gold, on a table", "gold", "'table'"),
    ],
)
def test_of_a_change_only_what_is_wanted_counts(prompt, material, unused):
    reading = read_prompt(prompt)
    assert reading.material is not None and reading.material.name == material
    assert reading.notes == (f"not used of the prompt: {unused}",)


def test_a_change_into_something_unknown_is_refused():
    with pytest.raises(InputError, match="'turn wood into kryptonite' names no built-in material"):
        material_of("turn wood into kryptonite")
    assert material_of("made from wood with care").name == "wood"


def test_words_that_only_begin_like_a_denial_are_none():
    for prompt in ("nordic wood", "knotted wool", "noble marble", "a notebook of leather"):
        assert read_prompt(prompt).material is not None


def test_a_colour_with_unknown_words_is_no_material():
    with pytest.raises(InputError, match="'red kryptonite' names no built-in material"):
        material_of("red kryptonite")


def test_oklab_goes_there_and_back():
    colors = np.random.default_rng(0).random((50, 3))
    assert np.allclose(from_oklab(oklab(colors)), colors, atol=1e-6)
    assert np.allclose(oklab(np.ones(3)), [1, 0, 0], atol=1e-3), "white"
    assert np.allclose(oklab(np.full(3, 0.5))[1:], 0, atol=1e-3), "grey has no hue"


@pytest.mark.parametrize("name", ["wood", "marble", "slate", "steel"])
@pytest.mark.parametrize("color", ["red", "green", "blue", "white", "black"])
def test_a_tint_has_its_colour_and_keeps_the_detail(name, color):
    plain = MATERIALS[name].exemplar(96, 1)
    word = {"white": "snow white", "black": "jet black"}.get(color, color)  # "black marble" is another stone
    tinted = material_of(f"{word} {name}")
    texture = tinted.exemplar(96, 1)
    assert texture.shape == plain.shape and texture.dtype == np.float32
    assert texture.min() >= 0.0 and texture.max() <= 1.0
    mean = texture.mean(axis=(0, 1))
    if color in ("red", "green", "blue"):
        k = ("red", "green", "blue").index(color)
        assert mean[k] > 1.3 * max(np.delete(mean, k))
    else:
        assert np.ptp(mean) < 0.08 and (mean.mean() > 0.8) == (color == "white")
    light = [oklab(each.astype(np.float64))[..., 0].ravel() for each in (plain, texture)]
    assert light[1].std() > 0.2 * light[0].std(), "its structure is left"
    assert np.corrcoef(*light)[0, 1] > 0.9


def test_shades_are_darker_and_lighter():
    means = [material_of(f"{word}granite").exemplar(64, 0).mean() for word in ("dark ", "", "light ")]
    assert means[0] < means[1] - 0.08 and means[2] > means[1] + 0.05
