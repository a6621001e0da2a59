"""Which labels of a capture's masks are the object.

Masks are stored as 0 and 255, as 0 and 1, as shades with soft edges, as numbers of objects (with 255 for
pixels to ignore, as in PASCAL VOC and Cityscapes) or as a colour for each object. Which of these a capture
uses is read off all of its masks together: one alone may be empty, or dim.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.masks.labels import Labels


@dataclass(frozen=True)
class KindSettings:
    """Thresholds for the forms of masks. Chosen on masks in the forms of SPIn-NeRF, DAVIS and VOC.

    Attributes:
        thick: Part of the pixels of all labels but the largest two that lie inside of them, not on their rim,
            from which on they are objects: soft rims of a mask are one or two pixels wide.
        ramp: Largest step between neighbours on a smooth ramp [levels].
        ramps: Part of the changes between neighbours that are such steps from which on labels are shades.
        many: Labels up to which a mask holds no ramp.
        flat: Part of neighbours that are equal from which on labels are objects; a photograph has a third.
        near: Distance from dark and from bright up to which a pixel is one of them [of their difference].
        sharp: Part of the pixels that are dark or bright, even with wide soft edges. Less has an overlay, a
            photograph or a map of depth.
        filled: Part of the pixels brighter than half that are bright, in an image with many colours. Less has
            an object that is cut out on black.
        faint: Least difference of dark and bright [levels of 255]: below, it is noise of JPEG.
        counted: Largest number of an object where 255 means pixels to ignore.
        named: Most objects that a line names.
    """

    thick: float = 0.05
    ramp: int = 2
    ramps: float = 0.9
    many: int = 16
    flat: float = 0.8
    near: float = 0.1
    sharp: float = 0.75
    filled: float = 0.5
    faint: int = 24
    counted: int = 64
    named: int = 12


KINDS = KindSettings()

_IGNORED = frozenset({255, 65535})
_WHITE_OR_ONE = frozenset({1, 255, 65535})


def object_masks(
    labels: Mapping[str, Labels], ids: Sequence[int] = ()
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Where the object is, and what the user should know of how that was read.

    Args:
        labels: Masks of one capture, by image.
        ids: Numbers of the objects that are meant; all if empty. Objects in colours count from 1, in the
            order of their colours.

    Returns:
        Masks by image, shape (H, W), bool, and notes.

    Raises:
        InputError: a file is no mask, or no mask holds one of the ids.
    """
    if not all(each.exact for each in labels.values()) or _are_shades(labels.values()):
        if ids:
            first = next(iter(labels.values()))
            raise InputError(
                f"{first.file}: the masks hold shades, and no numbers of objects; write them as .png to "
                "choose ids"
            )
        return _of_shades(labels), []
    if len({each.colored for each in labels.values()}) > 1:
        labels = {key: replace(each, values=each.rgb(), colored=True) for key, each in labels.items()}
    counts = {key: each.counts() for key, each in labels.items()}
    background = _background(labels.values(), counts.values())
    objects = {key: set(count) - {background} for key, count in counts.items()}
    found = sorted(set().union(*objects.values()))
    several = any(len(each) > 1 for each in objects.values())
    if not ids and (len(found) <= 1 or (not several and set(found) <= _WHITE_OR_ONE)):
        # Nothing to choose; some files of one capture may hold 1 where others hold 255.
        return {key: each.values[each.index] != background for key, each in labels.items()}, []
    colored = next(iter(labels.values())).colored
    number = (
        {label: place for place, label in enumerate(found, start=1)} if colored else {n: n for n in found}
    )
    ignored = set() if colored else _ignored(objects.values())
    missing = sorted(set(ids) - set(number.values()))
    if missing:
        raise InputError(
            f"no mask holds object {missing[0]}: the masks hold {_sizes(number, counts, colored) or 'none'}"
        )
    chosen = [label for label in found if (number[label] in ids if ids else label not in ignored)]
    notes = []
    if not ids:
        kept = {label: number[label] for label in chosen}
        what = "object" if len(kept) == 1 else "objects"
        notes.append(f"the masks hold {what} {_sizes(kept, counts, colored)}: all are taken")
        if len(kept) > 1:
            notes[0] += "; choose with --mask-ids"
        if ignored:
            notes.append(f"masks: label {max(ignored)} is taken for pixels to ignore, not for the object")
    return {key: np.isin(each.values, chosen)[each.index] for key, each in labels.items()}, notes


def _background(labels: Iterable[Labels], counts: Iterable[Mapping[int, int]]) -> int:
    """The label of what is no object: 0, or black; else the most frequent one along the borders."""
    if any(0 in count for count in counts):
        return 0
    rim: Counter[int] = Counter()
    for each in labels:
        edges = [each.index[0], each.index[-1], each.index[:, 0], each.index[:, -1]]
        values, n = np.unique(each.values[np.concatenate(edges)], return_counts=True)
        rim.update(dict(zip(values.tolist(), n.tolist(), strict=True)))
    # A single label everywhere is the object: it covers all.
    return rim.most_common(1)[0][0] if len(rim) > 1 or len(set().union(*counts)) > 1 else 0


