"""The wheel and the sdist: what is in them, and that an installed package works outside of the checkout."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[1]


def run(*words: str | Path, **options) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*map(str, words)], capture_output=True, text=True, check=True, **options)


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """A folder with the sdist of the project and the wheel that is built from it."""
    folder = tmp_path_factory.mktemp("built")
    source = folder / "source"
    left_out = shutil.ignore_patterns(".*", "run", "build", "dist", "*.egg-info", "__pycache__")
    shutil.copytree(PROJECT, source, ignore=left_out)
    backend = "from setuptools import build_meta; print(build_meta.build_{}({!r}))"
    run(sys.executable, "-c", backend.format("sdist", str(folder)), cwd=source)
    with tarfile.open(next(folder.glob("*.tar.gz"))) as archive:
        archive.extractall(folder / "unpacked", filter="data")
    (unpacked,) = (folder / "unpacked").iterdir()
    run(sys.executable, "-c", backend.format("wheel", str(folder)), cwd=unpacked)
    return folder


def test_the_wheel_holds_the_package_alone(built):
    with zipfile.ZipFile(next(built.glob("*.whl"))) as wheel:
        names = wheel.namelist()
    assert "diga3d_warp/py.typed" in names and "diga3d_warp/kernels/compositing.py" in names
    tops = {name.split("/")[0] for name in names}
    assert len(tops) == 2 and "diga3d_warp" in tops, tops
    assert not [name for name in names if name.startswith("diga3d_warp/bench/")]


def test_the_sdist_holds_what_its_tests_need(built):
    (unpacked,) = (built / "unpacked").iterdir()
    for name in ("tests/conftest.py", "src/diga3d_warp/bench/kernels.py", "CITATION.cff", "Makefile"):
        assert (unpacked / name).is_file(), name


def test_the_installed_wheel_works_outside_of_the_checkout(built, tmp_path):
    target = tmp_path / "site"
    with zipfile.ZipFile(next(built.glob("*.whl"))) as wheel:
        wheel.extractall(target)
    environment = {**os.environ, "PYTHONPATH": str(target)}
    code = "import diga3d_warp as d3; d3.load_scene; print(d3.__file__, d3.__version__)"
    said = run(sys.executable, "-c", code, cwd=tmp_path, env=environment).stdout
    assert said.startswith(str(target))
    bench = subprocess.run(
        [sys.executable, "-m", "diga3d_warp.cli", "bench", "kernels"],
        cwd=tmp_path, env=environment, capture_output=True, text=True,
    )  # fmt: skip
    assert bench.returncode == 2 and "not part of the installed package" in bench.stderr, bench.stderr
