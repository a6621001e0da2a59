"""The public face: every name is there, and comes from the module that defines it."""

import subprocess
import sys
from importlib.metadata import version

import pytest

import diga3d_warp
from diga3d_warp.errors import InputError
from diga3d_warp.pipelines.request import EditRequest


def test_every_public_name_is_there():
    names = [name for name in diga3d_warp.__all__ if name != "__version__"]
    for name in names:
        assert getattr(diga3d_warp, name).__name__ == name
    assert set(names) == set(diga3d_warp._HOMES)
    assert set(diga3d_warp.__all__) <= set(dir(diga3d_warp))


def test_the_version_is_that_of_the_package():
    assert diga3d_warp.__version__ == version("diga3d-warp")


def test_unknown_name_is_an_attribute_error():
    assert not hasattr(diga3d_warp, "no_such_name")


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, diga3d_warp; assert not {'torch', 'warp', 'numpy'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("task", ["fit", "remove", "retexture", "replace"])
def test_each_pipeline_is_a_script(task):
    words = [sys.executable, "-m", f"diga3d_warp.pipelines.{task}", "--help"]
    said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert said.startswith(f"usage: diga3d {task} ")


@pytest.mark.parametrize("name", ["scene", "out", "masks", "exemplar", "asset", "mask_models"])
def test_an_empty_path_is_refused(name):
    """It would be the current folder."""
    given = {"scene": "room", "out": "run", name: ""}
    with pytest.raises(InputError, match=f"^{name} is empty: give a path$"):
        EditRequest(**given)
