"""Plans of sweeps: what they mean, and one line for each mistake in them."""

from __future__ import annotations

from pathlib import Path

import pytest

from diga3d_warp.errors import InputError
from diga3d_warp.experiments.options import check_jobs
from diga3d_warp.experiments.plan import read_plan
from diga3d_warp.experiments.sweep import sheet_of


@pytest.fixture
def plan(tmp_path):
    """Writes plan.yaml beside the scenes bear and statue, and returns its path."""
    for name in ("bear", "statue", ".hidden"):
        (tmp_path / "captures" / name).mkdir(parents=True)

    def write(text: str | bytes, name: str = "plan.yaml") -> Path:
        data = text.encode() if isinstance(text, str) else text
        (tmp_path / name).write_bytes(data)
        return tmp_path / name

    return write


def test_the_grid_of_a_plan(plan, tmp_path):
    read = read_plan(
        plan(
            """
            command: retexture
            scenes: [captures/*]
            prompts: [white marble, oak]
            seeds: [0, 1]
            vary: {accuracy: [draft, standard]}
            options: {image-scale: 0.5, masks: "{scene}/object", mask-ids: [3], effects: {shadow: off}}
            source_prompt: a bear
            """
        )
    )
    jobs = read.jobs()
    assert len(jobs) == len({job.name for _, job in jobs}) == 2 * 2 * 2 * 2
    values, job = jobs[0]
    assert values == {"prompt": "white marble", "seed": 0, "accuracy": "draft"}
    scene = str(tmp_path / "captures" / "bear")
    assert job.scene == scene and job.source_prompt == "a bear" and job.size is None
    assert job.options == {
        "image_scale": 0.5, "masks": f"{scene}/object", "mask_ids": [3], "effects": {"shadow": False},
        "prompt": "white marble", "seed": 0, "accuracy": "draft",
    }  # fmt: skip
    sheet = sheet_of(read, tmp_path / "plan.yaml")
    assert [row.method for row in sheet.rows][:2] == [
        "prompt white marble, accuracy draft", "prompt white marble, accuracy standard"
    ]  # fmt: skip
    assert all(len(row.jobs) == 4 for row in sheet.rows) and "Means over 2 seeds" in sheet.notes[0]


def test_patterns_pass_over_runs_and_earlier_sweeps(plan, tmp_path):
    captures = tmp_path / "captures"
    (captures / "sweep" / "jobs").mkdir(parents=True)
    (captures / "removed" / "stages").mkdir(parents=True)
    (captures / "removed" / "manifest.json").touch()
    read = read_plan(plan("command: remove\nscenes: [captures/*]"))
    assert [scene.name for scene in read.scenes] == ["bear", "statue"]


def test_a_plan_with_the_name_of_another_result(plan):
    path = plan("command: remove\nscenes: [captures/bear]", "costs.yaml")
    with pytest.raises(InputError, match=r"costs.md is the name of another result"):
        sheet_of(read_plan(path), path)


def test_a_plan_may_be_json(plan):
    text = '{"command": "remove", "scenes": ["captures/bear"], "published_size": true}'
    ((values, job),) = read_plan(plan(text, "plan.json")).jobs()
    assert not values and job.size == "published" and job.options == {}


def test_paths_are_relative_to_the_plan(plan, tmp_path):
    text = """
    command: replace
    scenes: [captures/bear]
    options: {asset: things/cup.glb, fill: [view_3=mine.png, others], prior: models/room}
    """
    ((_, job),) = read_plan(plan(text)).jobs()
    assert job.options == {
        "asset": str(tmp_path / "things" / "cup.glb"), "prior": str(tmp_path / "models" / "room"),
        "fill": [f"view_3={tmp_path / 'mine.png'}", str(tmp_path / "others")],
    }  # fmt: skip


