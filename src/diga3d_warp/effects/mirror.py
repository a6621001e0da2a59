"""Whether an object's mirror image goes with it: the evidence of its support, or the user's word."""

from __future__ import annotations

from diga3d_warp.effects.plan import Choice
from diga3d_warp.mirrors.find import MirrorEvidence
from diga3d_warp.mirrors.settings import MIRRORS, MirrorSettings


def choose_mirror(
    evidence: MirrorEvidence | None, wish: bool | None, settings: MirrorSettings = MIRRORS
) -> Choice:
    """The choice of the effect `mirror` once the object is known.

    Args:
        evidence: What its support tells; None if none was found under it.
        wish: The user's, who may insist on a mirror image that the evidence leaves in doubt; None for none.
        settings: When the evidence suffices.
    """
    if evidence is None:
        return Choice("mirror", False, "no surface tells of it under the object", "scene")
    said = (
        f"the support reflects {100 * max(evidence.gloss, 0.0):.0f} % of the light; the mirrored object "
        f"explains {100 * evidence.explained:.0f} % of how photographs differ there, its colours alone "
        f"{100 * evidence.detail:.0f} % of the rest"
    )
    if evidence.beyond is not None:
        said += f", {evidence.beyond:.1f} times as much as those elsewhere under the support"
    if wish is not None:
        return Choice("mirror", wish, said, "user")
    return Choice("mirror", evidence.suffices(settings), said, "scene")
