"""Take each guard of the hard cases (*_cases.py) out of a copy of the project: its test must fail.

python benchmarks/mutate_guards.py            all guards, 15 min on two cores; writes docs/hard-cases.md
python benchmarks/mutate_guards.py NAME ...   only cases whose name holds one of these words, and their rows

Ends with 1 if a guard is not found, if its test passes without it, or fails for another reason than its own.
"""

from __future__ import annotations

import ast
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from fill_cases import FILL_CASES
from guards import Guard, HardCase
from scaffold_cases import SCAFFOLD_CASES

from hard_cases import CASES as RENDERER_CASES

CASES = (*RENDERER_CASES, *FILL_CASES, *SCAFFOLD_CASES)

PROJECT = Path(__file__).parents[1]
PACKAGE = Path("src/diga3d_warp")
DOCUMENT = PROJECT / "docs" / "hard-cases.md"

MEMORY = 16 << 30
"""Address space of a test run [bytes]: without its guard, the test of 2^32 pairs would fill the machine."""

CAUGHT = (
    r"assert|(Assertion|Index|Memory|Value|ZeroDivision)Error|Failed: DID NOT"
    r"|RuntimeError: Failed to allocate|diga3d_warp\.errors\.InputError"
)
"""How a failure begins that a missing guard causes. A mutation that does not compile fails otherwise."""

HOMES = {
    "Splatting": "config.py",
    "Accuracy": "config.py",
    "config": "config.py",
    "ReprojectionLimits": "kernels/reprojection.py",
    "MeshLimits": "kernels/mesh.py",
    "cameras": "kernels/cameras.py",
    "pixel_lanes": "kernels/pixel_lanes.py",
    "camera": "scene/camera.py",
    "losses": "gaussians/losses.py",
    "SurfaceSettings": "surfaces/settings.py",
    "BoundarySettings": "surfaces/settings.py",
    "AgreementSettings": "surfaces/settings.py",
    "LayoutSettings": "surfaces/settings.py",
    "ShadowSettings": "shadows/settings.py",
    "MirrorSettings": "mirrors/settings.py",
    "FillCheck": "pipelines/own_fills.py",
    "decoder": "gaussians/scaffold/decoder.py",
    "anchors": "gaussians/scaffold/anchors.py",
    "voxels": "gaussians/scaffold/voxels.py",
}
"""File of each class or module that `HardCase.constants` names."""


@dataclass(frozen=True)
class Verdict:
    """What became of one mutation: whether its test failed as it should, and the reason that pytest gives."""

    killed: bool
    reason: str

    @property
    def brief(self) -> str:
        """The reason without the folders of the machine on which the test ran."""
        return re.sub(r"(?<![\w.])/[^\s']*/", "", self.reason)


class Copy:
    """A copy of the project that can be broken. Warp caches broken kernels beside whole ones, by source."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        ignored = shutil.ignore_patterns("__pycache__", "*.egg-info")
        for name in ("src", "tests", "benchmarks"):
            shutil.copytree(PROJECT / name, folder / name, ignore=ignored)
        shutil.copy(PROJECT / "pyproject.toml", folder)

    def test(self, *tests: str) -> tuple[int, str]:
        """Exit status and output of pytest."""
        environment = {
            **os.environ,
            "PYTHONPATH": str(self.folder / "src"),
            "PYTHONDONTWRITEBYTECODE": "1",  # a mutation and its repair can share a second and a size
            "COLUMNS": "300",
        }
        command = [sys.executable, "-m", "pytest", "-x", "-q", "--tb=short", "-p", "no:cacheprovider"]
        done = subprocess.run(
            [*command, *(f"tests/{test}" for test in tests)],
            cwd=self.folder, env=environment, capture_output=True, text=True, check=False,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY)),
        )  # fmt: skip
        return done.returncode, done.stdout + done.stderr

    def without(self, guard: Guard) -> Verdict:
        """Run a guard's test while the guard is gone."""
        path = self.folder / PACKAGE / guard.file
        whole = path.read_text(encoding="utf-8")
        path.write_text(whole.replace(guard.source, guard.without), encoding="utf-8")
        try:
            status, output = self.test(guard.test)
        finally:
            path.write_text(whole, encoding="utf-8")
        failed = re.search(r"^FAILED (\S.*?)(?: - (.*))?$", output, re.MULTILINE)
        if status == 0:
            return Verdict(False, "the test passes without the guard")
        if status != 1 or failed is None:
            return Verdict(False, f"pytest ended with {status}:\n{output[-2000:]}")
        reason = failed[2] or ""
        raised = re.findall(r"^E   +(\S.*)$", output, re.MULTILINE)
        as_wanted = re.match(CAUGHT, reason) or (raised and re.match(CAUGHT, raised[0]))
        return Verdict(bool(as_wanted), (raised or [reason])[0] if as_wanted else output[-3000:])


def missing(cases: tuple[HardCase, ...] = CASES) -> list[str]:
    """Guards whose source does not stand exactly once in its file, in words."""
    complaints = []
    for case in cases:
        for guard in case.guards:
            path = PROJECT / PACKAGE / guard.file
            found = path.read_text(encoding="utf-8").count(guard.source) if path.exists() else 0
            if found != 1:
                complaints.append(f"{case.name}: {found} times in {guard.file}: {guard.source}")
    return complaints


