"""Whether a mirror image goes with its object: by the evidence, unless the user says so."""

from dataclasses import replace

import pytest
from floor import Floor

from diga3d_warp.effects.mirror import choose_mirror
from diga3d_warp.effects.overrides import parse_overrides
from diga3d_warp.effects.plan import plan_effects
from diga3d_warp.mirrors.find import MirrorEvidence

CLEAR = MirrorEvidence(gloss=0.3, detail=0.3, strength=0.05, explained=0.6, beyond=1.5, alike=1.0)


def test_the_evidence_decides():
    found = choose_mirror(CLEAR, None)
    assert found.value is True and "reflects 30 % of the light" in found.evidence
    faint = choose_mirror(replace(CLEAR, detail=0.0, beyond=None), None)
    assert faint.value is False and faint.by == "scene" and "elsewhere" not in faint.evidence


@pytest.mark.parametrize("wish", [True, False])
def test_the_user_has_the_last_word(wish):
    choice = choose_mirror(replace(CLEAR, gloss=-0.01), wish)
    assert (choice.value, choice.by) == (wish, "user")
    assert "reflects 0 %" in choice.evidence


def test_without_a_support_there_is_no_mirror_whatever_the_wish():
    assert choose_mirror(None, True).value is False


def test_it_is_looked_for_only_where_an_object_is_taken_out():
    scene = Floor().scene()
    assert not plan_effects(scene).effects.mirror
    assert plan_effects(scene, takes_out=True).effects.mirror
    off = plan_effects(scene, takes_out=True, overrides=parse_overrides("mirror=off"))
    assert not off.effects.mirror and off.effects.shadow
    assert parse_overrides("mirror=auto") == {}
