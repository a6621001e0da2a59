"""The hard cases of the renderer: what it does in each, the guards that do it, and the tests that hold them.

`mutate_guards.py` takes the guards out one by one and writes docs/hard-cases.md from this table.
"""

from __future__ import annotations

from guards import Guard, HardCase, condition

GEOMETRY = "hard_cases/test_geometry.py::"
BLENDING = "hard_cases/test_blending.py::"
FLOAT64 = "hard_cases/test_against_float64.py::test_image_and_gradients"
POISON = "hard_cases/test_poison.py::test_a_poisoned_gaussian_changes_nothing_for_the_others"
DIBR = "hard_cases/test_dibr.py::"
FITS = "hard_cases/test_fits.py::"
ORDERED = "kernels/test_ordering.py::"
REPROJECT = "splatting/test_reproject.py::"
SAMPLING = "splatting/test_reproject_sampling.py::"


def term(file: str, condition: str, test: str) -> Guard:
    """A guard that is one of those a gaussian must pass to be seen, and now always holds."""
    return Guard(file, f"seen & wp.where({condition}, 1, 0)", "seen", test)


FOOTPRINT = "kernels/footprint.py"
PROJECTION = "kernels/projection.py"
GAUSSIAN_LANES = "kernels/gaussian_lanes.py"
HARMONICS = "kernels/harmonics.py"
SIGMA = "kernels/sigma_points.py"
BLEND = "kernels/blending.py"
ADJOINT = "kernels/compositing_adjoint.py"
BINNING = "kernels/binning.py"
SCATTER = "kernels/pair_scatter.py"
TILES = "kernels/tiles.py"
PIXEL_LANES = "kernels/pixel_lanes.py"
COMPOSITE = "kernels/compositing.py"
ORDERING = "kernels/ordering.py"
DRAW = "kernels/reprojection.py"
MESH = "kernels/mesh.py"
POINTS = "kernels/points.py"
CAMERAS = "kernels/cameras.py"
LOSSES = "gaussians/losses.py"