HEAD = "command: remove\nscenes: [captures/bear]\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"),
        ("[1, 2]", "the whole is a list"),
        ("remove", "the whole is 'remove'"),
        ("scenes: [captures/bear]", "command is missing"),
        ("command: remove", "scenes is missing"),
        ("command: erase\nscenes: [captures/bear]", "command is 'erase'"),
        (HEAD + "prior: [lama]", "prior is unknown: did you mean priors?"),
        (HEAD + "gpu: 1", "gpu is unknown: known are command"),
        (HEAD + "seeds: [0]\nseeds: [1]", "line 4: seeds stands twice"),
        (HEAD + "seeds: []", "the list of seed is empty, so there is nothing to run"),
        ("command: remove\nscenes: []", "the list of scenes is empty"),
        (HEAD + "vary: {references: []}", "the list of references is empty"),
        (HEAD + "seeds: 3", "seeds is 3"),
        (HEAD + "seeds: [a]", "seeds[0] is 'a'"),
        (HEAD + "seeds: [010]", "line 3: 010 is a number in another base"),
        (HEAD + "seeds: [1, 1]", "1 stands twice in the list of seed"),
        (HEAD + "seeds: [true]", "seeds[0] is True"),
        (HEAD + "priors: [no]", "priors[0] is False"),
        (HEAD + "options: {refences: 3}", "option refences is unknown: did you mean references?"),
        (HEAD + "options: {references: many}", "option references is 'many'"),
        (HEAD + "options: {out: run}", "option out is unknown"),
        (HEAD + "options: {selection: nearest}", "option selection is 'nearest'"),
        (HEAD + "options: {image_scale: .nan}", "option image_scale is nan"),
        (HEAD + "options: {seed: 1}\nseeds: [1, 2]", "seed stands in options and is varied"),
        (HEAD + "vary: {seed: [1]}\nseeds: [1, 2]", "seed is varied twice"),
        (HEAD + "options: {image_scale: 1}\npublished_size: true", "exclude each other"),
        ("command: fit\nscenes: [captures/bear]\npriors: [lama]", "option prior is unknown"),
        ("command: fit\nscenes: [captures/bear]\nsource_prompt: a bear", "a fit has no edit"),
        ("command: retexture\nscenes: [captures/bear]", "a retexture needs prompt or exemplar"),
        ("command: replace\nscenes: [captures/bear]\nprompts: []", "the list of prompt is empty"),
        ("command: remove\nscenes: [captures/none]", "there is no scene captures/none"),
        ("command: remove\nscenes: [captures/x*]", "there is no scene captures/x*"),
        (HEAD + "prompts: [a\n", "line"),
        (HEAD + "\tseeds: [1]", "line 3"),
        (b"\xff\xfe\x00", "plan.yaml"),
        (b"command: \x00", "plan.yaml"),
        ("a: " + "[" * 5000, "plan.yaml"),
        ("&a [*a]", "plan.yaml"),
        ("command: remove\nscenes: [captures/bear]\n? [1, 2]\n: 3", "plan.yaml"),
        ("!!python/object:os.system {}", "plan.yaml"),
    ],
)
def test_mistakes_take_one_line(plan, text, words):
    path = plan(text)
    with pytest.raises(InputError) as caught:
        read_plan(path)
    line = str(caught.value)
    assert words in line and str(path) in line and "\n" not in line, line


def test_a_plan_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_plan(tmp_path / "plan.yaml")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("{accuracy: best}", "accuracy 'best' is unknown"),
        ("{prior: classical, propagation: attention}", "prior classical estimates no noise"),
        ("{prior: nothing}", "there is no prior or folder nothing"),
        ("{steps: 5}", "--steps: prior exemplar is no network"),
    ],
)
def test_options_that_no_scene_could_be_run_with(plan, options, words):
    """They are refused before any job starts, not by each job after its fit."""
    jobs = [job for _, job in read_plan(plan(HEAD + f"options: {options}")).jobs()]
    with pytest.raises(InputError, match=words):
        check_jobs(jobs)
