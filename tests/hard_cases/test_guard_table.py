"""The table of hard cases fits the source: guards stand where it says, and the tests that hold them exist."""

import runpy
import sys
from pathlib import Path
from unittest import mock

import pytest

PROJECT = Path(__file__).parents[2]
BENCHMARKS = PROJECT / "benchmarks"
with mock.patch.object(sys, "path", [str(BENCHMARKS), *sys.path]):  # as the interpreter does for a script
    CASES = runpy.run_path(str(BENCHMARKS / "mutate_guards.py"))["CASES"]
GUARDS = [guard for case in CASES for guard in case.guards]


@pytest.mark.parametrize("guard", GUARDS, ids=lambda guard: f"{guard.file}: {guard.source[:40]}")
def test_a_guard_stands_once_and_its_test_exists(guard):
    source = (PROJECT / "src" / "diga3d_warp" / guard.file).read_text(encoding="utf-8")
    assert source.count(guard.source) == 1, "change the table in benchmarks with the guard"
    file, _, name = guard.test.partition("::")
    tests = (PROJECT / "tests" / file).read_text(encoding="utf-8")
    assert f"def {name.partition('[')[0]}(" in tests if name else "def test_" in tests


def test_every_case_is_documented():
    """Run benchmarks/mutate_guards.py after changing the table: it writes the document."""
    written = (PROJECT / "docs" / "hard-cases.md").read_text(encoding="utf-8")
    for case in CASES:
        assert f"| {case.name} | {case.handling} |" in written
    assert f"{len(GUARDS)} guards, all of them caught" in written
