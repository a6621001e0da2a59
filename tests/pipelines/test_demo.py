"""The demo, on a room a tenth of its size."""

from dataclasses import replace

import numpy as np
import pytest
from tiny_removal import SETTINGS

from diga3d_warp.evaluation.record import REPORT, read_manifest, read_metrics
from diga3d_warp.evaluation.tables import Table
from diga3d_warp.pipelines import demo
from diga3d_warp.pipelines.method import WARPED
from diga3d_warp.priors.classical import telea_fill
from diga3d_warp.scene.photographs.images import read_image

SIDES = ("before", "after")

ROWS = [
    f"{method}, {views}"
    for views in ("fitted", "held out")
    for method in ("mean colour of each view", "Telea on each view", "diga3d remove")
]


class QuickPrior:
    """A fill that takes milliseconds."""

    name = "quick"

    def fill(self, image, mask, *, seed=0, depth=None):
        return telea_fill(image, mask)


@pytest.fixture(scope="module")
def small_demo(tmp_path_factory):
    """The folder of a finished small demo, and a function that runs it again."""
    out = tmp_path_factory.mktemp("demo")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demo, "ROOM", replace(demo.ROOM, width=96, height=72, views=9, supersampling=1))
        patch.setattr(demo, "SETTINGS", replace(SETTINGS, method=WARPED))
        patch.setattr("diga3d_warp.pipelines.remove.ExemplarPrior", QuickPrior)
        patch.setattr("diga3d_warp.pipelines.replace.ExemplarPrior", QuickPrior)
        demo.run_demo(out)
        yield out, lambda: demo.run_demo(out)


def table_of(out) -> Table:
    (table,) = read_metrics(out / demo.RUN)["tables"]
    return Table.from_json(table)


def column(table: Table, head: str) -> dict[str, float]:
    place = list(table.columns).index(head)
    return {row[0]: float(row[place]) for row in table.rows}


def test_table_compares_all_methods_on_all_views(small_demo):
    table = table_of(small_demo[0])
    assert [row[0] for row in table.rows] == ROWS
    masked = column(table, "masked PSNR")
    # Each method is a picture of the room: neither blank, nor the truth itself.
    assert all(8.0 < value < 30.0 for value in masked.values())
    # So short a fit does not make a sharp room, but it holds more of it than one colour.
    for views in ("fitted", "held out"):
        assert masked[f"diga3d remove, {views}"] > masked[f"mean colour of each view, {views}"] + 1.0


def test_fills_keep_what_the_rendering_must_approximate(small_demo):
    """Without shadows the truth differs from the photographs inside the masks only."""
    unmasked = column(table_of(small_demo[0]), "unmasked PSNR")
    for name, value in unmasked.items():
        assert (value == float("inf")) == ("diga3d" not in name)


def test_a_second_call_takes_up_the_first_and_ends_with_the_report(small_demo, capsys):
    out, again = small_demo
    before, stages = table_of(out), read_manifest(out / demo.RUN)["stages"]
    report = again()
    assert report.is_file()
    assert capsys.readouterr().out.splitlines()[-1] == str(report)
    assert table_of(out) == before
    assert read_manifest(out / demo.RUN)["stages"] == stages
    assert before.title in report.read_text(encoding="utf-8")


def test_all_three_edits_change_the_vase_and_nothing_else(small_demo):
    out = small_demo[0]
    for run in (demo.RUN, demo.RETEXTURED, demo.REPLACED):
        for name in ("view_000", "view_004"):
            before, after = (read_image(out / run / "views" / side / f"{name}.png") for side in SIDES)
            mask = read_image(out / demo.RUN / "masks" / f"{name}.png")[..., 0] > 127
            change = np.abs(after.astype(float) - before).mean(axis=2)
            assert mask.mean() > 0.02
            assert change[mask].mean() > 5.0 * change[~mask].mean()
            assert change[mask].mean() > 8.0


def test_the_page_shows_the_edits_side_by_side(small_demo):
    out = small_demo[0]
    page = (out / REPORT).read_text(encoding="utf-8")
    assert page.count("data:image/jpeg") == 7 * demo.SHOWN
    for run in (demo.RUN, demo.RETEXTURED, demo.REPLACED):
        assert f'href="{run}/{REPORT}"' in page and (out / run / REPORT).is_file()
