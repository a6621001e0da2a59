"""Whether a shadow goes with its object: by the evidence, unless the user says so."""

from dataclasses import replace

import pytest
from floor import Floor

from diga3d_warp.effects.overrides import parse_overrides
from diga3d_warp.effects.plan import EffectsPlan, plan_effects
from diga3d_warp.effects.shadow import choose_shadow
from diga3d_warp.shadows.find import ShadowEvidence

CLEAR = ShadowEvidence(strength=0.6, explained=0.8, chance=0.4, hues=1.1, spread=0.05)


def test_the_evidence_decides():
    assert choose_shadow(CLEAR, None).value is True
    faint = choose_shadow(replace(CLEAR, strength=0.05), None)
    assert faint.value is False and faint.by == "scene"
    assert "takes 5 % of the light" in faint.evidence


@pytest.mark.parametrize("wish", [True, False])
def test_the_user_has_the_last_word(wish):
    choice = choose_shadow(CLEAR, wish)
    assert (choice.value, choice.by) == (wish, "user")


def test_without_a_support_there_is_no_shadow_whatever_the_wish():
    assert choose_shadow(None, True).value is False


def test_it_is_looked_for_only_where_an_object_is_taken_out():
    scene = Floor().scene()
    assert not plan_effects(scene).effects.shadow
    plan = plan_effects(scene, takes_out=True)
    assert plan.effects.shadow
    found = plan.replaced(choose_shadow(replace(CLEAR, painted=True), None))
    assert not found.effects.shadow
    assert [choice.effect for choice in found.choices] == [choice.effect for choice in plan.choices]
    assert EffectsPlan.from_json(found.as_json()) == found
    denied = plan_effects(scene, takes_out=True, overrides={"shadow": False})
    assert not denied.effects.shadow
    assert ["shadow", "off", "user", "not looked for"] in [choice.cells()[:4] for choice in denied.choices]


def test_auto_is_what_is_not_named():
    assert parse_overrides("shadow=on,lens=off,shadow=auto") == {"lens": False}
    assert parse_overrides("sh_degree=auto") == {}
