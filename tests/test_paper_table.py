"""docs/paper.md: its functions and tests exist, and the code names sections and equations as it does."""

import ast
import re
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import pytest

import diga3d_warp

PACKAGE = Path(diga3d_warp.__file__).parent
PROJECT = Path(__file__).parents[1]


class Row(NamedTuple):
    """One line of the table."""

    paper: frozenset[str]
    functions: tuple[str, ...]
    tests: tuple[str, ...]


def row_of(line: str) -> Row:
    paper, _, functions, tests = (cell.strip() for cell in line.strip("|\n").split("|"))
    quoted = [tuple(re.findall("`([^`]+)`", cell)) for cell in (functions, tests)]
    return Row(frozenset(numbers(paper)), *quoted)


def numbers(text: str) -> list[str]:
    """Sections and equations of the paper that a text names; those of other papers follow a year."""
    found = []
    for mention in re.finditer(r"\b(Sec|Eqs?)\.\s+((?:\d+(?:\.\d+)*(?:,\s+|\s+and\s+)?)+)", text):
        before = " ".join(text[: mention.start()].split())
        if re.search(r"(\d{4}[a-z]?|3DGS-MCMC|\"),?$", before):
            continue
        kind = "Sec." if mention[1] == "Sec" else "Eq."
        found += [f"{kind} {number}" for number in re.findall(r"\d+(?:\.\d+)*", mention[2])]
    return found


TABLE = [
    row_of(line)
    for line in (PROJECT / "docs" / "paper.md").read_text(encoding="utf-8").splitlines()
    if line.startswith("| Sec.")
]

MODULES = sorted(PACKAGE.rglob("*.py"))


def home_of(function: str) -> tuple[str, list[str]]:
    """The module that a name of the table begins with, and the attributes that follow."""
    parts = function.split(".")
    for length in range(len(parts), 0, -1):
        path = PACKAGE.joinpath(*parts[:length])
        if path.with_suffix(".py").is_file():
            return ".".join(parts[:length]), parts[length:]
    raise AssertionError(f"{function}: no such module")


def test_every_equation_of_the_paper_has_a_row():
    named = {number for row in TABLE for number in row.paper}
    assert {number for number in named if number.startswith("Eq.")} == {f"Eq. {k}" for k in range(1, 10)}
    assert {number for number in named if number.startswith("Sec.")} == {f"Sec. 3.{k}" for k in range(1, 6)}


@pytest.mark.parametrize("row", TABLE, ids=lambda row: " ".join(sorted(row.paper)))
def test_functions_and_tests_exist(row):
    assert row.functions and row.tests
    for function in row.functions:
        module, attributes = home_of(function)
        found = import_module(f"diga3d_warp.{module}")
        for attribute in attributes:
            found = getattr(found, attribute)
    for test in row.tests:
        file, _, name = test.partition("::")
        tree = ast.parse((PROJECT / file).read_text(encoding="utf-8"))
        assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, test


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_modules_name_the_numbers_of_their_rows(path):
    module = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
    rows = [row for row in TABLE if module in {home_of(function)[0] for function in row.functions}]
    listed = {number for row in rows for number in row.paper} | {"Sec. 3"}
    assert set(numbers(path.read_text(encoding="utf-8"))) <= listed


def test_documents_name_numbers_of_the_table():
    listed = {number for row in TABLE for number in row.paper} | {"Sec. 3"}
    for path in [PROJECT / "README.md", *(PROJECT / "docs").rglob("*.md")]:
        assert set(numbers(path.read_text(encoding="utf-8"))) <= listed, path


def test_mentions_are_found():
    assert numbers("(paper Sec. 3.3, 3.4)") == ["Sec. 3.3", "Sec. 3.4"]
    assert numbers("Sec. 3.3, Eq. 3 and Eq. 4.") == ["Sec. 3.3", "Eq. 3", "Eq. 4"]
    assert numbers("of Eq. 3 and 4 written out") == ["Eq. 3", "Eq. 4"]
    assert numbers("Song et al. 2021, Eq. 12, and 3DGS-MCMC Eq. 8") == []
    assert numbers('"Denoising diffusion\n implicit models", Eq. 12') == []
