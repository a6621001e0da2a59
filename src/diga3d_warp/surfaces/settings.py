"""Thresholds of charts: where surfaces are looked for, what counts as on them, and how large charts get."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SurfaceSettings:
    """Thresholds of finding surfaces, of charts and of their fill.

    Lengths in pixels hold at an image diagonal of 630 px; `Photo.length` scales them.

    Attributes:
        band: Width of the band around what nobody saw in which surfaces are looked for [px].
        band_share: The same as a share of the root of the unseen area [1]: a large hole is continued from
            farther away than a small one. The larger of both counts.
        rim: Width of the narrow band that half of the points come from [px]: what touches the hole matters
            most, a plinth's rim no less than the lawn around it.
        points: Points of all bands together, at most. A plane has three parameters; more points only cost.
        tolerance: Distance from a surface that counts as on it [ratio to the depth]. The depth of a fitted
            splat wavers by about 1 % on textured ground.
        agree: Difference of depths within which a photograph shows the surface [ratio].
        through: Depth behind a surface from which a photograph sees through it [ratio]. Between this and
            `agree` a pixel is no evidence: it is at a depth step, where a splat has depths of neither side.
        off: Distance from a surface within which a photograph shows it, and twice which it must see behind
            it, however slanted [ratio to the depth]. A lawn's waves of a percent of the distance change
            depth by a tenth where it is seen at 6 degrees.
        votes: Side of the square over which photographs' votes on a texel are summed [texels]: the depth of a
            splat has specks of some pixels.
        tilt: Least cosine between the normal of a depth map and that of a plane that the point lies on [1].
            Normals of a splat's depth waver by up to 40 degrees.
        trials: Random planes per search (RANSAC, Fischler and Bolles 1981). With a fifth of the points on a
            plane and three neighbours drawn together, it is missed with probability below 1e-9.
        planes: Most planes that are looked for. A corner has three, a table in a room four.
        plane_share: Least share of all points that a plane holds [1]; less is a side of some thing.
        trusted: Least share of a surface in what photographs tell of the surroundings of a part that nobody
            saw [1], where no straight boundary explains the rest. With less the part is none of its.
        bordered: Least share of the known pixels at the border of a part of a chart, in a view, that show its
            surface [1]: with less, a nearer surface goes on in front of it.
        apart: Angle and distance within which two planes are one [degrees; tolerances].
        grazing: Least cosine between a plane's normal and a line of sight at which a photograph speaks of it
            [1]: at 0.1 a pixel covers ten times as much along the surface as across.
        joined: Gap over which points of one surface hang together [ratio to the depth].
        curved_gain: How many more points a curved surface must hold than its plane, to be used [1].
        margin: Known surroundings that a chart keeps around what it fills [widths of that].
        margin_min: Least surroundings [px]: two periods of a usual tile.
        texels: Largest number of texels of a chart. 20 megapixels of texture would take minutes to fill and
            show in no view.
        texels_min: Least side of a chart [texels]; smaller ones hold no patch.
        views: Most photographs that a chart looks at; those that sample it finest.
        blended: Photographs that one texel's colour is taken of, at most.
        sharpness: Power of the sampling density by which these are weighted [1]: the finest decides, and
            another takes over without a seam.
        alpha: Alpha from which a texel is occupied [1].
        hidden_votes: Share of the photographs that speak of a place which may see through it [1]: the rest
            are floaters.
        seeds: Gaussians that start on charts, at most; about the density of a fitted image.
    """

    band: float = 25.0
    band_share: float = 0.5
    rim: float = 8.0
    points: int = 30_000
    tolerance: float = 0.012
    agree: float = 0.03
    through: float = 0.06
    off: float = 0.01
    votes: int = 5
    tilt: float = 0.75
    trials: int = 400
    planes: int = 6
    plane_share: float = 0.04
    trusted: float = 0.75
    bordered: float = 0.5
    apart: tuple[float, float] = (5.0, 2.0)
    grazing: float = 0.1
    joined: float = 0.03
    curved_gain: float = 0.25
    margin: float = 1.0
    margin_min: float = 40.0
    texels: int = 200_000
    texels_min: int = 16
    views: int = 24
    blended: int = 3
    sharpness: float = 4.0
    alpha: float = 0.5
    hidden_votes: float = 0.5
    seeds: int = 24_000


SURFACES = SurfaceSettings()
