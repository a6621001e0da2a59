"""Thresholds of shadows and mirror images."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ShadowSettings:
    """When something is taken for the shadow of an object, and what is done about it.

    Figures behind the thresholds are those of synthetic captures with and without shadows: a vase on a rug,
    things on tiles, on a lawn, on a rug.

    Attributes:
        views: Most photographs that are looked at, spread evenly. Twelve see all around an object.
        side: Longest side at which they are looked at [px]; shadows are soft.
        opaque: Least opacity of gaussians that cast shadows [1].
        beneath: Part of the object that may lie under its support [1]: floaters.
        foot: Highest that the object's lowest part may be over its support [object heights].
        floor: Height under which a gaussian lies on the support [object heights].
        waver: The same as a ratio to the distance of the cameras: the depth of a fitted splat wavers by about
            1 %.
        low: Height up to which the object's own foot is told from support around it [object heights].
        near_floor: Height under which gaussians beside the foot are floaters over the support
            [object heights].
        held: Least part of the object's gaussians that are support for its masks to hold the shadow [1]. The
            rim of a foot is a percent or two.
        reach: Surroundings of the object that are charted [object heights]: shadows of lights from 22
            degrees.
        texels: Side of that chart [texels].
        places: Places of the chart that are compared. With 5000 the share of the light is known to 5 %.
        near: What is near the object, where half of the places are [object heights].
        fading: Distance at which a place counts half [object heights].
        suspected: Part of the places, those from which the object hides most of the sky, that are not taken
            for lit at first [1].
        lit: Least share of the light that is left where a place is lit [1].
        strength: Least share of the light that the object takes [1]. Without shadows 0.06 to 0.16 are found,
            with shadows 0.6 and more.
        explained: Least part that the light explains of what is unlike in the shadow [1]. Without shadows up
            to 0.36, with shadows 0.57 and more.
        beyond: Least ratio of that part to what a shadow of the same shape elsewhere explains, against the
            one here [1]. Without shadows up to 0.44, with shadows 0.85 and more.
        hues: Largest ratio of the shadow's strengths in two channels [1]: a shadow in the light of a blue sky
            reaches 1.3; paint of another hue has any.
        agreeing: Largest spread of the darkening over views [ratio to the darkening]: a mirror image and a
            highlight move.
        shaded: Share of the light under which a place is changed [1]: 3 % is below what an eye notices on a
            texture.
        black: Share of the light under which a place is not relit but filled [1]: 8 bits of an sRGB image
            hold too little there.
        depth: Difference of depths within which a pixel shows the support [ratio].
        speck: Radius of specks in that test that are taken for noise [px at an image diagonal of 630].
    """

    views: int = 12
    side: int = 480
    opaque: float = 0.3
    beneath: float = 0.1
    foot: float = 0.25
    floor: float = 0.04
    waver: float = 0.012
    low: float = 0.2
    near_floor: float = 0.1
    held: float = 0.05
    reach: float = 2.5
    texels: int = 200
    places: int = 5000
    near: float = 1.5
    fading: float = 2.0
    suspected: float = 0.2
    lit: float = 0.95
    strength: float = 0.2
    explained: float = 0.45
    beyond: float = 0.65
    hues: float = 2.0
    agreeing: float = 0.4
    shaded: float = 0.97
    black: float = 0.12
    depth: float = 0.04
    speck: float = 3.0


SHADOWS = ShadowSettings()
