"""Whether an object's shadow goes with it: the evidence of its support, or the user's word."""

from __future__ import annotations

from diga3d_warp.effects.plan import Choice
from diga3d_warp.shadows.find import ShadowEvidence
from diga3d_warp.shadows.settings import SHADOWS, ShadowSettings


def choose_shadow(
    evidence: ShadowEvidence | None, wish: bool | None, settings: ShadowSettings = SHADOWS
) -> Choice:
    """The choice of the effect `shadow` once the object is known.

    Args:
        evidence: What its support tells; None if none was found under it.
        wish: The user's, who may insist on a shadow that the evidence leaves in doubt; None for none.
        settings: When the evidence suffices.
    """
    if evidence is None:
        return Choice("shadow", False, "no surface tells of it under the object", "scene")
    said = (
        f"the object takes {100 * evidence.strength:.0f} % of the light of its support; that explains "
        f"{100 * evidence.explained:.0f} % of what is unlike there, elsewhere {100 * evidence.chance:.0f} % "
        f"as much; channels differ by a factor of {evidence.hues:.2f}, views by "
        f"{100 * evidence.spread:.0f} %"
    )
    if evidence.painted:
        said += "; a round stain would explain it better"
    if wish is not None:
        return Choice("shadow", wish, said, "user")
    return Choice("shadow", evidence.suffices(settings), said, "scene")