def explained(constant: str) -> str:
    """Name, value and reason of a constant, as its source gives them."""
    home, name = constant.split(".")
    tree = ast.parse((PROJECT / PACKAGE / HOMES[home]).read_text(encoding="utf-8"))
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == home]
    body = classes[0].body if classes else tree.body
    for statement, following in zip(body, [*body[1:], None], strict=True):
        target = getattr(statement, "target", None) or (getattr(statement, "targets", None) or [None])[0]
        if getattr(target, "id", None) != name:
            continue
        value = ast.unparse(statement.value)  # type: ignore[attr-defined]
        if classes:
            attribute = rf"^    [^:\n]*\b{name}\b[^:\n]*: (.*(?:\n        .*)*)"
            entry = re.search(attribute, ast.get_docstring(classes[0]) or "", re.MULTILINE)
            assert entry, f"{constant} has no reason"
            reason = entry[1]
        else:
            assert isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant), constant
            reason = str(following.value.value)
        return f"`{name} = {value}`: {' '.join(reason.split())}"
    raise ValueError(f"{constant} is not in {HOMES[home]}")


def row(case: HardCase, verdicts: dict[Guard, Verdict]) -> str:
    """A case's row of the table."""
    constants = "<br>".join(explained(constant) for constant in case.constants)
    tests = "<br>".join(dict.fromkeys(f"`{guard.test}`" for guard in case.guards))
    proofs = "<br>".join(
        f"`{_cell(guard.source)}` -> `{_cell(guard.without)}`: {_cell(verdicts[guard].brief)[:90]}"
        for guard in case.guards
    )
    return f"| {case.name} | {case.handling} | {constants} | {tests} | {proofs} |"


def document(verdicts: dict[Guard, Verdict], written: str) -> str:
    """The text of docs/hard-cases.md; rows of cases that were not tried stay as they were written."""
    before = {line.split(" | ")[0].removeprefix("| "): line for line in written.splitlines() if "| " in line}
    tables, count = [], 0
    for cases in (RENDERER_CASES, FILL_CASES, SCAFFOLD_CASES):
        rows = []
        for case in cases:
            if caught(case, verdicts):
                rows.append(row(case, verdicts))
            elif case.name in before:
                rows.append(before[case.name])
            else:
                continue
            count += len(case.guards)
        tables.append("\n".join(rows))
    return TEXT.format(count=count, rows=tables[0], fills=tables[1], anchors=tables[2])


def caught(case: HardCase, verdicts: dict[Guard, Verdict]) -> bool:
    """Whether all guards of a case were tried, and none was missed."""
    return all(guard in verdicts and verdicts[guard].killed for guard in case.guards)


def _cell(text: str) -> str:
    """Source that fits into a cell of a Markdown table."""
    return " ".join(text.split()).replace("|", "\\|").replace("`", "'")


TEXT = """\
# Hard cases

What splatting engines, fills and anchors meet in real scenes, and what happens here. Written by
`python benchmarks/mutate_guards.py`, which takes each guard out of a copy of the source, runs the test named
beside it, and accepts the row only if that test fails: {count} guards, all of them caught.

Every small scene of `tests/hard_cases/test_against_float64.py` is also held against a plain float64
renderer, image within 1e-4 and all gradients within 1e-3. Random scenes, cameras and depth maps full of NaN,
infinities, denormals and extreme numbers run in `tests/hard_cases/test_fuzz.py`: no exception, nothing that
is not finite, images bounded, culled and untouched gaussians with gradients of exactly zero, and the same
bits twice. A longer run: `DIGA3D_FUZZ=10000 pytest tests/hard_cases/test_fuzz.py`.

Tests stand below `tests`; the last column shows the guard, what replaced it, and how the test failed.

| Case | What happens | Constants and their reasons | Tests | Without the guard |
|---|---|---|---|---|
{rows}

Fills:

| Case | What happens | Constants and their reasons | Tests | Without the guard |
|---|---|---|---|---|
{fills}

Anchors (Scaffold-GS):

| Case | What happens | Constants and their reasons | Tests | Without the guard |
|---|---|---|---|---|
{anchors}

Not in the tables, because without it only time is lost: triangles that lie outside the target are not
visited.

Needles a pixel wide that cross the whole image are within 1e-4 in colour and 1e-3 in gradients of float64 at
100, 400 and 800 px (`tests/hard_cases/test_rounding.py`); rounding grows with their length. What no precision
takes away: where an alpha or a transmittance is as close to its cut-off as rounding carries it, float32 and
float64 may decide differently, and that pixel is off by what is left out, some 1e-3. The page of
`diga3d bench accuracy` counts these pixels.
"""


def main(words: list[str]) -> int:
    """Run the mutations, and write the rows of the cases whose guards were all caught."""
    if complaints := missing():
        print("\n".join(complaints))
        return 1
    chosen = [case for case in CASES if not words or any(word.lower() in case.name.lower() for word in words)]
    verdicts: dict[Guard, Verdict] = {}
    with tempfile.TemporaryDirectory(prefix="mutate-") as folder:
        copy = Copy(Path(folder))
        status, output = copy.test(*dict.fromkeys(guard.test for case in chosen for guard in case.guards))
        if status != 0:
            print(f"the tests fail with all guards in place:\n{output[-3000:]}")
            return 1
        for case in chosen:
            for guard in case.guards:
                verdict = verdicts[guard] = copy.without(guard)
                print("caught " if verdict.killed else "MISSED ", f"{case.name}: {guard.source}", flush=True)
                print("       ", verdict.reason, flush=True)
    killed = sum(verdict.killed for verdict in verdicts.values())
    print(f"{killed} of {len(verdicts)} guards are caught by their tests")
    DOCUMENT.write_text(document(verdicts, DOCUMENT.read_text(encoding="utf-8")), encoding="utf-8")
    return int(killed < len(verdicts))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
