"""YAML files of users: read strictly, so that nothing in them is lost or taken for something else."""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml

from diga3d_warp.errors import InputError, cannot_read
from diga3d_warp.state import misfit

Form = TypeVar("Form")

WHOLE = re.compile(r"[-+]?(0|[1-9][0-9]*)")


class _Loader(yaml.SafeLoader):
    """Refuses keys that stand twice, of which YAML would keep the last, and numbers such as 010, which it
    would read as 8."""


def _mapping(loader: _Loader, node: yaml.MappingNode) -> dict[Any, Any]:
    seen = set()
    for key, _ in node.value:
        if not isinstance(key, yaml.ScalarNode):
            raise yaml.constructor.ConstructorError(None, None, "a key is no word", key.start_mark)
        if key.value in seen:
            raise yaml.constructor.ConstructorError(None, None, f"{key.value} stands twice", key.start_mark)
        seen.add(key.value)
    return {str(key): value for key, value in loader.construct_mapping(node, deep=True).items()}


def _whole(loader: _Loader, node: yaml.ScalarNode) -> int:
    if WHOLE.fullmatch(node.value) is None:
        raise yaml.constructor.ConstructorError(
            None, None, f"{node.value} is a number in another base: put it in quotes", node.start_mark
        )
    return int(node.value)


_Loader.add_constructor("tag:yaml.org,2002:map", _mapping)
_Loader.add_constructor("tag:yaml.org,2002:int", _whole)


def read_yaml(path: Path, form: type[Form]) -> Form:
    """The contents of a YAML or JSON file.

    Args:
        path: The file.
        form: A TypedDict; other keys than its own are refused.

    Raises:
        InputError: the file is absent, no YAML, empty, or of another form.
    """
    try:
        data = yaml.load(path.read_bytes(), _Loader)
    except OSError as error:
        raise cannot_read(path, error) from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f", line {mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "it cannot be parsed"
        if r"'\t'" in problem:
            problem = "a tab indents it, where YAML takes spaces only"
        raise InputError(f"{path}{place}: {problem}: correct the file") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not YAML ({error}): correct the file") from error
    if data is None:
        raise InputError(f"{path} is empty: see docs/scale.md for what it may hold")
    if isinstance(data, Mapping):
        refuse_unknown(path, data, form.__annotations__)
    wrong = misfit(data, form)
    if wrong is not None:
        raise InputError(f"{path}: {wrong}: see docs/scale.md for what it may hold")
    return data


def refuse_unknown(path: Path, data: Mapping[str, Any], known: Collection[str], place: str = "") -> None:
    """Refuse keys that nothing would read.

    Raises:
        InputError: there is one; the message names the nearest that is known.
    """
    unknown = next((key for key in data if key not in known), None)
    if unknown is None:
        return
    near = difflib.get_close_matches(unknown, known, 1)
    meant = f"did you mean {near[0]}?" if near else f"known are {', '.join(sorted(known))}"
    raise InputError(f"{path}: {place}{unknown} is unknown: {meant}")
