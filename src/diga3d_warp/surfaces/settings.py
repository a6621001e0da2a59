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
        sparse_band: Width of the band from which sparse points are taken where depth is not asked [px]: they
            are few.
        clear_share: Least share of the photographs in which such a point lies outside the masks [1]: it is
            not the object's.
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
        farthest: Depth from which nothing is a surface [medians of a view's depth]: a splat's sky.
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
        held: Least share of the points of a plane that it still holds after photographs have moved it [1].
        joined: Gap over which points of one surface hang together [ratio to the depth].
        curved_gain: How many more points a curved surface must hold than its plane, to be used [1].
        margin: Known surroundings that a chart keeps around what it fills [widths of that].
        margin_min: Least surroundings [px]: two periods of a usual tile.
        texels: Largest number of texels of a chart. 20 megapixels of texture would take minutes to fill and
            show in no view.
        texels_min: Least side of a chart [texels]; smaller ones hold no patch.
        polled: Longer side at which photographs are asked about a chart [texels]: depth has no finer detail.
        views: Most photographs that a chart takes colours of; those that sample it finest. Depth is taken of
            as many.
        blended: Photographs that one texel's colour is taken of, at most.
        toned: Texels at which tones are compared, about.
        tone_least: Of these, how many two photographs must share.
        tone_most: Largest change of a tone [1]: more is another surface, or light that the chart should keep.
        sharpness: Power of the sampling density by which these are weighted [1]: the finest decides, and
            another takes over without a seam. Where two are as fine, grass that stands above its plane is
            averaged; at a power of 4 it was everywhere.
        alpha: Alpha from which a texel is occupied [1].
        hidden_votes: Share of the photographs that speak of a place which may see through it [1]: the rest
            are floaters.
        seeds: Gaussians that start on charts, at most; about the density of a fitted image.
    """

    band: float = 25.0
    band_share: float = 0.5
    rim: float = 8.0
    sparse_band: float = 60.0
    clear_share: float = 0.7
    points: int = 30_000
    tolerance: float = 0.012
    agree: float = 0.03
    through: float = 0.06
    off: float = 0.01
    votes: int = 5
    farthest: float = 1e6
    tilt: float = 0.75
    trials: int = 400
    planes: int = 6
    plane_share: float = 0.02
    trusted: float = 0.75
    bordered: float = 0.5
    apart: tuple[float, float] = (5.0, 2.0)
    grazing: float = 0.1
    held: float = 0.8
    joined: float = 0.03
    curved_gain: float = 0.25
    margin: float = 1.0
    margin_min: float = 40.0
    texels: int = 200_000
    texels_min: int = 16
    polled: int = 256
    views: int = 24
    blended: int = 3
    toned: int = 16_000
    tone_least: int = 32
    tone_most: float = 0.15
    sharpness: float = 16.0
    alpha: float = 0.5
    hidden_votes: float = 0.5
    seeds: int = 24_000


SURFACES = SurfaceSettings()


@dataclass(frozen=True)
class SearchSettings:
    """Effort of the search for planes.

    Attributes:
        checked: Points on which random planes are compared; a share of a twentieth is then known to 8 %.
        searches: Searches for each plane that may be found: some find chance alignments.
        cells: Cells across the points of a plane, at most, in which it is told what hangs together.
        nearest: Neighbours among which the corners of a random plane are drawn: three at random of a whole
            room seldom lie on one surface.
    """

    checked: int = 3000
    searches: int = 3
    cells: int = 400
    nearest: int = 24


SEARCH = SearchSettings()


@dataclass(frozen=True)
class BendSettings:
    """Surfaces with a height over their plane.

    Attributes:
        farthest: Distance from the plane up to which points of such a surface are looked for [tolerances].
        huber: Distance from the surface from which points pull less [tolerances]: half of a fit's points may
            be the next surface's.
        rounds: Rounds of reweighting; the height settles in three or four.
        steps: Fixed-point steps in which a ray meets the surface: each leaves about the slope of the height,
            below a quarter, of the error.
    """

    farthest: float = 6.0
    huber: float = 1.5
    rounds: int = 6
    steps: int = 4


BENDS = BendSettings()


@dataclass(frozen=True)
class BoundarySettings:
    """Where a surface ends in what nobody saw.

    Attributes:
        lines: Random lines that are compared. With a third of the boundary on one edge, it is missed with
            probability below 1e-10.
        explained: Share of the texels around what is wanted that lines must put on their right side [1];
            jagged rims of a splat's depth take two of a hundred.
        edges: Most sides of a polygon: a small table or a plinth under the object has four.
        corner: Sides of it that known texels must tell.
        kept: Least share of what is wanted on the inner side of each [1]: a jagged rim has many lines.
        part: Least part of a polygon that is known to be surface [1]: around a hole in the middle of what is
            seen through, anything is a polygon.
        near: Distance from a line that counts as on it [texels].
        least: Texels of boundary from which a line is fitted; fewer are a speck.
        corners: Boundary texels that an ellipse is drawn through; it has five parameters.
        widest: Longest semi-axis of an ellipse [longer sides of the chart]; a longer one is a line.
        close: How far around what is wanted an ellipse must explain what is told [widths of that].
        explained_round: Share of the texels there that it must put on their right side [1]. On the statue's
            plinth it is 0.966.
        round: Least share of the boundary that lies on the ellipse [1].
        speck: Largest spot of what is seen through, in shares of what is told [1], that does not contradict
            lines: depth of a splat is wrong here and there, mostly around the object's foot.
        specks: Share of all such spots together from which they do [1]: a lattice has many.
        ring: How far around a part is looked at, at least [texels]: beyond the specks of a splat's depth.
        around: How far around a part is looked at [roots of its area].
        told: Share of a part's surroundings of which photographs must say whether the surface is there [1].
        longest: Longer side at which a boundary is continued smoothly [texels]; it has no finer detail.
    """

    lines: int = 200
    explained: float = 0.97
    edges: int = 4
    corner: int = 2
    kept: float = 0.9
    part: float = 0.1
    near: float = 2.0
    least: int = 12
    corners: int = 6
    widest: float = 1.0
    close: float = 0.15
    explained_round: float = 0.95
    round: float = 0.5
    speck: float = 0.04
    specks: float = 0.08
    ring: int = 6
    around: float = 0.35
    told: float = 0.25
    longest: int = 160


BOUNDARIES = BoundarySettings()


@dataclass(frozen=True)
class LayoutSettings:
    """Which part of a surface becomes a chart.

    Attributes:
        coarse: Texels on the longer side of a chart whose resolution nobody has asked for.
        beyond: How far a surface may go on beyond the points that it was found by [widths of these].
        least: Unseen pixels, of all views, that a chart must show; fewer are specks.
        outlying: Share of the unseen pixels on a chart that may lie outside its frame [1]: those at grazing
            angles reach far.
        gap: Side of the square by which texels between the samples of pixels are taken in [texels]: a chart
            has the sampling of its finest photograph, and others skip up to some texels.
    """

    coarse: int = 128
    beyond: float = 0.25
    least: int = 24
    outlying: float = 0.01
    gap: int = 5


LAYOUT = LayoutSettings()


@dataclass(frozen=True)
class ShownSettings:
    """How charts are filled by a prior, drawn, and set with gaussians.

    Attributes:
        margin: Surroundings that a prior is shown [sizes of what it fills].
        margin_min: Least surroundings that a prior is shown [texels]: some patches on each side.
        anisotropy: Longest footprint of a pixel that is averaged over, in texels of its level [1]: GPUs offer
            8 or 16.
        flatness: Thickness of a gaussian on a chart [its widths]. A disc cannot be lit from beside; a needle
            through the surface would show from other sides.
    """

    margin: float = 1.0
    margin_min: int = 48
    anisotropy: float = 8.0
    flatness: float = 0.2


SHOWN = ShownSettings()


@dataclass(frozen=True)
class AgreementSettings:
    """Thresholds of the agreement of photographs.

    Attributes:
        views: Photographs that are compared. More only cost: the median of a dozen is steady.
        views_least: Photographs that must show a texel [1]: two agree by chance, and of two the median is the
            mean.
        witnesses: Photographs that must show a thing in front of a surface whose depth is poor [1], as
            `propagation.unseen` asks of what it looks up behind the object: one may be fooled by a floater.
        apart: Least difference of a thing in front of such a surface from it [differences of photographs of
            the thing, inverted]: with less, photographs do not agree on the thing.
        window: Side of the window whose mean brightness is taken off [texels].
        grown: Sides of the windows in which contrast is looked for, one after another [windows].
        contrast: Mean square contrast from which a window tells something [squares of brightness in [0, 1]]:
            that of noise of three grey levels.
        alike_there: Share of the contrast in common from which photographs bear a surface out [1].
        unlike: Share below which they refuse it [1]; between both, they say nothing.
        differing: Mean square difference from which photographs refuse a surface whose depth is poor [squares
            of brightness]: eight grey levels. Soft reflections move by less.
        alike_least: Mean share from which photographs agree on a plane [1]: half of the can's floor, a
            glossy one, is grout.
        told: Least share of texels with contrast where photographs may refuse a plane [1].
        gain: How much more alike photographs must be on a plane than beside it [1]. From one side they are
            alike on any plane.
        sweep: Places before and behind a surface, on the lines to the cameras' mean, at which photographs are
            compared where depth is poor [ratio to the distance].
        swept: Longer side at which they are [texels].
        beside: Distance of the planes beside it [ratio to the depth].
        side: Texels on each side of the part on which a plane is refined.
        around: Least width of that part [reaches of the hole]: the hole itself shows nothing.
        smallest: Least side of a photograph at the coarsest level [px].
        levels: Sizes of the photographs from which a plane is refined, each half of the next: a plane may be
            off by some pixels of the coarsest.
        step: First steps [texels].
        steps: Evaluations on each level (Nelder and Mead 1965); three parameters settle in 30 to 40.
        rays: Pixels of each view by which the hole's place on a plane is told.
        grazing: Least cosine between normal and line of sight of the photographs that are compared [1].
        outside: How far outside an image the hole may lie in them [widths].
        depth_right: Least share of the texels on which photographs agree where depth has to say the same, for
            it to be believed where these tell nothing [1].
        tone: Difference of brightness from the consensus up to which a photograph shows the surface [1].
    """

    views: int = 12
    views_least: int = 3
    witnesses: int = 2
    apart: float = 0.5
    window: int = 9
    grown: tuple[float, ...] = (1.0, 2.3, 5.0)
    contrast: float = (3.0 / 255.0) ** 2
    alike_there: float = 0.5
    unlike: float = 0.3
    differing: float = (8.0 / 255.0) ** 2
    alike_least: float = 0.4
    told: float = 0.05
    gain: float = 0.1
    sweep: tuple[float, ...] = (-0.3, -0.15, 0.08, 0.15, 0.25, 0.35)
    swept: int = 128
    beside: float = 0.04
    side: int = 96
    around: float = 3.0
    smallest: int = 32
    levels: int = 3
    step: float = 2.0
    steps: int = 36
    rays: int = 60
    grazing: float = 0.15
    outside: float = 0.2
    depth_right: float = 0.6
    tone: float = 0.06


AGREEMENT = AgreementSettings()
