"""Thresholds of mirror images."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MirrorSettings:
    """When something is taken for the mirror image of an object, and how much of it is cleared.

    Attributes:
        texels: Longer side of the chart in which photographs are compared [texels]: some pixels a texel.
        reach: Farthest that a mirror image is followed from the object's foot [object heights]: at 10
            degrees above the horizon it is as long.
        hidden: Height over the support from which depth tells of something that stands before it [object
            heights]. On a glossy floor the depth of a splat wavers, down to its mirror images.
        closed: Radius of gaps in the support that are taken for depth gone wrong [share of the chart's side].
        covered: Least part of a pixel that the mirrored object takes where it is in the mirror image [1].
        bare: Largest part of a pixel that it takes beside the mirror image [1].
        views_least: Photographs that must show a texel; some with the mirror image, some without.
        texels_least: Such texels from which there is anything to tell by.
        noise: Deviation of colours below which no texel counts more [linear light].
        rounds: Fits, each with weights from what the one before left unexplained.
        brightest: Brightest that the surroundings may be that the object hides from the mirror [linear
            light]: white, in photographs that are a little overexposed.
        gloss: Least reflectance of the support, by the colours of the mirrored object alone [1]. Without
            gloss up to 0.016 is found, of 0.05 about 0.06.
        detail: Least part that these colours explain of what the outline leaves [1]. For dark legs behind
            panes up to 0.001, without gloss up to 0.014 (which is then no gloss), with gloss 0.011 and more
            where the object has a texture. A plain object's mirror image is missed.
        strength: Least deviation that the mirror image makes [linear light]: 0.3 % of white.
        explained: Least part that colours and outline explain of how photographs differ there [1].
        beyond: Least ratio of `detail` to that of the same object elsewhere under the support [1]. With gloss
            2.0 and more are found, without up to 0.7, for legs behind panes up to 0.15: what is pale has as
            much of the object's colours elsewhere. So has the rim of an object that masks leave visible.
        alike: Least part of the photographs that show half that gloss on their own [1].
        aside: Displacement of those other places [object widths].
        stretches: Their depths under the support, against the object's height [ratio].
        shown: Part of a pixel that the mirrored object takes from which on it is masked [1]: masks are then
            widened, and less would follow gaussians that stick out of the object.
    """

    texels: int = 128
    reach: float = 6.0
    hidden: float = 0.2
    closed: float = 0.02
    covered: float = 0.5
    bare: float = 0.1
    views_least: int = 4
    texels_least: int = 100
    noise: float = 0.01
    rounds: int = 3
    brightest: float = 1.2
    gloss: float = 0.04
    detail: float = 0.01
    strength: float = 0.003
    explained: float = 0.05
    beyond: float = 1.5
    alike: float = 0.6
    aside: float = 1.0
    stretches: tuple[float, ...] = (0.5, 2.0)
    shown: float = 0.3


MIRRORS = MirrorSettings()