def _ignored(objects: Iterable[set[int]]) -> set[int]:
    """Labels of pixels to ignore: 255 beside small numbers of objects, in at least one file."""
    found: set[int] = set()
    for each in objects:
        others = each - _IGNORED
        if others and max(others) <= KINDS.counted:
            found |= each & _IGNORED
    return found


def _sizes(number: Mapping[int, int], counts: Mapping[str, Mapping[int, int]], colored: bool) -> str:
    """Objects with their size and the number of views that show them, in one line."""
    pixels = sum(sum(count.values()) for count in counts.values())
    parts = []
    for label, name in number.items():
        size = sum(count.get(label, 0) for count in counts.values())
        views = sum(label in count for count in counts.values())
        color = f" #{label:06x}," if colored else ""
        parts.append(
            f"{name} ({color[1:]}{' ' if colored else ''}{100 * size / pixels:.2g} % in {views} views)"
        )
    rest = len(parts) - KINDS.named
    return ", ".join(parts[: KINDS.named]) + (f" and {rest} more" if rest > 0 else "")


def _are_shades(labels: Iterable[Labels]) -> bool:
    """Whether exact labels are levels of soft edges, and not objects."""
    inside = rim = steps = changes = equal = pairs = most = 0
    for each in labels:
        if len(each.values) <= 2:
            continue
        most = max(most, len(each.values))
        index = each.index.astype(np.int64)
        count = np.bincount(index.ravel(), minlength=len(each.values))
        largest = np.argsort(count)[-2:]
        inner = index[1:-1, 1:-1]
        same = np.ones(inner.shape, bool)
        for rows, columns in ((0, 1), (2, 1), (1, 0), (1, 2)):
            height, width = inner.shape
            same &= index[rows : rows + height, columns : columns + width] == inner
        other = ~np.isin(inner, largest)
        inside, rim = inside + int((other & same).sum()), rim + int(other.sum())
        for axis in (0, 1):
            step = np.abs(np.diff(each.values[index], axis=axis))
            changed = step[step > 0]
            changes, pairs = changes + len(changed), pairs + step.size
            steps += int((changed <= KINDS.ramp * max(each.white // 255, 1)).sum())
            equal += step.size - len(changed)
    if not rim:
        return False
    ramps = most > KINDS.many and steps >= KINDS.ramps * changes
    return inside < KINDS.thick * rim or ramps or equal < KINDS.flat * pairs


def _of_shades(labels: Mapping[str, Labels]) -> dict[str, np.ndarray]:
    """Masks cut half-way between dark and bright, which are those of all files: no halo, and none of noise.

    Raises:
        InputError: a file is no mask but an overlay, a photograph or the like.
    """
    total = np.zeros(256)
    for each in labels.values():
        share = np.bincount(each.grey().ravel(), minlength=256) / each.index.size
        if _is_picture(share, each.tinted):
            raise InputError(
                f"{each.file}: not a mask but a picture, such as a photograph or an overlay; paint the "
                "object white and all else black"
            )
        total += share
    dark, bright = _levels(total)
    if bright - dark < KINDS.faint:
        return {key: np.full(each.index.shape, dark > 127) for key, each in labels.items()}
    return {key: each.grey() > 0.5 * (dark + bright) for key, each in labels.items()}


def _is_picture(share: np.ndarray, tinted: bool) -> bool:
    """Whether a histogram (256,) has more than a dark and a bright side with soft edges between."""
    dark, bright = _levels(share)
    if bright - dark < KINDS.faint:
        return False
    levels, near = np.arange(256), KINDS.near * (bright - dark)
    is_bright = levels >= bright - near
    filled = share[is_bright].sum() / share[levels > 0.5 * (dark + bright)].sum()
    sharp = share[(np.abs(levels - dark) <= near) | is_bright].sum()
    return bool(sharp < KINDS.sharp or (tinted and filled < KINDS.filled))


def _levels(share: np.ndarray) -> tuple[int, int]:
    """Dark and bright of a histogram (256,): medians of the two sides of Otsu's threshold (1979)."""
    weight, levels = np.cumsum(share), np.arange(256)
    moment = np.cumsum(share * levels)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (moment[-1] * weight / weight[-1] - moment) ** 2 / (weight * (weight[-1] - weight))
    cut = int(np.nanargmax(np.where(np.isfinite(between), between, -1.0)))
    return _quantile(share[: cut + 1], 0.5), cut + 1 + _quantile(share[cut + 1 :], 0.75)


def _quantile(share: np.ndarray, part: float) -> int:
    """The level (of a histogram) below which a part of its weight lies."""
    weight = np.cumsum(share)
    return int(np.searchsorted(weight, part * weight[-1])) if weight[-1] > 0 else 0
