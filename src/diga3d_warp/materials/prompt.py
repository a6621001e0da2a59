"""Parsing of prompts: material, colour and solid, and words that are not understood.

There is no language model behind it, only words. So a prompt that denies something is refused, and words that
are not followed are returned, to be shown to the user.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from diga3d_warp.errors import InputError
from diga3d_warp.materials.tint import ALSO_COLORS, COLORS, SHADES, Tint
from diga3d_warp.materials.vocabulary import MATERIALS, Material

PROMPT_MOST = 1000
"""Longest prompt [characters]. The text encoder of Stable Diffusion reads 77 tokens, about 300 characters."""


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


DENIALS = _words(
    """
    not no non none never neither nor without except excluding excluded minus sans instead rather unlike
    avoid cannot dont isnt doesnt arent wont cant nothing hardly barely scarcely lacking lacks omit omitting
    ignore skip un anti kein keine ohne nicht pas sin senza
    """
)
"""Words that turn what they stand before into its opposite."""

CHANGES = (
    (
        _words("turn turned turning change changed convert converted transform transformed make"),
        _words("into to"),
    ),
    (_words("replace replaced replacing swap swapped exchange exchanged"), _words("by with for")),
    (_words("from"), _words("into to")),
)
"""Words that tell of a change, and those after which it says what is wanted: "turn wood into gold"."""

DENYING_PHRASES = ("anything but", "everything but", "free of", "free from", "other than", "no longer")

FILLERS = _words(
    """
    a an the this that some any it its is are be been being to of in from for as by at into made make
    makes making turn turned become becomes built carved cut crafted covered coated wrapped dressed clad
    painted colored coloured color colour colors colours like look looks looking style styled textured
    texture textures pattern patterned patterns material materials surface surfaces finish object
    objects thing please piece pieces shape shaped very all whole entirely completely fully
    change changed convert converted transform transformed replace replaced replacing swap swapped exchange
    exchanged
    """
)
"""Words without which a prompt says the same."""

ELSEWHERE = _words(
    """
    on onto upon atop under underneath beneath below above over beside besides behind near against next
    front inside outside between among around
    """
)
"""Words after which a prompt speaks of another thing, such as a table that the object stands on."""

JOINTS = frozenset(("and", "or", "with"))
"""Words after which a colour belongs to what follows."""

DEFAULT = "plaster"
"""What takes a colour that a prompt names without a material."""

Kind = Literal["material", "color", "shade", "thing", "filler", "joint", "elsewhere", "other"]


@dataclass(frozen=True)
class Word:
    """One word of a prompt, or several that are one name.

    Attributes:
        text: As the prompt writes it, in lower case.
        kind: What it is.
        means: The name that it stands for.
        clause: Number of the clause that it stands in; punctuation, `JOINTS` and `ELSEWHERE` begin another.
        elsewhere: Whether that clause speaks of another thing.
    """

    text: str
    kind: Kind
    means: str
    clause: int
    elsewhere: bool


@dataclass(frozen=True)
class Reading:
    """A parsed prompt.

    Attributes:
        material: With its colour; None if it names none.
        thing: A name of the things that were asked about; None if it names none.
        notes: What it says that is not followed, and what was guessed, one line each.
    """

    material: Material | None
    thing: str | None
    notes: tuple[str, ...]


def material_of(prompt: str) -> Material:
    """The material that a prompt names, in the colour that it names; see `read_prompt`.

    Raises:
        InputError: the prompt is empty or too long, denies something, or names no material.
    """
    reading = read_prompt(prompt)
    if reading.material is None:
        raise no_material(prompt)
    return reading.material


def no_material(prompt: str) -> InputError:
    """That a prompt names no material."""
    return InputError(
        f"the prompt {shown(prompt)} names no built-in material: use one of {', '.join(MATERIALS)}; "
        "for free text use --prior sd-inpainting or --prior powerpaint"
    )


def read_prompt(prompt: str, things: Mapping[str, str] | None = None) -> Reading:
    """Read a prompt, as far as words go.

    A material and the colour beside it are looked for in the clause that names a thing, then in the first
    clause that has one, last in those that speak of what stands beside the object.

    Args:
        prompt: Such as "dark red marble" or "a wooden cube on a table".
        things: What else may be named, by the words for it.

    Raises:
        InputError: the prompt is empty or too long, or denies something.
    """
    _refuse_denial(prompt, words_of(prompt))
    words = _named(prompt, things or {})
    thing = next((word for word in words if word.kind == "thing" and not word.elsewhere), None)
    thing = thing or next((word for word in words if word.kind == "thing"), None)
    material = _nearest(words, "material", thing)
    color = _beside(words, material, thing)
    shade = _shade_of(words, color or material)
    used = [word for word in (thing, material, color, shade) if word is not None]
    notes: list[str] = []
    chosen = None if material is None else MATERIALS[material.means]
    if material is not None:
        several = sorted({w.means for w in words if w.kind == "material"} - {material.means})
        if several:
            notes.append(
                f"the prompt names several materials: {material.text} is used, not {_listed(several)}"
            )
        if material.elsewhere:
            notes.append(
                f"the prompt names a material only for what stands beside the object: {material.text}"
            )
    elif color is not None and not any(word.kind == "other" for word in words):
        chosen = MATERIALS[DEFAULT]
        notes.append(f"the prompt names a colour without a material: {color.text} {DEFAULT} is used")
    if thing is not None:
        others = sorted({w.means for w in words if w.kind == "thing"} - {thing.means})
        if others:
            notes.append(f"the prompt names several things: {thing.text} is used, not {_listed(others)}")
    unused = [
        word.text for word in words if word.kind in ("color", "shade", "other") and not _is_in(word, used)
    ]
    if unused:
        notes.append(f"not used of the prompt: {_listed(unused)}")
    if chosen is not None:
        tint = Tint(color.means if color else None, SHADES[shade.means] if shade else 1.0)
        chosen = replace(chosen, tint=tint) if tint != Tint() else chosen
        chosen = replace(chosen, notes=tuple(notes)) if notes else chosen
    return Reading(chosen, thing.means if thing else None, tuple(notes))


def words_of(prompt: str) -> list[str]:
    """The words of a prompt in lower case, without accents of typography: quotes, dashes, full width.

    Raises:
        InputError: the prompt holds no word, or more than `PROMPT_MOST` characters.
    """
    if len(prompt) > PROMPT_MOST:
        raise InputError(f"the prompt has {len(prompt)} characters: give at most {PROMPT_MOST}")
    words = [word for clause in _clauses(prompt) for word in clause]
    if not words:
        raise InputError('the prompt is empty: give one such as --prompt "white marble"')
    return words


def shown(prompt: str) -> str:
    """A prompt in quotes, not too long for a line."""
    return repr(prompt if len(prompt) <= 60 else prompt[:57] + "...")


def _clauses(prompt: str) -> list[list[str]]:
    """Words between punctuation marks that separate."""
    text = unicodedata.normalize("NFKC", prompt).casefold().replace("\u2019", "'")
    parts = re.split(r"[,;:.!?()\[\]\n]+", text)
    return [re.findall(r"[^\W\d_]+(?:'[^\W\d_]+)*|\d+", part) for part in parts]


def _refuse_denial(prompt: str, words: Sequence[str]) -> None:
    joined = f" {' '.join(words)} "
    found = next((word for word in words if word.replace("'", "") in DENIALS or word.endswith("n't")), None)
    found = found or next((phrase for phrase in DENYING_PHRASES if f" {phrase} " in joined), None)
    free = re.search(r"\w-(free|less)\b", prompt.casefold())
    found = found or (f"-{free[1]}" if free else None)
    if found is not None:
        raise InputError(
            f"the prompt {shown(prompt)} says {found!r}: name the material that is wanted, not one that is "
            "not; with a Stable Diffusion --prior, --negative says what to go away from"
        )


def _named(prompt: str, things: Mapping[str, str]) -> list[Word]:
    """The words of a prompt, the longest name of several words first."""
    found: list[Word] = []
    clause, elsewhere = -1, False
    for words in _clauses(prompt):
        clause, elsewhere, start = clause + 1, False, 0
        wanted = _wanted_from(words)
        while start < len(words):
            length, kind, means = _name_at(words[start:], things)
            if start < wanted and kind not in ("filler", "joint", "elsewhere"):
                kind = "other"  # what it was, not what it shall be
            if kind in ("joint", "elsewhere"):
                clause, elsewhere = clause + 1, elsewhere or kind == "elsewhere"
            found.append(Word(" ".join(words[start : start + length]), kind, means, clause, elsewhere))
            start += length
    return found


def _wanted_from(words: Sequence[str]) -> int:
    """Where a clause that tells of a change begins to say what is wanted; 0 if it tells of none."""
    for begins, ends in CHANGES:
        first = next((place for place, word in enumerate(words) if word in begins), len(words))
        last = next((place for place, word in enumerate(words) if place > first and word in ends), None)
        if last is not None and last + 1 < len(words):
            return last + 1
    return 0


def _name_at(words: Sequence[str], things: Mapping[str, str]) -> tuple[int, Kind, str]:
    """How many words are one name, and what it is."""
    for length in (3, 2, 1):
        if length > len(words):
            continue
        for text in _singular(words[:length]):
            if text in things:
                return length, "thing", things[text]
            if text in _MATERIAL_WORDS:
                return length, "material", _MATERIAL_WORDS[text]
            if text in COLORS or text in ALSO_COLORS:
                return length, "color", ALSO_COLORS.get(text, text)
    word = words[0]
    if word in SHADES:
        return 1, "shade", word
    if word in ELSEWHERE:
        return 1, "elsewhere", word
    if word in JOINTS:
        return 1, "joint", word
    return 1, "filler" if word in FILLERS else "other", word


_MATERIAL_WORDS = {words: m.name for m in MATERIALS.values() for words in (m.name, *m.also)}


def _singular(words: Sequence[str]) -> list[str]:
    """A name as written, and with its last word in the singular."""
    *before, last = words
    last = last.removesuffix("'s")
    forms = [last]
    for ending, one in (("ies", "y"), ("es", ""), ("s", "")):
        if last.endswith(ending) and len(last) > len(ending) + 1:
            forms.append(last.removesuffix(ending) + one)
    return [" ".join([*before, form]) for form in forms]


def _nearest(words: Sequence[Word], kind: Kind, thing: Word | None) -> Word | None:
    """The first word of a kind: in the clause of the thing, else of the object, else anywhere."""
    candidates = [word for word in words if word.kind == kind]
    own = [word for word in candidates if thing is not None and word.clause == thing.clause]
    here = [word for word in candidates if not word.elsewhere]
    return next(iter([*own, *here, *candidates]), None)


def _beside(words: Sequence[Word], material: Word | None, thing: Word | None) -> Word | None:
    """The colour of a material: right before it, in its clause, or in a clause of nothing else."""
    if material is None:
        return _nearest([word for word in words if not word.elsewhere], "color", thing)
    place = words.index(material)
    if place > 0 and words[place - 1].kind == "color":
        return words[place - 1]
    colors = [word for word in words if word.kind == "color"]
    own = [word for word in colors if word.clause == material.clause]
    taken = {word.clause for word in words if word.kind in ("material", "thing", "other") or word.elsewhere}
    return next(iter([*own, *(word for word in colors if word.clause not in taken)]), None)


def _shade_of(words: Sequence[Word], named: Word | None) -> Word | None:
    """The shade right before a name."""
    place = 0 if named is None else words.index(named)
    return words[place - 1] if place > 0 and words[place - 1].kind == "shade" else None


def _is_in(word: Word, words: Sequence[Word]) -> bool:
    return any(word is other for other in words)


def _listed(names: Collection[str]) -> str:
    """Names in quotes, the first few of many."""
    few = list(dict.fromkeys(names))[:8]
    return ", ".join(repr(name[:30]) for name in few) + (", ..." if len(names) > len(few) else "")
