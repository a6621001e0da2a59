"""Inputs from the field, each made from scratch: the right result, a note, or one line; never a traceback.

The kinds are those on which people's tools fail in public issue threads (nerfstudio, graphdeco, gsplat,
brush, OpenSplat, LichtFeld Studio, SuperSplat, COLMAP, instant-ngp).
"""

from __future__ import annotations

import cases_cameras  # noqa: F401
import cases_data_sets  # noqa: F401
import cases_edits  # noqa: F401
import cases_experiments  # noqa: F401
import cases_files  # noqa: F401
import cases_fills  # noqa: F401
import cases_formats  # noqa: F401
import cases_frame  # noqa: F401
import cases_masks  # noqa: F401
import cases_scaffold  # noqa: F401
import pytest
from expectations import Case, parameters
from field_room import FieldRoom, make_room


@pytest.fixture(scope="session")
def field_room(tmp_path_factory) -> FieldRoom:
    """The room of all cases; not to be changed."""
    return make_room(tmp_path_factory.mktemp("field"))


@pytest.mark.parametrize("each", parameters())
def test_input(each: Case, field_room: FieldRoom, tmp_path, capfd):
    folder = tmp_path / "capture"
    folder.mkdir()
    each.expected.check(each.build(field_room, folder), field_room, tmp_path, capfd)
