"""Settings of the sampling of views."""

from __future__ import annotations

from dataclasses import dataclass

from diga3d_warp.priors.attention import AFP_WEIGHT


@dataclass(frozen=True)
class SamplingSettings:
    """Steps, strength, batch size and propagation weight of the sampling.

    Attributes:
        steps: DDIM steps from pure noise [1]. 20 to 50 are usual for inversion and sampling.
        strength: Part of the schedule, counted from the clean end, that is sampled [1].
        batch: Views that are estimated together. More need more memory and are faster on a GPU only.
        afp_weight: lambda_a of Eq. 4; 0 leaves propagation out.
        afp_joined: Whether one softmax runs over all references, as in `AttentionBank`.
        resampled: Whether references that are inpainted already are sampled once more from their start, so
            that what they provide at each timestep lies on one trajectory. Otherwise it is their clean
            latents with the noise of their start, which needs no trajectory to return to them.
    """

    steps: int = 30
    strength: float = 1.0
    batch: int = 4
    afp_weight: float = AFP_WEIGHT
    afp_joined: bool = False
    resampled: bool = False
