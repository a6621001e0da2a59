"""The hard cases of fills: charts, shadows, and views that the user filled.

`mutate_guards.py` takes their guards out one by one, as those of hard_cases.py.
"""

from __future__ import annotations

from guards import Guard, HardCase, condition

PLANES = "surfaces/test_planes.py::"
FOUND = "surfaces/test_find.py::"
HARD = "surfaces/test_hard_charts.py::"
OCCUPANCY = "surfaces/test_occupancy.py::"
SWEEP = "surfaces/test_sweep.py::"
THINGS = "propagation/test_things_on_charts.py::"
CHARTED = "propagation/test_charted.py::"
SHADOW = "shadows/test_find_shadow.py::"
RELIGHT = "shadows/test_relight.py::"
MIRROR = "mirrors/test_find_mirror.py::"
REFLECTION = "mirrors/test_reflection.py::"
FILLS = "pipelines/test_own_fills.py::"
REFUSED = FILLS + "test_what_is_not_the_view_is_refused_and_named"

OWN = "pipelines/own_fills.py"
SHOWN = "propagation/charted.py"

# fmt: off
FILL_CASES = (
    HardCase(
        "Charts: a plane at a grazing angle, or through a camera",
        "A pixel that meets a plane at a grazing angle, behind the camera or nowhere shows nothing of it.",
        (
            Guard("surfaces/planes.py", "(np.abs(facing) >= settings.grazing * length) & ", "",
                PLANES + "test_a_plane_is_not_seen_at_a_grazing_angle"),
            Guard("surfaces/planes.py", " & (z > camera.near)", "",
                PLANES + "test_a_plane_through_a_camera_is_not_seen_by_it"),
        ),
        ("SurfaceSettings.grazing",),
    ),
    HardCase(
        "Charts: two nearly equal planes",
        "A plane that lies within the waver of depth of another one is the same.",
        (
            condition("surfaces/planes.py",
                "parallel and float(np.median(np.abs(other.distances(plane.support)))) < limit",
                PLANES + "test_a_plane_that_was_found_already_is_not_kept"),
        ),
        ("SurfaceSettings.tolerance", "SurfaceSettings.apart"),
    ),
    HardCase(
        "Charts: a plinth or a small table of which the object leaves some corners",
        "It goes on as a polygon of up to four sides, two of which are seen. One straight edge, or next to "
        "nothing that is known, makes no surface.",
        (
            Guard("surfaces/occupancy.py",
                "found = _by_polygon(known, through, wanted, seed)", "found = None",
                OCCUPANCY + "test_a_plinth_of_which_some_corners_are_seen_goes_on"),
            condition("surfaces/occupancy.py", "surface is known and edges < BOUNDARIES.corner",
                OCCUPANCY + "test_one_straight_edge_is_no_plinth"),
            Guard("surfaces/occupancy.py", " and shown >= BOUNDARIES.part * side.sum()", "",
                OCCUPANCY + "test_next_to_nothing_known_of_a_large_polygon_is_no_plinth"),
        ),
        ("BoundarySettings.edges", "BoundarySettings.corner", "BoundarySettings.part"),
    ),
    HardCase(
        "Charts: a surface on which other things stand, as books on a shelf",
        "It ends at the line of their feet, where they hide it from all photographs.",
        (
            condition("surfaces/occupancy.py", "covered is not None and (covered & ~wanted).any()",
                FOUND + "test_a_surface_ends_where_what_stands_on_it_hides_it_from_all_photographs"),
            Guard("surfaces/votes.py", "~self.told & (self.before > 0)", "~self.told",
                "surfaces/test_votes.py::test_what_nobody_looks_at_is_not_covered"),
        ),
    ),
    HardCase(
        "Charts: few texels, or very many",
        "Specks have no chart; a small chart takes finer texels than its photographs have, and a large one "
        "coarser ones.",
        (
            Guard("surfaces/layout.py", "if len(hit) >= LAYOUT.least:", "if len(hit) > 0:",
                HARD + "test_a_hole_of_few_pixels_has_no_chart"),
            Guard("surfaces/chart.py", ".prod() > settings.texels:", ".prod() > 1e18:",
                HARD + "test_the_chart_of_an_endless_plane_is_bounded"),
            Guard("surfaces/planes.py",
                "if near.sum() < max((1.0 + settings.curved_gain) * flat.sum(), SEARCH.nearest):",
                "if near.sum() < (1.0 + settings.curved_gain) * flat.sum():",
                HARD + "test_few_points_are_not_bent"),
        ),
        ("LayoutSettings.least", "SurfaceSettings.texels"),
    ),
    HardCase(
        "Charts: nothing known, or all seen through",
        "No chart, and nothing is filled.",
        (
            condition("surfaces/occupancy.py", "not known.any()",
                OCCUPANCY + "test_nothing_where_nothing_is_known_or_all_is_seen_through"),
        ),
    ),
    HardCase(
        "Charts: spots of wrong depth, a lattice, a ring",
        "Spots that depth takes for holes do not end a surface, unless they are many or all around the hole.",
        (
            Guard("surfaces/occupancy.py", "through = through & ~_specks(known, through, wanted)",
                "through = through",
                OCCUPANCY + "test_spots_of_wrong_depth_do_not_end_a_straight_edge"),
            condition("surfaces/occupancy.py",
                "(found & near).sum() > BOUNDARIES.specks * told or rimmed(found, known | through, wanted)",
                OCCUPANCY + "test_the_gaps_of_a_lattice_stay_open"),
            Guard("surfaces/occupancy.py", "found = _by_ellipse(known, through, wanted, seed)",
                "found = None",
                OCCUPANCY + "test_the_rim_of_a_round_table_goes_on"),
        ),
        ("BoundarySettings.speck", "BoundarySettings.specks", "BoundarySettings.explained_round"),
    ),
    HardCase(
        "Charts: one or two photographs",
        "Its depth gives a chart; that photographs agree on a plane takes three.",
        (
            Guard("surfaces/agreement.py", "several = shown.sum(axis=0) >= settings.views_least",
                "several = shown.sum(axis=0) >= 2", SWEEP + "test_of_two_photographs_likeness_is_unknown"),
        ),
        ("AgreementSettings.views_least",),
    ),
    HardCase(
        "Charts: photographs that disagree",
        "Moving leaves are outvoted, exposures of a chart's photographs evened.",
        (
            Guard("surfaces/votes.py", "(behind > self.settings.hidden_votes * (there + behind))",
                "(behind > 9.0 * (there + behind))",
                FOUND + "test_a_chart_in_front_of_what_photographs_show_is_empty_there"),
            Guard("surfaces/texture.py", "if count < 2:", "if True:",
                HARD + "test_photographs_of_a_chart_get_one_tone"),
        ),
        ("SurfaceSettings.hidden_votes", "SurfaceSettings.tone_most"),
    ),
    HardCase(
        "Charts: depth that is zero, infinite or NaN",
        "It is no surface; infinite depth is seen through.",
        (
            Guard("surfaces/photo.py",
                "np.isfinite(self.depth) & (self.depth > 0.0)", "np.isfinite(self.depth)",
                PLANES + "test_depth_that_is_none_is_no_evidence"),
            Guard("surfaces/evidence.py",
                "photo.solid & (photo.depth < settings.farthest * np.median(photo.depth[band]))",
                "photo.solid",
                PLANES + "test_a_sky_of_finite_depth_is_no_evidence"),
        ),
        ("SurfaceSettings.farthest",),
    ),
    HardCase(
        "Charts: a hole at the border of every image",
        "The surroundings that a part is continued from end at the chart's border.",
        (
            Guard("surfaces/parts.py", "slice(max(int(rows[0]) - pad, 0), int(rows[-1]) + pad + 1)",
                "slice(int(rows[0]) - pad, int(rows[-1]) + pad + 1)",
                HARD + "test_surroundings_end_at_the_border"),
        ),
    ),
    HardCase(
        "Charts: a thing that stands in front",
        "Of what was looked up behind the object, a chart whose depth is wrong replaces nothing on which "
        "photographs agree more than with the chart. Gaussians that would hide what most photographs show "
        "are not added.",
        (
            Guard(SHOWN, "background.unseen | (looked_up & ~kept)", "background.unseen | looked_up",
                THINGS + "test_what_photographs_show_of_the_box_is_not_painted_over"),
            Guard(SHOWN, "np.where(on, layer.depth, photo.depth)", "photo.depth",
                THINGS + "test_no_gaussian_stands_before_what_photographs_show"),
            Guard(SHOWN, "off = smoothed(one - other, known)",
                "off = smoothed(one - other, np.ones_like(known))",
                THINGS + "test_the_floor_goes_on_beside_it"),
            Guard("surfaces/consistency.py", "several = count >= AGREEMENT.witnesses", "several = count >= 1",
                THINGS + "test_one_photograph_bears_nothing_out"),
            condition(SHOWN,
                "border and agreeing / border + share[number] < 2.0 * SURFACES.bordered",
                CHARTED + "test_a_chart_among_a_nearer_surface_is_not_seen_through_it"),
        ),
        ("AgreementSettings.witnesses", "AgreementSettings.apart", "SurfaceSettings.bordered"),
    ),
    HardCase(
        "Shadows: a ratio near 0",
        "What is nearly black is filled instead of relit, and a ratio is bounded before it divides.",
        (
            Guard("shadows/relight.py", "black = dark & (level < settings.black)", "black = dark & False",
                RELIGHT + "test_what_is_nearly_black_is_left_to_the_fill"),
            Guard("shadows/relight.py", "np.maximum(ratio, 1e-3)", "ratio",
                RELIGHT + "test_relighting_is_a_division_in_linear_light"),
        ),
        ("ShadowSettings.black",),
    ),
    HardCase(
        "Shadows: a ratio above 1",
        "A light takes no negative share: what the object brightens is not darkened to even things out.",
        (
            Guard("shadows/light.py", "if not len(negative):", "if True:",
                SHADOW + "test_no_light_has_a_negative_share"),
        ),
    ),
    HardCase(
        "Shadows: no depth, nothing that casts one",
        "Nothing is relit where no depth says that the support is seen; an object without a part over its "
        "support casts none.",
        (
            condition("shadows/find.py",
                "not (frame.coordinates(solid.points[opaque])[:, 2] > support.floor).any()",
                SHADOW + "test_where_nothing_is_known_there_is_nothing_to_tell"),
            condition("shadows/find.py", "len(places) < settings.texels",
                SHADOW + "test_without_depth_there_is_no_shadow"),
        ),
        ("ShadowSettings.texels",),
    ),
    HardCase(
        "Mirror images: a window taken for a mirror",
        "A mirror image must explain more than its outline does, by the colours of the mirrored object: a "
        "leg that is seen through a pane has others.",
        (
            Guard("mirrors/comparing.py",
                "return np.asarray(values - cover[:, None] * ((weight * cover) @ values) / own)",
                "return values",
                "mirrors/test_comparing.py::test_an_outline_of_one_colour_is_no_evidence"),
            Guard("mirrors/find.py", "            and self.detail >= settings.detail\n", "",
                MIRROR + "test_each_kind_of_evidence_counts"),
        ),
        ("MirrorSettings.gloss", "MirrorSettings.detail"),
    ),
    HardCase(
        "Mirror images: a mirror taken for a window",
        "Depth shows what a support mirrors, behind it: how far it reaches is told by photographs that "
        "agree. What stands before it stays, and so do gaussians that lie on it.",
        (
            Guard("mirrors/masks.py", "& ~before", "",
                REFLECTION + "test_what_stands_before_the_support_is_not_masked"),
            Guard("mirrors/masks.py", " & torch.from_numpy(under)", "",
                REFLECTION + "test_gaussians_under_the_support_go_where_they_show_the_mirror_image"),
            condition("mirrors/find.py", "domain.sum() < settings.texels_least",
                MIRROR + "test_where_nothing_can_be_compared_there_is_nothing_to_tell"),
        ),
        ("MirrorSettings.hidden", "MirrorSettings.texels_least"),
    ),
    HardCase(
        "Own fills: black, turned, of another view, of another size",
        "Refused in one line that names what differs.",
        (
            condition(OWN, "pixels.mean() < CHECK.dark", REFUSED),
            condition(OWN,
                "undone.shape == view.pixels.shape and _difference(undone, view.pixels, compared) < close",
                REFUSED),
            condition(OWN,
                "same and _difference(pixels, other.pixels, _known(other)) < min(close, CHECK.difference)",
                FILLS + "test_another_view_is_named"),
            condition(OWN, "pixels.shape != view.pixels.shape",
                REFUSED),
        ),
        ("FillCheck.dark", "FillCheck.clearer"),
    ),
    HardCase(
        "Own fills: compressed as JPEG",
        "The small differences of a JPEG are allowed.",
        (
            Guard(OWN, "difference: float = 8.0", "difference: float = 0.1",
                FILLS + "test_a_jpeg_of_a_small_detailed_view_is_that_view_still"),
            Guard(OWN, "averaged: int = 4", "averaged: int = 1",
                FILLS + "test_a_jpeg_of_a_small_detailed_view_is_that_view_still"),
        ),
        ("FillCheck.difference", "FillCheck.averaged"),
    ),
    HardCase(
        "Own fills: a hole that was not filled",
        "Refused in one line: the photograph itself, and one colour that is not that around the hole.",
        (
            condition(OWN, "inside <= CHECK.unchanged * (outside + 1.0) - 1.0",
                FILLS + "test_a_hole_that_was_not_filled_is_refused"),
            condition(OWN,
                "plain and np.abs(color - np.median(pixels[around], axis=0)).max() >= CHECK.apart",
                FILLS + "test_a_hole_that_was_not_filled_is_refused"),
            Guard(OWN, " and np.abs(color - np.median(pixels[around], axis=0)).max() >= CHECK.apart", "",
                FILLS + "test_a_plain_wall_goes_on_in_its_colour"),
        ),
        ("FillCheck.unchanged", "FillCheck.plain", "FillCheck.apart"),
    ),
)
# fmt: on
