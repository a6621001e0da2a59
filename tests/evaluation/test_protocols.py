"""Protocols on a run whose right figures are known."""

import math
from dataclasses import replace

import numpy as np
import pytest

from diga3d_warp.config import Effects
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.metrics import Score
from diga3d_warp.evaluation.protocols import _used_mask, evaluate
from diga3d_warp.evaluation.record import (
    MANIFEST,
    METRICS,
    RESULT,
    SOURCE,
    read_manifest,
    read_metrics,
    run_effects,
)
from diga3d_warp.evaluation.tables import Table, score_table
from diga3d_warp.files import write_image, write_json
from diga3d_warp.scene.masks.labels import stretched

FOUR_LEVELS = -20 * math.log10(4 / 255)  # PSNR of the toy photographs' error


def comparisons(folder):
    return {entry["title"]: entry for entry in read_metrics(folder)["evaluation"]["comparisons"]}


def test_removal_against_held_out_photographs(toy_run):
    assert 0.02 < np.mean([view.mask.mean() for view in toy_run.scene.test_views]) < 0.6
    tables = evaluate(toy_run.folder, scene=toy_run.scene)
    found = comparisons(toy_run.folder)
    assert list(found) == [
        "source against photographs",
        "edited against photographs",
        "edited against source",
    ]
    source, edited, change = (entry["mean"] for entry in found.values())
    # Rendering is not rounded to 8 bits as the photographs are: the error is 4 levels give or take half.
    assert source["whole"]["psnr"] == pytest.approx(FOUR_LEVELS, abs=0.3)
    assert set(edited) == set(change) == {"unmasked"}
    assert edited["unmasked"] == source["unmasked"], "outside the mask nothing changed"
    assert change["unmasked"]["psnr"] is None, "equal pixels"
    assert list(found["edited against source"]["views"]) == ["view_0", "view_4"]
    assert "unmasked PSNR" in tables[0].columns
    assert "inf" in tables[0].text()
    assert read_metrics(toy_run.folder)["evaluation"]["unmasked_loss_db"] == 0
    assert "`diga3d eval` measures LPIPS" in tables[0].title


def test_views_that_a_given_splat_may_have_seen_are_scored_with_a_word(toy_run):
    seen = replace(toy_run.scene, may_be_seen=True)
    for scene, may_be_seen in ((toy_run.scene, False), (seen, True)):
        title = evaluate(toy_run.folder, scene=scene)[0].title
        assert read_metrics(toy_run.folder)["evaluation"]["may_be_seen"] is may_be_seen
        assert ("it may have been trained on these views" in title) is may_be_seen


@pytest.mark.parametrize("shape", [(20, 31), (41, 67), (7, 9)])
def test_masks_of_a_run_are_resized_as_those_of_a_scene(toy_run, tmp_path, shape):
    """At another image scale the mask of a run counts for the same pixels as its file read with the scene."""
    view = toy_run.scene.test_views[0]
    stored = np.random.default_rng(0).random(shape) < 0.5
    write_image(toy_run.folder / "masks" / f"{view.name}.png", stored)
    used = _used_mask(toy_run.folder, view)
    height, width = view.pixels.shape[:2]
    np.testing.assert_array_equal(used, stretched(stored, width, height))
    rows = np.floor((np.arange(height) + 0.5) * shape[0] / height).astype(int)
    columns = np.floor((np.arange(width) + 0.5) * shape[1] / width).astype(int)
    np.testing.assert_array_equal(used, stored[np.ix_(rows, columns)], "the pixel under each centre")


def test_change_outside_the_mask_shows(toy_run):
    view = toy_run.scene.test_views[0]
    rows, columns = view.mask.nonzero()
    small = np.zeros_like(view.mask)
    small[rows[0], columns[0]] = True
    for name in ("view_0", "view_4"):
        write_image(toy_run.folder / "masks" / f"{name}.png", small)
    evaluate(toy_run.folder, scene=toy_run.scene)
    source, edited, change = (
        entry["mean"]["unmasked"]["psnr"] for entry in comparisons(toy_run.folder).values()
    )
    assert edited < source - 3, "the mask that the run used counts, not the scene's"
    assert change < 40
    assert read_metrics(toy_run.folder)["evaluation"]["unmasked_loss_db"] == pytest.approx(source - edited)


def test_views_without_masks_give_no_region(toy_run):
    views = [replace(view, mask=None) for view in toy_run.scene.test_views]
    evaluate(toy_run.folder, scene=replace(toy_run.scene, test_views=views))
    means = [entry["mean"] for entry in comparisons(toy_run.folder).values()]
    assert set(means[0]) == {"whole"}
    assert means[1] == means[2] == {}


def test_fit_against_held_out_photographs(toy_run):
    (toy_run.folder / SOURCE).replace(toy_run.folder / RESULT)
    evaluate(toy_run.folder, scene=toy_run.scene)
    mean = comparisons(toy_run.folder)["fit against photographs"]["mean"]
    assert set(mean) == {"whole"}
    assert mean["whole"]["psnr"] == pytest.approx(FOUR_LEVELS, abs=0.3)


