"""When an effect is worth its time."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Thresholds:
    """When the evidence switches an effect on, and how the evidence is taken.

    A level is 1/255 of white. Where a reason names captures, they are a bear, a statue and a can, taken by
    hand with phones, and the synthetic room.

    Attributes:
        lens_shift: Least displacement by the lens at a corner [px]. On the captures' sparse points colours
            change by 7 to 9 levels a pixel (the median): a quarter pixel is 2 levels.
        exposure_drift: Least drift of a mid-grey between views, root mean square over views and channels
            [levels]. Fits of 700 iterations err by 14 levels. At drifts of 2.2 (statue), 4.2 (can) and 8.2
            (bear) exposures change PSNR in new views by less than 0.2 dB, up or down; where the room's
            photographs were made brighter and darker by 12 %, they gain 1.7 dB.
        view_dependence: Least amplitude that a degree of harmonics explains in views left out [levels]. It
            tells sheen and errors of place together: harmonics take up both. Against fits of 700 to 1500
            iterations: the statue shows 0.6, 1.0 and 0.9 for degrees 1, 2 and 3, and degree 0 renders new
            views as well as 3 (25.2 dB both); the matte room shows 2.6, 1.8 and 0.9, from edges and points
            that are 2 mm off, and degree 1 gains 0.7 dB over 0, and 3 nothing over 1.
        worst_share: Part of the points that is left out, those that change most [ratio]. Beside the rim of
            something in front, a point's colours are those of two things.
        footprint_spread: Ratio of the largest to the smallest distance at which the median point is seen,
            in pixels per length. From an octave on, a splat that was fitted near is too thick or too bright
            far away (Mip-Splatting, Yu et al. 2024, whose experiments begin at a factor of 2).
        transparency: Least part of the photographs' area that is transparent [ratio]. It is 30 px of
            640 x 480: less are stray pixels of an export, and whatever was cut out leaves a multiple.
        directions: Least part of all directions that photographs look into, with which no view can look into
            nothing [ratio]. A gap of 2 % of the sphere is 32 degrees wide, less than a view.
        order_side: Longest side of the pictures in which the order of gaussians is compared [px]: sorting
            each pixel is slow.
        image_side: Longest side of the images that colours are read from [px]. A pixel of them averages over
            what a sparse point's error of place would otherwise change.
        blur: Standard deviation of the blur before reading [px]; for the same reason.
        views_most: Views that are read, spread evenly. Bounds the time.
        points_most: Points that are projected, spread evenly; they also hide each other.
        opaque: Least opacity of a photograph, after the blur, where a point's colour is read. Mattes of
            cut-out things waver by some levels; a rim lets half of the background through.
        points_read: Points whose colours are compared. The drift of a view is then known to 0.1 level.
        views_least: Views that must see a point. Fewer cannot tell a degree of 2 from chance.
        points_least: Points that are needed to say anything, in all and in a view.
        points_per_cell: Mean number of points in a cell of the image in which a near point hides far ones.
            With 4, a surface has its second nearest point in almost every cell that it covers.
        cell_side_least: Smallest side of such a cell [px].
        depth_tolerance: A point is hidden if its depth exceeds that of the second nearest in its cell by
            more [ratio]. 5 % keeps slanted surfaces; the second, because one point may float.
        outlier: Colours further than this from the point's median over views are left out [0 to 1]. They are
            what still hides a point; a highlight of this size is lost with them.
        ridge: Weight of the wish that harmonics above degree 0 are zero, in squares of the basis. A basis
            function of degree 1 has 0.24: one more view, in each direction, that says so.
    """

    lens_shift: float = 0.25
    exposure_drift: float = 10.0
    view_dependence: float = 2.0
    worst_share: float = 0.1
    footprint_spread: float = 2.0
    transparency: float = 1e-4
    directions: float = 0.98
    order_side: int = 160
    image_side: int = 320
    blur: float = 1.0
    views_most: int = 48
    points_most: int = 60_000
    opaque: float = 0.95
    points_read: int = 1500
    views_least: int = 8
    points_least: int = 50
    points_per_cell: float = 4.0
    cell_side_least: float = 4.0
    depth_tolerance: float = 0.05
    outlier: float = 0.15
    ridge: float = 0.25


THRESHOLDS = Thresholds()

LEVELS = 255.0
"""Levels from black to white."""
