"""The hard cases of anchors: views, numbers that are not finite, voxels, growing.

`mutate_guards.py` takes their guards out one by one, as those of hard_cases.py.
"""

from __future__ import annotations

from guards import Guard, HardCase, condition

DECODER = "gaussians/scaffold/decoder.py"
ANCHORS = "gaussians/scaffold/anchors.py"
LEARNER = "gaussians/scaffold/learner.py"
VOXELS = "gaussians/scaffold/voxels.py"
DECODED = "gaussians/scaffold/test_decoder.py::"
DRAWN = "gaussians/scaffold/test_anchors.py::"
ENCODED = "gaussians/scaffold/test_encode.py::"
FITTED = "gaussians/scaffold/test_scaffold_fit.py::"

# fmt: off
SCAFFOLD_CASES = (
    HardCase(
        "Anchors: a view direction of zero length",
        "An anchor at the centre of the camera has direction 0 and distance 0, and no gradient through them.",
        (
            Guard(DECODER, "torch.where(apart, squared, 1.0).sqrt()", "squared.sqrt()",
                DECODED + "test_an_anchor_at_the_camera_has_no_direction"),
        ),
    ),
    HardCase(
        "Anchors: features that are not finite",
        "The anchor is left out before the networks, whose gradients it would spoil.",
        (
            Guard(ANCHORS, "self.features.isfinite().all(dim=1) & ", "",
                DRAWN + "test_an_anchor_with_broken_numbers_is_not_drawn[nan-features]"),
        ),
    ),
    HardCase(
        "Anchors: outputs of a network that saturate or are not finite",
        "Opacities stop short of 1; gaussians of which a number is not finite are not drawn.",
        (
            Guard(DECODER, "activation.clamp(max=OPACITY_MOST)", "activation",
                DECODED + "test_saturated_outputs_are_finite_and_so_are_their_gradients"),
            condition(DECODER, "not usable.all()",
                DECODED + "test_outputs_that_are_not_finite_are_not_drawn"),
        ),
        ("decoder.OPACITY_MOST",),
    ),
    HardCase(
        "Anchors: an anchor behind the camera whose gaussians are before it",
        "Anchors whose sphere reaches the plane of the camera are not culled.",
        (
            Guard(ANCHORS, "(seen.visible | beside)", "seen.visible",
                ENCODED + "test_a_voxel_of_more_gaussians_than_slots_has_several_anchors"),
        ),
        ("anchors.BORDER",),
    ),
    HardCase(
        "Anchors: none of their gaussians is seen by any view",
        "They are taken out once every image had its turn; one anchor is always left.",
        (
            Guard(LEARNER, "free & (faint | unseen)", "free & faint",
                FITTED + "test_anchors_that_no_view_shows_are_taken_out"),
            condition(LEARNER, "gone.all()",
                FITTED + "test_something_is_left_where_no_view_shows_anything"),
        ),
    ),
    HardCase(
        "Anchors: growing without end",
        "The most pulled gaussians get anchors first, and no more than the budget allows.",
        (
            Guard(LEARNER, "max(0, min(len(grown.means), wanted - int((~gone).sum())))", "len(grown.means)",
                FITTED + "test_growing_keeps_to_its_budget"),
        ),
    ),
    HardCase(
        "Anchors: voxels of no size against the scene",
        "Voxels too far away to be numbered count as on a border.",
        (
            Guard(VOXELS, "np.clip(cells, -CELLS_MOST, CELLS_MOST)", "cells",
                "gaussians/scaffold/test_voxels.py::test_voxels_far_away_count_as_on_the_border"),
        ),
        ("voxels.CELLS_MOST",),
    ),
)
# fmt: on
