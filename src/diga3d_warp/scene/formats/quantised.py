"""Parameters from the bytes of compact formats."""

from __future__ import annotations

import numpy as np

from diga3d_warp.scene.formats.rows import DC_TO_COLOR

END_STEPS = 0.25
"""How far an opacity of 0 or 255 is taken from the end of the range [steps]: its logit would be infinite."""


OTHERS = np.array([[k for k in range(4) if k != place] for place in range(4)])
"""Places of the three components of a quaternion that are stored, by the place of the largest."""


def logits(opacities: np.ndarray) -> np.ndarray:
    """Logits of opacities stored as 0 to 255, float32."""
    share = opacities.astype(np.float64).clip(END_STEPS, 255 - END_STEPS) / 255
    return np.log(share / (1 - share)).astype(np.float32)


def bytes_of_logits(values: np.ndarray) -> np.ndarray:
    """Opacities as 0 to 255, shape (N,), uint8."""
    with np.errstate(over="ignore"):
        return np.rint(255 / (1 + np.exp(-values.astype(np.float64)))).astype(np.uint8)


def constant_harmonics(colors: np.ndarray) -> np.ndarray:
    """Constant harmonics of colours, where 0 is black and 1 white, float32."""
    return ((colors - 0.5) / DC_TO_COLOR).astype(np.float32)


def log_scales(scales: np.ndarray) -> np.ndarray:
    """Logarithms of standard deviations, -infinity for zero, float32."""
    return np.log(scales.astype(np.float64)).astype(np.float32)
