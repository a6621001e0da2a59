"""--effects: what it takes, and one line for what it does not."""

from dataclasses import fields

import pytest

from diga3d_warp import cli
from diga3d_warp.config import Effects
from diga3d_warp.effects.overrides import SWITCHES, format_overrides, parse_overrides
from diga3d_warp.errors import InputError


def test_parts_are_read_in_any_order_and_written_in_one():
    chosen = parse_overrides("lens=off, sh_degree=1,exposure = on")
    assert chosen == {"lens": False, "sh_degree": 1, "exposure": True}
    assert chosen["exposure"] is True and chosen["sh_degree"] == 1 and chosen["sh_degree"] is not True
    assert format_overrides(chosen) == "exposure=on,lens=off,sh_degree=1"
    assert parse_overrides(format_overrides(chosen)) == chosen
    assert parse_overrides("") == {}


def test_every_effect_that_is_no_stages_need_can_be_chosen():
    needed = {"depth", "median_depth", "normals", "deterministic"}
    assert {*SWITCHES, "sh_degree"} == {each.name for each in fields(Effects)} - needed


@pytest.mark.parametrize(
    "text", ["sh_degree=4", "sh_degree=on", "lens=1", "lens", "glow=on", "depth=on", "="]
)
def test_other_parts_are_refused_in_one_line(text):
    with pytest.raises(InputError, match=r"no effect: expected sh_degree=0\|1\|2\|3") as caught:
        parse_overrides(f"antialias=on,{text}")
    assert "\n" not in str(caught.value)


def test_the_command_line_refuses_them_too(capsys):
    with pytest.raises(SystemExit) as end:
        cli.main(["fit", "scene", "--out", "run", "--effects", "lens=maybe"])
    assert end.value.code == 2
    assert "'lens=maybe' is no effect" in capsys.readouterr().err
