"""What docs/architecture.md promises of the whole package, read from its source."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import diga3d_warp

PACKAGE = Path(diga3d_warp.__file__).parent
PROJECT = Path(__file__).parents[1]

RANKS = (
    {"errors", "config", "process"},
    {"files", "checkpoints"},
    {"state"},
    {"kernels", "materials"},
    {"scene"},
    {"splatting"},
    {"gaussians", "perception"},
    {"priors"},
    {"surfaces"},
    {"propagation", "evaluation", "objects"},
    {"shadows"},
    {"mirrors"},
    {"effects"},
    {"pipelines"},
    {"doctor", "bench", "study"},
    {"experiments"},
    {"cli"},
)
"""Packages and modules from the bottom up: each imports itself and lower ranks only."""

RANK = {name: rank for rank, names in enumerate(RANKS) for name in names}

MODULES = sorted(path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py"))


def package_of(module: str) -> str:
    return module.split("/")[0].removesuffix(".py")


def imported(tree: ast.AST) -> Iterator[str]:
    """Modules that a file imports, but for the type checker's and those of `if __name__ == "__main__"`."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "__name__ == '__main__'"):
            continue
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports name the whole path"
            yield from (f"{node.module}.{name.name}" for name in node.names)
        else:
            yield from imported(node)


def imports_of(module: str) -> list[str]:
    return list(imported(ast.parse((PACKAGE / module).read_text(encoding="utf-8"))))


@pytest.mark.parametrize("module", [module for module in MODULES if module != "__init__.py"])
def test_imports_run_one_way(module):
    """No package imports one of the same or a higher rank."""
    package = package_of(module)
    for name in imports_of(module):
        if name.startswith("diga3d_warp."):
            other = name.split(".")[1]
            assert other == package or RANK[other] < RANK[package], f"{module} imports {name}"


def test_every_package_has_a_rank():
    assert {package_of(module) for module in MODULES} - {"__init__"} == set(RANK)


@pytest.mark.parametrize("module", [module for module in MODULES if package_of(module) == "kernels"])
def test_kernels_do_without_torch(module):
    assert "torch" not in {name.split(".")[0] for name in imports_of(module)}


def test_a_public_name_is_exported_once():
    """Packages re-export nothing: a name is imported from its module, or from `diga3d_warp` if public.

    Not so `cli`: its `main` is what the installed command calls, and no package imports it.
    """
    assert len(set(diga3d_warp.__all__)) == len(diga3d_warp.__all__)
    for module in MODULES:
        if module.endswith("/__init__.py") and package_of(module) != "cli":
            assert not imports_of(module), f"{module} re-exports names"


def test_nothing_points_outside_the_project():
    """The real captures lie beside the project here; no user has them there."""
    written = [*PACKAGE.rglob("*.py"), *(PROJECT / "benchmarks").rglob("*.py"), *PROJECT.glob("*.md")]
    written += [*(PROJECT / "docs").rglob("*.md"), PROJECT / "Makefile", PROJECT / "pyproject.toml"]
    outside = "../" + "shared"
    assert not [str(path) for path in written if outside in path.read_text(encoding="utf-8")]
