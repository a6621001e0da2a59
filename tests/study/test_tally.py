"""Tallies: shares and intervals, and files that do not count."""

from __future__ import annotations

import json
import math
from collections import Counter

import pytest

from diga3d_warp import cli
from diga3d_warp.errors import InputError
from diga3d_warp.study.tally import shares, tally
from diga3d_warp.study.write import write_study


@pytest.fixture
def page(make_run, tmp_path):
    questions = [
        [make_run(f"{name}/{scene}", shade - 5 * (scene == "can"), scene=scene) for name, shade in METHODS]
        for scene in ("bear", "can")
    ]
    return write_study(questions, tmp_path / "study.html", names=[name for name, _ in METHODS]).page


METHODS = (("ours", 200), ("lama", 120), ("warp", 90))


def test_wilson_interval_against_its_formula():
    """Wilson 1927: the roots of (p - k/n)^2 = z^2 p (1 - p) / n."""
    z = 1.959963984540054
    for votes, of in ((90, 108), (2, 108), (0, 7), (7, 7), (1, 2)):
        share = shares(Counter({"a": votes, "b": of - votes}), ["a", "b"])["a"]
        center = (votes + z * z / 2) / (of + z * z)
        half = z / (of + z * z) * math.sqrt(votes * (of - votes) / of + z * z / 4)
        assert share.low == pytest.approx(center - half, abs=1e-9)
        assert share.high == pytest.approx(center + half, abs=1e-9)
        assert 0 <= share.low <= votes / of + 1e-9 and votes / of <= share.high + 1e-9


def test_votes_of_all_participants_count(page, voted):
    files = [voted(page, "1.json", "1" * 16, [0, 0]), voted(page, "2.json", "2" * 16, [0, 2])]
    files.append(voted(page, "3.json", "3" * 16, [1, None]))
    result = tally(files)
    assert {name: share.votes for name, share in result.methods.items()} == {"ours": 3, "lama": 1, "warp": 1}
    assert result.participants == 3 and not result.notes
    by_question = [{name: s.votes for name, s in found.items()} for _, found in result.questions]
    assert by_question == [{"ours": 2, "lama": 1, "warp": 0}, {"ours": 1, "lama": 0, "warp": 1}]
    assert tally([files[0].parent]).methods == result.methods
    assert sum(share.votes for share in result.places.values()) == 5
    titles = [table.title for table in result.tables()]
    assert titles[0] == "5 votes of 3 participants" and len(titles) == 4


def test_edited_and_damaged_files_are_named_and_left_out(page, voted, capfd):
    good = voted(page, "good.json", "1" * 16, [0, 0])
    edited, cut = (
        voted(page, name, letter * 16, [1, 1]) for name, letter in (("edited.json", "2"), ("cut.json", "3"))
    )
    votes = json.loads(edited.read_text())
    first = votes["answers"][0]
    first["choice"] = next(code for code in first["order"] if code != first["choice"])
    edited.write_text(json.dumps(votes))
    cut.write_bytes(cut.read_bytes()[:-40])
    foreign = good.with_name("foreign.json")
    foreign.write_text("[1, 2]")
    assert cli.main(["study", "--tally", *map(str, (good, edited, cut, foreign))]) == 0
    written = capfd.readouterr()
    assert "2 votes of 1 participant\n" in written.out
    lines = written.err.splitlines()
    assert len(lines) == 3 and all(line.startswith("diga3d: note: not counted: ") for line in lines)
    assert "edited.json was edited" in lines[0] and "cut.json is not valid JSON" in lines[1]
    assert "foreign.json is no file of votes" in lines[2]
    assert cli.main(["study", "--tally", str(edited)]) == 2
    assert "no votes to count" in capfd.readouterr().err


@pytest.mark.parametrize("key", ["participant", "saved", "sealed", "study", "new"])
def test_every_part_of_the_file_is_checked(page, voted, key):
    file = voted(page, "a.json", "1" * 16, [0, 0])
    votes = json.loads(file.read_text())
    votes[key] = "9" + str(votes.get(key, "x"))[1:]
    file.write_text(json.dumps(votes, indent=1))
    with pytest.raises(InputError, match="was edited"):
        tally([file])


def test_other_spacing_is_no_edit(page, voted):
    file = voted(page, "a.json", "1" * 16, [0, 1])
    file.write_text(json.dumps(json.loads(file.read_text())))
    assert tally([file]).methods["ours"].votes == 1


def test_the_same_participant_counts_once(page, voted):
    later = voted(page, "b.json", "1" * 16, [1, 1], saved="2026-01-02")
    earlier = voted(page, "a.json", "1" * 16, [0, None], saved="2026-01-01")
    for files in ([earlier, later], [later, earlier], [later, earlier, later]):
        result = tally(files)
        assert result.methods["lama"].votes == 2 and result.methods["ours"].votes == 0
        assert result.participants == 1
        (note,) = result.notes
        assert "a.json is of the same participant as" in note


def test_other_studies_absent_files_and_options_beside_a_tally(page, voted, make_run, tmp_path, capfd):
    mine = voted(page, "a.json", "1" * 16, [0, 0])
    other = write_study([[make_run("x", 50), make_run("y", 60)]], tmp_path / "other.html").page
    theirs = voted(other, "b.json", "2" * 16, [0])
    nothing = voted(page, "c.json", "3" * 16, [None, None])
    empty = tmp_path / "empty"
    empty.mkdir()
    cases = [
        ([mine, theirs], "b.json is of another study"),
        ([mine, mine.with_name("absent.json")], "absent.json cannot be read"),
        ([nothing], "no question is answered"),
        ([empty], "holds no .json"),
        ([mine, "--out", "x.html"], "--tally takes files of votes alone"),
    ]
    for words, said in cases:
        assert cli.main(["study", "--tally", *map(str, words)]) == 2
        written = capfd.readouterr()
        assert written.err.count("\n") == 1 and said in written.err and written.out == "", written.err
