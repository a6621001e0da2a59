"""Tables of the experiments: what stands in their cells, also where jobs failed or weights are missing."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

import pytest
from quick_work import quick_work

from diga3d_warp.errors import InputError
from diga3d_warp.experiments import published
from diga3d_warp.experiments.figures import figures_of
from diga3d_warp.experiments.job import Job, JobFolder, Outcome, failed
from diga3d_warp.experiments.paper import NAMES, Experiment
from diga3d_warp.experiments.processes import LocalCrew
from diga3d_warp.experiments.remeasure import has_more_weights
from diga3d_warp.experiments.results import write_results
from diga3d_warp.experiments.run import run_jobs
from diga3d_warp.experiments.scenes import check_apart, find_scenes

EDITS = """
edits:
  - scene: 2
    command: retexture
    options: {prompt: white marble}
    source_prompt: a wooden chair
    edit_prompt: a white marble chair
  - {scene: "10", command: replace, options: {prompt: a wooden cube}}
"""


@pytest.fixture
def data(tmp_path) -> Path:
    """A data folder with the scenes 1, 2, 10 and book, what systems leave beside them, and edits."""
    for name in ("10", "1", "book", "2", ".git", "__MACOSX"):
        (tmp_path / "data" / name).mkdir(parents=True)
    (tmp_path / "data" / "readme.txt").touch()
    (tmp_path / "data" / "edits.yaml").write_text(EDITS)
    return tmp_path / "data"


def outcome(psnr: float | None, ssim: float = 0.5, **more) -> Outcome:
    figures = {"PSNR": {"whole": psnr, "masked": 9.0}, "SSIM": {"whole": ssim}}
    return Outcome(
        error=None, figures={**figures, **more}, missing={"LPIPS (VGG)": "vgg16 | 553 MB"},
        protocol="spin-nerf", views=3, size=[96, 72], version="1",
    )  # fmt: skip


def column(table, head: str) -> dict[str, str]:
    place = list(table.columns).index(head)
    return {row[0]: row[place] for row in table.rows}


def test_scenes_are_folders_in_the_order_of_counting(data):
    assert [scene.name for scene in find_scenes(data)] == ["1", "2", "10", "book"]
    assert [scene.name for scene in find_scenes(data, ["book", "1"])] == ["book", "1"]
    (data / "gone").symlink_to(data / "nowhere")
    assert [scene.name for scene in find_scenes(data)][-1] == "gone", "its job says that it is not there"
    (data / "1" / "poses_bounds.npy").touch()
    assert find_scenes(data / "1") == [data / "1"]
    with pytest.raises(InputError, match="has no scene '3': it has 1, 2, 10, book"):
        find_scenes(data, ["3"])
    with pytest.raises(InputError, match="holds no folders of scenes"):
        find_scenes(data / "2")
    with pytest.raises(InputError, match=r"readme.txt is not a folder"):
        find_scenes(data / "readme.txt")


def test_results_do_not_go_among_the_scenes(data):
    check_apart(data.parent / "out", data)
    with pytest.raises(InputError, match="lies in the data folder"):
        check_apart(data / "results" / "a", data)


def test_every_experiment_has_the_columns_of_its_published_table(data):
    experiment = Experiment(data)
    sheets = {sheet.name: sheet for sheet in experiment.sheets(["all"])}
    assert tuple(sheets) == NAMES
    for sheet in sheets.values():
        heads = {column.head for column in sheet.columns}
        for row in sheet.published:
            assert set(row.cells) <= {*heads, "memory", "size [px]"}, sheet.name
    assert len(sheets["table1"].jobs) == 4
    assert len(sheets["table3"].rows) == 4 and len(sheets["table3"].jobs) == 16
    assert {job.scene_name for job in sheets["table4"].jobs} == {"1"}
    assert [job.options["references"] for job in sheets["table4"].jobs] == [1, 2, 3]
    assert {job.size for job in sheets["table4"].jobs} == {512}
    # What several tables need is run once.
    shared = {job.name for job in sheets["table1"].jobs}
    assert shared < {job.name for job in sheets["table3"].jobs}
    assert shared < {job.name for job in sheets["table5"].jobs}
    assert shared < {job.name for job in sheets["accuracy"].jobs}


def test_each_prior_with_each_representation_is_a_row(data):
    experiment = Experiment(
        data, priors=["exemplar", "/weights/sd"], representations=["gaussians", "scaffold"], scenes=["1"]
    )
    (sheet,) = experiment.sheets(["table1"])
    assert [row.method.removeprefix("diga3d-warp, ") for row in sheet.rows] == [
        "exemplar", "exemplar, scaffold", "sd", "sd, scaffold",
    ]  # fmt: skip
    assert [job.options for job in sheet.jobs] == [
        {"prior": "exemplar"},
        {"prior": "exemplar", "representation": "scaffold"},
        {"prior": "/weights/sd"},
        {"prior": "/weights/sd", "representation": "scaffold"},
    ]


def test_an_edit_may_have_an_image_size_of_its_own(data):
    edit = "edits: [{scene: 2, command: replace, options: {prompt: a, image_scale: 0.5}}]"
    (data / "edits.yaml").write_text(edit)
    (job,) = Experiment(data).sheets(["table2"])[0].jobs
    assert job.size is None and job.options["image_scale"] == 0.5


def test_published_figures_are_those_of_the_paper():
    best = {row.method: row.cells for row in published.TABLE1}["DiGA3D"]
    assert (best["PSNR ↑"], best["masked PSNR ↑"], best["masked LPIPS ↓"]) == ("20.71", "17.22", "0.56")
    assert [row.cells["PSNR ↑"] for row in published.TABLE3] == ["20.71", "20.66", "20.45"]
    assert [row.cells["memory"] for row in published.TABLE4] == ["41 GB", "46 GB", "47 GB"]
    assert {row.source.split(",")[0] for row in published.TABLE2} == {"DiGA3D"}


def test_cells_of_means_failures_and_missing_weights(data):
    (sheet,) = Experiment(data).sheets(["table1"])
    lines = [outcome(20.0), failed("no view has a mask | at all", "1"), outcome(30.0, 0.25), outcome(None)]
    outcomes = {job.name: line for job, line in zip(sheet.jobs, lines, strict=True)}
    main = sheet.main({**outcomes, sheet.jobs[3].name: failed("gone", "1")})
    assert column(main, "PSNR ↑")["diga3d-warp, exemplar"] == "25.00"
    assert column(main, "SSIM ↑")["diga3d-warp, exemplar"] == "0.3750"
    assert column(main, "masked PSNR ↑")["diga3d-warp, exemplar"] == "9.00"
    assert column(main, "LPIPS ↓")["diga3d-warp, exemplar"] == "not measured"
    assert column(main, "jobs done")["diga3d-warp, exemplar"] == "2 of 4"
    assert column(main, "masked PSNR ↑")["GScream"] == "15.84" and column(main, "FID ↓")["GScream"] == "–"
    assert {row[1] for row in main.rows} == {"measured", "DiGA3D, arXiv 2507.00429, Table 1"}
    assert column(sheet.main(outcomes), "PSNR ↑")["diga3d-warp, exemplar"] == "inf"
    some = outcome(40.0, LPIPS=1.0) | {"figures": {"SSIM": {"whole": 0.75}}}
    main = sheet.main({**outcomes, sheet.jobs[3].name: some})
    assert column(main, "PSNR ↑")["diga3d-warp, exemplar"] == "25.00 (2 of 3)"
    assert column(main, "SSIM ↑")["diga3d-warp, exemplar"] == "0.5000"
    single = sheet.single(outcomes)
    assert [row[-1] for row in single.rows] == ["done", "no view has a mask | at all", "done", "done"]
    assert single.rows[1][2] == "failed"
    (lacks,) = sheet.missing(outcomes).rows
    assert lacks == ["LPIPS (VGG)", "vgg16 | 553 MB"]
    everything = {job.name: failed("gone", "1") for job in sheet.jobs}
    assert column(sheet.main(everything), "PSNR ↑")["diga3d-warp, exemplar"] == "failed"


def test_files_of_the_tables(data, tmp_path):
    """Markdown whose rows are whole whatever errors hold, CSV that reads back, LaTeX that compiles."""
    experiment = Experiment(data, scenes=["1", "2"])
    (sheet,) = experiment.sheets(["table1"])
    lines = [outcome(20.0), failed("a | b\nc_d & 5 %", "1")]
    outcomes = {job.name: line for job, line in zip(sheet.jobs, lines, strict=True)}
    files = write_results(tmp_path / "out", [sheet], outcomes)
    assert {file.name for file in files} == {
        "table1.md", "table1.csv", "table1.tex", "costs.md", "pictures.html",
    }  # fmt: skip
    text = (tmp_path / "out" / "table1.md").read_text()
    rows = [line.replace("\\|", "").count("|") for line in text.splitlines() if line.startswith("| diga3d")]
    assert rows and len(set(rows[1:])) == 1 and "a \\| b c_d & 5 %" in text
    read = list(csv.DictReader(io.StringIO((tmp_path / "out" / "table1.csv").read_text())))
    ours = [row for row in read if row["source"] == "measured"]
    assert [row["scene"] for row in ours] == ["mean", "1", "2"] and ours[2]["outcome"] == "a | b c_d & 5 %"
    assert len(read) == len(published.TABLE1) + 3
    latex = (tmp_path / "out" / "table1.tex").read_text()
    assert "LPIPS $\\downarrow$" in latex and latex.count("\\midrule") == 2
    assert len({line.count("&") for line in latex.splitlines() if line.endswith("\\\\")}) == 1


def test_edits_of_table2(data, tmp_path):
    (sheet,) = Experiment(data).sheets(["table2"])
    retexture, replaced = sheet.jobs
    assert (retexture.command, retexture.scene_name, retexture.source_prompt) == (
        "retexture",
        "2",
        "a wooden chair",
    )
    assert (replaced.command, replaced.scene_name, replaced.edit_prompt) == ("replace", "10", None)
    first = outcome(1.0, CLIP_dir={"whole": 0.125})
    second = outcome(1.0) | {
        "missing": {"CLIP_dir": "give --source-prompt, what the scene shows before the edit"}
    }
    main = sheet.main({retexture.name: first, replaced.name: second})
    assert column(main, "re-texturing CLIP_dir ↑")["diga3d-warp, exemplar"] == "0.1250"
    assert column(main, "replacement CLIP_dir ↑")["diga3d-warp, exemplar"] == "not measured"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("edits: []", "the list of edits is empty"),
        ("edits: [{scene: 2}]", "edit 1: it has no scene or no command"),
        ("edits: [{scene: 3, command: replace, options: {prompt: a}}]", "has no scene '3'"),
        ("edits: [{scene: 2, command: remove, options: {prompt: a}}]", "edits[0].command is 'remove'"),
        ("edits: [{scene: 2, command: replace}]", "edit 1: its options name no prompt, exemplar or asset"),
        ("edits: [{scene: 2, comand: replace}]", "edit 1: comand is unknown: did you mean command?"),
        ("edits: [{scene: 2, command: replace, options: {promt: a}}]", "option promt is unknown"),
    ],
)
def test_mistakes_in_the_edits_take_one_line(data, text, words):
    (data / "edits.yaml").write_text(text)
    with pytest.raises(InputError) as caught:
        Experiment(data).sheets(["table2"])
    assert words in str(caught.value) and "edits.yaml" in str(caught.value) and "\n" not in str(caught.value)


def test_table2_without_edits(data):
    (data / "edits.yaml").unlink()
    with pytest.raises(InputError, match=r"table2 needs .*edits.yaml"):
        Experiment(data).sheets(["table2"])
    assert "table2" not in {sheet.name for sheet in Experiment(data).sheets(["all"])}


def test_figures_of_an_evaluation():
    evaluation = {
        "comparisons": [
            {"title": "source against photographs", "mean": {"whole": {"psnr": 1.0, "ssim": 0.1}}},
            {"title": "edited against photographs", "mean": {"unmasked": {"psnr": None, "ssim": 0.2}}},
        ],
        "perceptual": {
            "comparisons": {
                "source against photographs": {"mean": {"MUSIQ": {"whole": 11.0}}},
                "edited against photographs": {"mean": {"MUSIQ": {"whole": 33.0}}},
                "edited against source": {"mean": {"CLIP_dir": {"whole": 0.5}, "MUSIQ": {"whole": 44.0}}},
            },
            "corrs": {
                "rows": [
                    {
                        "title": "edited, along a path",
                        "matches": {"SIFT matches": {"whole": 7.0, "masked": None}},
                    },
                    {
                        "title": "source, along a path",
                        "matches": {"SIFT matches": {"whole": 8.0, "masked": None}},
                    },
                ]
            },
        },
    }
    assert figures_of(evaluation) == {
        "PSNR": {"unmasked": None}, "SSIM": {"unmasked": 0.2}, "MUSIQ": {"whole": 33.0},
        "CLIP_dir": {"whole": 0.5}, "SIFT matches": {"whole": 7.0},
    }  # fmt: skip
    assert figures_of({"comparisons": evaluation["comparisons"]})["SSIM"] == {"unmasked": 0.2}


def test_jobs_are_measured_again_once_weights_are_there(tmp_path, monkeypatch):
    from diga3d_warp.experiments import remeasure

    job = Job("retexture", "/scenes/a", {"prompt": "oak"}, source_prompt="a chair")
    lacking = outcome(1.0) | {"missing": {"CLIP_dir": "no folder", "MUSIQ": "no file"}}
    for found, again in ((set(), False), ({"MUSIQ"}, True), ({"LPIPS (VGG)"}, False)):
        monkeypatch.setattr(remeasure, "_found", lambda weights, prompts, found=found: frozenset(found))
        assert has_more_weights(job, lacking) is again
    assert not has_more_weights(job, outcome(1.0) | {"missing": {}})
    monkeypatch.undo()
    assert not has_more_weights(replace(job, weights=str(tmp_path)), lacking | {"protocol": None})


def test_a_finished_job_that_is_measured_again_keeps_its_run(tmp_path):
    job = Job("remove", "/scenes/a")
    run_jobs([job], tmp_path, LocalCrew(), quick_work)
    folder = JobFolder(tmp_path, job)
    before = {path.name: path.stat().st_mtime_ns for path in folder.run.iterdir()}
    (again,) = run_jobs([job], tmp_path, LocalCrew(), quick_work, lambda *_: True).values()
    assert again["error"] is None
    assert {path.name: path.stat().st_mtime_ns for path in folder.run.iterdir()} == before


def test_the_share_of_a_study_stands_beside_its_prior(data, monkeypatch, capsys):
    from diga3d_warp.study import tally as study

    def tally(paths):
        shares = {"exemplar": study.Share(3, 4, 0.3, 0.95), "lama": study.Share(1, 4, 0.05, 0.7)}
        return study.Tally(4, shares, [], shares, [f"not counted: {paths[0]} was edited"])

    monkeypatch.setattr(study, "tally", tally)
    experiment = Experiment(data, priors=["exemplar", "/weights/other"], votes=[Path("a.json")])
    (sheet,) = experiment.sheets(["table2"])
    assert "note: not counted: a.json was edited" in capsys.readouterr().err
    outcomes = {job.name: outcome(1.0) for job in sheet.jobs}
    shares = column(sheet.main(outcomes), "re-texturing user study [%]")
    assert shares["diga3d-warp, exemplar"] == "75.00" and shares["diga3d-warp, other"] == "not measured"
    assert shares["GaussCtrl"] == "12.97"
    assert "4 votes of 4 participants" in [table.title for table in sheet.tables(outcomes)]