# fmt: off
CASES = (
    HardCase(
        "Behind the camera, at the near plane",
        "Culled below the near plane, which is nearer than 3DGS's: a small scene keeps what is close.",
        (
            term(FOOTPRINT, "p[2] >= near",
                GEOMETRY + "test_nothing_is_drawn_behind_the_near_plane"),
            Guard("config.py", "near: float = 0.01", "near: float = 0.2",
                GEOMETRY + "test_nothing_is_drawn_behind_the_near_plane"),
        ),
        ("Splatting.near",),
    ),
    HardCase(
        "Field of view of the EWA Jacobian",
        "The Jacobian is taken no further out than the image and a margin, whatever the principal point "
        "and the lens; beyond, no gradient flows through the direction.",
        (
            Guard(FOOTPRINT, "xj = clamp(x, lower[0], upper[0])", "xj = x", FLOAT64 + "[cpu-oblique]"),
            Guard(FOOTPRINT, "yj = clamp(y, lower[1], upper[1])", "yj = y", FLOAT64 + "[cpu-oblique]"),
            Guard("splatting/optics.py", "low, high = reached.min(axis=0), reached.max(axis=0)",
                "high = np.abs(reached).max(axis=0); low = -high", FLOAT64 + "[cpu-oblique in a crop]"),
        ),
        ("Splatting.jacobian_margin",),
    ),
    HardCase(
        "Beyond the fold of a lens",
        "A lens polynomial comes back into the image far out: rays beyond the radius where it folds are "
        "culled; pixels that no ray reaches have none.",
        (
            term(FOOTPRINT, "x * x + y * y < radius_max * radius_max",
                GEOMETRY + "test_what_a_lens_folds_back_into_the_image_is_culled"),
            condition(DRAW, "not (x * x + y * y < radius_max * radius_max)",
                REPROJECT + "test_points_beyond_the_fold_of_a_lens_do_not_come_back"),
            Guard(CAMERAS, "if error < scalar(residual) and wp.sqrt(x * x + y * y) < max_radius:",
                "if True:",
                "kernels/test_cameras.py::test_pixels_outside_the_range_of_a_lens_have_no_ray"),
            condition("splatting/optics.py", "len(reached) == 0",
                GEOMETRY + "test_a_lens_that_reaches_no_pixel_shows_nothing"),
        ),
    ),
    HardCase(
        "On the axis of a fisheye",
        "The radius that the model divides by is kept away from zero.",
        (
            Guard(CAMERAS, "AXIS_GUARD = {wp.float32: 1e-8, wp.float64: 1e-16}",
                "AXIS_GUARD = {wp.float32: 0.0, wp.float64: 0.0}",
                GEOMETRY + "test_exactly_on_the_axis_of_a_lens"),
        ),
        ("cameras.AXIS_GUARD",),
    ),
    HardCase(
        "Needles, and a determinant near zero",
        "The covariance is a Gram matrix and its determinant a sum of squares with the low-pass: at least "
        "0.01 px^4, with all its digits.",
        (
            Guard(FOOTPRINT, "det = area + low_pass * (aa + bb) + low_pass * low_pass",
                "det = (aa + low_pass) * (bb + low_pass) - ab * ab",
                GEOMETRY + "test_a_needle_has_a_factor_as_good_as_in_float64"),
        ),
        ("Splatting.low_pass",),
    ),
    HardCase(
        "Low-pass",
        "Both variances grow by it; with anti-aliasing by less, and opacity shrinks by the ratio of "
        "areas, with its gradient. A splat without area is culled before the square root of zero.",
        (
            Guard(FOOTPRINT, "var_x = aa + low_pass", "var_x = aa",
                GEOMETRY + "test_the_low_pass_keeps_a_splat_a_pixel_wide"),
            term(FOOTPRINT, "opacity * opacity * area >= alpha_min_squared * det",
                "kernels/test_projection_ways.py::test_a_disc_seen_edge_on_vanishes_when_antialiased"),
            Guard(FOOTPRINT, "opacity = opacity * wp.sqrt(area * inv_det)", "opacity = opacity * one",
                "kernels/test_projection_ways.py::test_antialiasing_keeps_the_light_of_a_splat_below_a_pixel"),
        ),
        ("Splatting.low_pass", "Splatting.low_pass_antialiased"),
    ),
    HardCase(
        "Huge covariance",
        "Culled: it is flat over any image.",
        (
            term(FOOTPRINT, "aa + bb < variance_max",
                GEOMETRY + "test_a_huge_gaussian_covers_the_image_or_nothing"),
        ),
        ("Splatting.variance_max",),
    ),
    HardCase(
        "A gaussian around the camera, by sigma points",
        "Points come no nearer than a part of the centre's depth, and one beyond the fold of the lens "
        "turns its axis linear.",
        (
            condition(SIGMA, "widest * wp.abs(axis[2]) > nearest * mean[2]",
                "kernels/test_projection_ways.py::test_a_gaussian_around_the_camera_has_finite_sigma_points"),
            Guard(SIGMA, "if one_end < limit and other_end < limit:",
                "if True:",
                "kernels/test_projection_ways.py::test_a_sigma_point_beyond_the_fold_of_a_lens_turns_its_axis_linear"),
        ),
        ("Splatting.sigma_depth",),
    ),
    HardCase(
        "NaN, infinity and absurd numbers",
        "The gaussian is culled and its numbers are left out of all sums, or it is black if its colour is "
        "broken: image and gradients of the others keep their bits. Cameras and lenses are refused in one "
        "line.",
        (
            Guard(FOOTPRINT, "within(mean, coordinate_max) & ", "", POISON),
            Guard(FOOTPRINT, " & within(scale, log_scale_max)", "", POISON),
            Guard(FOOTPRINT, "seen & within(vec3(q[0], q[1], q[2]), coordinate_max)", "seen", POISON),
            term(FOOTPRINT, "wp.abs(q[3]) < coordinate_max", POISON),
            term(FOOTPRINT, "logit > logit_min", POISON),
            Guard(PROJECTION, "wp.where(visible, d_pose[0, 0], zero)", "d_pose[0, 0]", POISON),
            Guard(HARMONICS, " & wp.where(magnitude(table, t) < color_max, 1, 0)", "", POISON),
            Guard(HARMONICS, "wp.where(seen, mean[0, t] - eye[0], zero)", "mean[0, t] - eye[0]", POISON),
            Guard("scene/camera.py", "if not bool((pose.abs() < SPLATTING.coordinate_max).all()):",
                "if False:", "scene/test_camera.py"),
            Guard("scene/camera.py",
                "if min(self.fx, self.fy) < PIXELS_MIN or max(map(abs, numbers)) > PIXELS_MAX:",
                "if False:", "scene/test_camera.py"),
            Guard("kernels/processor.py", '("-fno-signed-zeros", "-mreassociate")', '("-ffast-math",)',
                "kernels/test_observation.py::test_it_takes_no_other_surface_mask_angle_or_place"),
        ),
        ("Splatting.coordinate_max", "Splatting.log_scale_max", "Splatting.logit_min",
            "Splatting.color_max", "camera.PIXELS_MAX", "camera.COEFFICIENT_MAX"),
    ),
    HardCase(
        "Zero or denormal quaternion",
        "Culled; any longer one is normalised, and its gradient with it.",
        (
            term(FOOTPRINT, "wp.dot(q, q) >= quaternion_min",
                GEOMETRY + "test_a_quaternion_without_direction_is_culled"),
        ),
        ("Splatting.quaternion_min",),
    ),
    HardCase(
        "A mean at the camera centre",
        "It has no direction: the length is guarded, and the colour is that of degree 0.",
        (
            Guard(HARMONICS, "length_guard = real(1e-20)", "length_guard = real(0.0)",
                GEOMETRY + "test_a_mean_at_the_camera_centre_is_culled_and_its_color_is_finite"),
        ),
    ),
    HardCase(
        "Alpha saturates",
        "Clamped; clamped pixels give opacity and shape no gradient. Forward and adjoint share the function.",
        (
            Guard(BLEND,
                "alpha = wp.where(raw < real(wp.static(alpha_max)), raw, real(wp.static(alpha_max)))",
                "alpha = raw", BLENDING + "test_alpha_saturates_and_its_gradient_stops"),
            Guard(ADJOINT,
                "g_power = wp.where(raw < real(wp.static(alpha_max)), raw * g_alpha, real(0.0))",
                "g_power = raw * g_alpha", BLENDING + "test_alpha_saturates_and_its_gradient_stops"),
        ),
        ("Splatting.alpha_max",),
    ),
    HardCase(
        "A pixel is finished",
        "The gaussian that would take transmittance below the stop is left out and has no gradient. "
        "Transmittance is stored, not recovered as 1 - alpha.",
        (
            Guard(BLEND, "return wp.where(left < real(wp.static(transmittance_min)), 0, live)",
                "return live", BLENDING + "test_the_gaussian_that_would_end_a_pixel_is_left_out"),
            Guard(ADJOINT, "w = wp.where(alive > 0, w, real(0.0))", "w = w * real(1.0)",
                BLENDING + "test_the_gaussian_that_would_end_a_pixel_is_left_out"),
            Guard(COMPOSITE, "left[q] = wp.where(alive > 0, T_b[q] - w, -wp.abs(T_b[q]))",
                "left[q] = wp.where(alive > 0, T_b[q] - w, T_b[q])",
                BLENDING + "test_a_finished_pixel_takes_nothing_that_would_fit"),
            Guard(ADJOINT, "left[q] = wp.where(alive > 0, T_b[q] - w, -wp.abs(T_b[q]))",
                "left[q] = wp.where(alive > 0, T_b[q] - w, T_b[q])",
                BLENDING + "test_a_finished_pixel_takes_nothing_that_would_fit"),
            Guard("splatting/composite.py", "transmittance.view(height, width),",
                "1.0 - (1.0 - transmittance.view(height, width)),",
                BLENDING + "test_a_nearly_finished_pixel_keeps_the_digits_of_its_transmittance"),
        ),
        ("Accuracy.transmittance_min",),
    ),
    HardCase(
        "Alpha below the skip",
        "Skipped, with no gradient; a gaussian whose opacity is below is culled, and at it the box does not "
        "close by the rounding of the logarithm. The box ends where alpha does.",
        (
            term(FOOTPRINT, "opacity >= alpha_min",
                BLENDING + "test_below_one_step_of_eight_bits_nothing_is_drawn"),
            Guard(BLEND, "return wp.where(alpha < real(wp.static(alpha_min)), real(0.0), alpha)",
                "return alpha", BLENDING + "test_the_skip_has_the_radius_that_projection_promises"),
            Guard(ADJOINT, "g_power = wp.where(w > real(0.0), g_power, real(0.0))",
                "g_power = g_power * real(1.0)",
                "kernels/test_compositing.py::test_values_and_gradients_agree_with_float64"),
            Guard(FOOTPRINT, "reach_guard = real(1e-6)", "reach_guard = real(0.0)",
                BLENDING + "test_an_opacity_of_just_the_skip_has_a_gradient"),
        ),
        ("Accuracy.alpha_min",),
    ),
    HardCase(
        "A block of pixels beside a needle",
        "A block is left out only if no pixel of it can reach the skip, however the offset to a far centre "
        "rounds: its edges are moved outwards, by more for a farther centre.",
        (
            Guard(PIXEL_LANES, "half_u = factor[0] * half_x + wp.abs(factor[1]) * half_y",
                "half_u = (factor[0] * half_x + wp.abs(factor[1]) * half_y) * real(0.9)",
                "kernels/test_pixel_lanes.py::test_every_block_with_a_pixel_of_the_ellipse_is_reached"),
            Guard(PIXEL_LANES,
                "margin = real(wp.static(MARGIN)) + real(wp.static(ROUNDING)) * (wp.abs(gx) + wp.abs(gy))",
                "margin = real(0.0)",
                "kernels/test_pixel_lanes.py::test_every_block_with_a_pixel_of_the_ellipse_is_reached"),
        ),
        ("pixel_lanes.MARGIN", "pixel_lanes.ROUNDING"),
    ),
    HardCase(
        "The exponent of a long needle",
        "A sum of two squares, from the Cholesky factor of the inverse covariance: never above 0, and its "
        "rounding grows with the length of a needle, not with its square. Clamped where alpha is skipped.",
        (
            Guard(BLEND, "falloff(-(u * u + v * v))",
                "falloff(-(factor[0] * factor[0] * dx + real(2.0) * factor[0] * factor[1] * dy) * dx - "
                "(factor[1] * factor[1] + factor[2] * factor[2]) * dy * dy)",
                "hard_cases/test_rounding.py::test_needles_across_an_image"),
            Guard(BLEND, "x = wp.where(x > real(wp.static(-lowest)), x, real(wp.static(-lowest)))", "x = x",
                FLOAT64 + "[cpu-needles]"),
        ),
    ),
    HardCase(
        "Off-diagonal of the factor",
        "An offset along y moves both parts of the exponent, and so does the gradient of the centre.",
        (
            Guard(ADJOINT, "row[1] = factor[1] * g_u + factor[2] * g_v", "row[1] = factor[2] * g_v",
                "kernels/test_compositing.py::test_values_and_gradients_agree_with_float64"),
        ),
    ),
    HardCase(
        "Tiles counted and emitted",
        "One range is computed, counted and filled; far-off boxes are clamped before they become integers.",
        (
            Guard(SCATTER, "emission = int(read_int(first, i))", "emission = int(read_int(first, 0))",
                "kernels/test_binning.py"),
            Guard(TILES, "high = wp.clamp(center + extent - half, -limit, limit)",
                "high = center + extent - half",
                "kernels/test_binning.py::test_every_tile_lists_its_gaussians_by_depth_then_index"),
        ),
    ),
    HardCase(
        "More pairs than 32 bits number",
        "An error in one line, before anything is written.",
        (
            condition(TILES, "pairs > 0x7FFFFFFF",
                "kernels/test_binning.py::test_more_pairs_than_32_bits_number_are_an_error"),
        ),
    ),
    HardCase(
        "Depth order",
        "All bits of the depth are the key, from the near plane to the largest number; equal depths keep "
        "the order of their indices.",
        (
            Guard(BINNING, "return depths.view(wp.int32)",
                "return wp.array(depths.numpy().view(np.int32) & -65536, dtype=int, device=depths.device)",
                BLENDING + "test_depths_that_differ_in_their_last_bit_are_sorted"),
            Guard(SCATTER, "elements.numpy().sort()",
                "elements.assign(np.sort(elements.numpy() ^ 0xFFFFFFFF) ^ 0xFFFFFFFF)",
                BLENDING + "test_equal_depths_keep_the_order_of_their_indices"),
        ),
    ),
    HardCase(
        "Popping, and gaussians that cross",
        "With per-pixel order each pixel sorts by the depth of the gaussian on its own ray, exactly, however "
        "many there are; equal depths keep the order of the list. Saturation holds there too.",
        (
            Guard(ORDERING, "z = depths[i] - wp.dot(slopes[i], offset)", "z = depths[i]",
                ORDERED + "test_two_gaussians_that_cross_are_each_in_front_on_one_side"),
            Guard(ORDERING, "z > last_depth or (z == last_depth and j > last_pair)", "z > last_depth",
                BLENDING + "test_more_ties_than_one_round_of_per_pixel_order_takes"),
            condition(ORDERING, "raw >= real(wp.static(alpha_max))",
                ORDERED + "test_values_and_gradients_agree_with_float64"),
        ),
    ),
    HardCase(
        "Nothing to draw",
        "No gaussian, none in view, or one: the background, and gradients of exactly zero. Expected depth "
        "is not divided by zero. A fit of no gaussians is refused.",
        (
            Guard("splatting/render.py", "alpha.clamp_min(0.5 * accuracy.alpha_min)", "alpha",
                BLENDING + "test_an_empty_view_gives_the_background_and_no_gradient"),
            condition("gaussians/fit.py", "len(gaussians) == 0",
                FITS + "test_no_gaussians_are_refused_in_one_line"),
            condition(LOSSES, "not known.any()",
                FITS + "test_in_an_emptied_region_there_is_no_depth_to_compare"),
        ),
    ),
    HardCase(
        "Outside the image",
        "Culled, as behind the camera, by the function that counts and lists the tiles of a gaussian: no "
        "pixel and no gradient changes by a bit. One that no view of a fit shows for two rounds of all "
        "images is moved to where images pull.",
        (
            term(PROJECTION, "end_tile(x, half_width, left, width) > left",
                "kernels/test_projection.py::test_a_gaussian_is_visible_exactly_if_a_tile_lists_it"),
            term(PROJECTION, "end_tile(y, half_height, top, height) > top",
                "kernels/test_projection.py::test_a_gaussian_is_visible_exactly_if_a_tile_lists_it"),
            Guard(TILES, " & wp.where(center - extent <= real(size), 1, 0)", "",
                "kernels/test_binning.py::test_every_tile_lists_its_gaussians_by_depth_then_index"),
        ),
    ),
    HardCase(
        "Culled rows",
        "Exact zeros in every output and gradient; whatever the coefficients of their colours hold.",
        (
            Guard(PROJECTION, "wp.where(visible, x, zero)", "x",
                "kernels/test_projection.py::test_culled_rows_are_exact_zeros_with_zero_gradient"),
            Guard(HARMONICS, "wp.where(extent[0, t] > zero, 1, 0) & ", "",
                "kernels/test_harmonics.py::test_culled_gaussians_are_black_whatever_their_coefficients_hold"),
        ),
    ),
    HardCase(
        "Sums on many threads",
        "Rows of their own, added in a fixed order: bits do not depend on the number of threads.",
        (
            Guard(GAUSSIAN_LANES, "CPU_LANES = GaussianLanes(POSE_GROUP, 16)",
                "CPU_LANES = GaussianLanes(POSE_GROUP // 8, 16)",
                "hard_cases/test_threads.py::test_bits_do_not_depend_on_which_part_runs_first"),
        ),
        ("config.POSE_GROUP",),
    ),
    HardCase(
        "Depth of an emptied or unknown region",
        "Pixels without a depth, rendered or wanted, do not count; behind a hole inverse depth is "
        "continued, within the range of what is known. Flat or reversed depth is only shifted.",
        (
            Guard(LOSSES, " & wanted.isfinite()", "", FITS + "test_unknown_depth_does_not_count"),
            Guard(LOSSES, "if variance > FLAT * float((x**2).mean()):", "if True:",
                "gaussians/test_losses.py::test_flat_or_reversed_depth_is_only_shifted"),
            Guard("propagation/depth.py", "known = np.isfinite(depth) & (depth > 0.0)",
                "known = np.isfinite(depth)", "propagation/test_depth.py"),
            condition("propagation/depth.py", "unknown.all()", "propagation/test_depth.py"),
        ),
        ("losses.FLAT",),
    ),
    HardCase(
        "DIBR: no usable depth",
        "The pixel is no vertex; neither its colour nor its depth has a gradient.",
        (
            condition(DRAW,
                "not (z >= wp.float64(wp.static(_L.depth_min)) and z <= wp.float64(wp.static(_L.depth_max)))",
                REPROJECT + "test_pixels_without_a_usable_depth_are_left_out"),
        ),
        ("ReprojectionLimits.depth_min", "ReprojectionLimits.depth_max"),
    ),
    HardCase(
        "DIBR: behind the target",
        "Dropped, and with it every triangle that reaches there.",
        (
            condition(DRAW, "not (p[2] >= wp.float64(wp.static(_L.approach)) * z)",
                DIBR + "test_a_surface_at_the_target_or_behind_it_is_not_seen"),
        ),
        ("ReprojectionLimits.approach",),
    ),
    HardCase(
        "DIBR: at the border of the target",
        "What leaves is cut at the last pixel; rounding does not take the outermost row away.",
        (
            Guard(MESH, "slack = wp.float64(wp.static(-_L.edge)) * area",
                "slack = wp.float64(0.0) * area", REPROJECT + "test_the_same_camera_gives_the_image_back"),
            condition(POINTS, "not (p[0] >= wp.float64(0.0) and p[0] < wp.float64(width))",
                SAMPLING + "test_points_move_by_whole_pixels_and_fall_off_the_border"),
        ),
        ("MeshLimits.edge",),
    ),
    HardCase(
        "DIBR: several surfaces in one pixel",
        "The nearest wins, at equal depth the first in the source, on any number of threads.",
        (
            Guard("kernels/depth_buffer.py", "return (depth_bits << wp.int64(32)) | wp.int64(index)",
                "return wp.int64(index)", DIBR + "test_the_nearest_of_several_surfaces_is_seen"),
        ),
    ),
    HardCase(
        "DIBR: depth steps, cracks and folds",
        "A mesh has no cracks. The far side of a step carries no colour, a triangle that is stretched too "
        "far or seen from behind covers nothing.",
        (
            condition(MESH, "behind[i0] + behind[i1] + behind[i2] > wp.uint8(0)",
                REPROJECT + "test_the_front_surface_wins_without_cracks_or_ghosts"),
            condition(MESH, "not (high_x - low_x <= stretch and high_y - low_y <= stretch)",
                DIBR + "test_a_triangle_that_is_stretched_too_far_covers_nothing"),
            condition(MESH, "not (area >= wp.float64(wp.static(_L.area_min)))",
                DIBR + "test_a_surface_seen_exactly_edge_on_is_not_seen"),
            Guard(DRAW, "if z >= scalar(wp.static(_L.depth_min)) and z < limit:", "if z < limit:",
                "kernels/test_reprojection.py::test_only_the_far_side_of_a_step_is_dropped"),
        ),
        ("ReprojectionLimits.depth_step", "MeshLimits.stretch", "MeshLimits.area_min"),
    ),
)
# fmt: on