def test_fitted_exposures_add_a_figure_of_their_own(toy_run):
    (toy_run.folder / SOURCE).replace(toy_run.folder / RESULT)
    manifest = read_manifest(toy_run.folder)
    manifest["effects"] = {"choices": [{"effect": "exposure", "value": True}]}
    write_json(toy_run.folder / MANIFEST, manifest)
    darker = [replace(view, pixels=(0.8 * view.pixels).astype(np.uint8)) for view in toy_run.scene.test_views]
    evaluate(toy_run.folder, scene=replace(toy_run.scene, test_views=darker))
    means = {title: entry["mean"]["whole"]["psnr"] for title, entry in comparisons(toy_run.folder).items()}
    assert list(means) == ["fit against photographs", "fit, colours matched to each photograph"]
    plain, even = means.values()
    assert plain < FOUR_LEVELS - 3.0 and even > plain + 3.0


def test_effects_of_a_run_come_from_its_manifest():
    assert run_effects({}) == Effects(depth=False, background=False)
    chosen = {"antialias": True, "background": True, "depth": True}
    choices = [{"effect": name, "value": value, "by": "user"} for name, value in chosen.items()]
    assert run_effects({"effects": {"choices": choices}}) == Effects(antialias=True, depth=False)


def test_spin_nerf_scores_whole_masked_and_box(toy_run, toy_truth):
    tables = evaluate(toy_run.folder, "spin-nerf", scene=toy_truth)
    (entry,) = comparisons(toy_run.folder).values()
    mean = {region: score["psnr"] for region, score in entry["mean"].items()}
    assert mean["masked"] == pytest.approx(-20 * math.log10(16 / 255), abs=0.3)
    assert mean["masked"] < mean["box"] < mean["whole"] < mean["unmasked"]
    assert len(tables) == 2
    assert [row[0] for row in tables[1].rows] == ["view_0", "view_4"]


def test_views_without_a_mask_are_scored_over_the_runs(toy_run, toy_truth):
    """360-USID and Inpaint360GS bring no masks of their test views."""
    evaluate(toy_run.folder, "spin-nerf", scene=toy_truth)
    expected = comparisons(toy_run.folder)
    for view in toy_truth.test_views:
        write_image(toy_run.folder / "masks" / f"{view.name}.png", view.mask)
    bare = [replace(view, mask=None) for view in toy_truth.test_views]
    evaluate(toy_run.folder, "spin-nerf", scene=replace(toy_truth, test_views=bare))
    assert comparisons(toy_run.folder) == expected


def test_other_image_scale(toy_run, toy_truth):
    views = [
        replace(
            view,
            camera=view.camera.resized(24, 18),
            pixels=np.ascontiguousarray(view.pixels[::2, ::2]),
            mask=view.mask[::2, ::2],
        )
        for view in toy_truth.test_views
    ]
    scene = replace(toy_truth, test_views=views)
    tables = evaluate(toy_run.folder, "spin-nerf", image_scale=0.5, scene=scene)
    assert "image scale 0.5" in tables[0].title
    assert 10 < comparisons(toy_run.folder)["edited against ground truth"]["mean"]["whole"]["psnr"] < 40


def test_what_cannot_be_measured_is_one_line(toy_run):
    with pytest.raises(InputError, match="no ground-truth views"):
        evaluate(toy_run.folder, "spin-nerf", scene=toy_run.scene)
    with pytest.raises(InputError, match="held out no views"):
        evaluate(toy_run.folder, scene=replace(toy_run.scene, test_views=[]))
    (toy_run.folder / RESULT).unlink()
    with pytest.raises(InputError, match=r"no point_cloud\.ply: finish the run"):
        evaluate(toy_run.folder, scene=toy_run.scene)


def test_table_as_text():
    rows = {
        "mine": {"whole": Score(31.234, 0.91239), "masked": Score(math.inf, 1.0)},
        "other": {"whole": Score(9.0, 0.5)},
    }
    table = score_table("Likeness", "splat", rows)
    assert table.text().splitlines() == [
        "Likeness",
        "splat  whole PSNR    SSIM  masked PSNR    SSIM",
        "----------------------------------------------",
        "mine        31.23  0.9124          inf  1.0000",
        "other        9.00  0.5000            –       –",
    ]
    assert Table.from_json(table.as_json()).text() == table.text()


@pytest.mark.parametrize(
    ("figures", "said"),
    [
        ({"refit": {"curve": [{"loss": 0.5}]}}, r"refit\.curve\[0\]\.iteration is missing"),
        ({"fit": {"curve": "none"}}, r"fit\.curve is 'none'"),
        ({"evaluation": {"protocol": "held-out"}}, r"evaluation\.comparisons is missing"),
        ({"tables": [{"title": "", "columns": ["a"], "rows": [["1", "2"]]}]}, "too many or too few cells"),
        ([], "the whole is a list"),
    ],
)
def test_damaged_figures_are_one_line(toy_run, figures, said):
    write_json(toy_run.folder / METRICS, figures)
    with pytest.raises(InputError, match=rf"metrics\.json is damaged \(.*{said}.*\): delete it"):
        read_metrics(toy_run.folder)
