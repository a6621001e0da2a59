"""Thresholds of the exemplar prior. Colours are in [-1, 1] here, as all latents are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PatchSettings:
    """Distance between patches, and the search for the nearest ones.

    Square differences are means over the colours of a patch; costs are in the same unit, as the mean square
    difference of colours that they equal. In an image shrunk s times, the costs of displacement and of
    controls are sqrt(s) times as much: coarse scales decide what lies where, and fine ones choose among
    patches near by.

    Attributes:
        radius: Of a patch [px]; 7 x 7 is the custom since Wexler et al. 2007.
        kept: Candidates that a query keeps where attention is sparse. More only matter at noise levels at
            which a coarser scale decides.
        noise_min: Standard deviation that clean patches are given [1]: five levels of 255, about that of a
            camera's noise and of interpolation.
        known_noise: Most that a known pixel inside a query may differ [1]. Known pixels are clean, but no
            patch has exactly theirs.
        across, down: Cost of a patch one image diagonal away, across and down the image, with the square of
            the displacement [1]. What is at one height in a photograph mostly lies at one depth.
        depth: Cost of a depth greater or less by a factor of e, with the square of its logarithm [1].
        edges: Cost of an edge where there is none [1]; edges are thin, so that a line through a patch costs
            about a seventh.
        apart: Cost of a patch from which none of the neighbours' patches is copied on [1]. At zero textures
            drown in the mean of patches that do not fit each other; at ten times this, pieces are copied
            whole whose seams show.
        window: Standard deviation of a patch's vote around its centre [px].
        draws: Random candidates in each step of a search. With their radii halved, 6 reach from a quarter of
            a 500 px image to its pixel.
        spread: Radius of the first random candidate [image widths].
    """

    radius: int = 3
    kept: int = 4
    noise_min: float = 0.02
    known_noise: float = 0.1
    across: float = 0.25
    down: float = 2.5
    depth: float = 0.5
    edges: float = 1.0
    apart: float = 0.03
    window: float = 2.0
    draws: int = 6
    spread: float = 0.1

    @property
    def side(self) -> int:
        """Side of a patch [px]."""
        return 2 * self.radius + 1


PATCHES = PatchSettings()


@dataclass(frozen=True)
class FillSettings:
    """How a hole is filled from coarse to fine.

    Attributes:
        coarsest: Least side of the coarsest scale [px]: three patches, so that it shows what lies where.
        everything: Most pairs of query and key for which attention is full [1]; beyond, it is sparse. A
            million pairs take about 10 ms on two cores.
        keys_min: Least number of patches that a scale is filled from [1].
        noise_first: Noise that the coarsest scale starts from [1]: three times the range's half is as good
            as no image.
        noise_next: Noise that each finer scale starts from [1]: what its own detail is worth, while the
            coarser scale's shapes still show.
        noise_last: Noise that each scale ends with [1].
        steps_first, steps_next: DDIM steps at the coarsest and at each finer scale.
        seeds: Fills from noise that are compared at a low resolution [1].
        compared: How many times smaller the image is at which they are compared [1].
        smooth: How much a patch's difference from the smooth continuation of the known colours counts, at
            those scales, beside that from the noisy image [1]. Without it, what touches the hole anywhere
            may spread through all of it. More, or at finer scales too, favours blurred patches.
        repeat: By how much the distance to a patch grows for each time that it is taken too often [1].
        repeat_free: How often a patch may be taken, as a mean over its neighbourhood, before it counts as too
            often [1].
    """

    coarsest: int = 21
    everything: int = 1_000_000
    keys_min: int = 20
    noise_first: float = 3.0
    noise_next: float = 0.4
    noise_last: float = 0.02
    steps_first: int = 12
    steps_next: int = 6
    seeds: int = 3
    compared: float = 4.0
    smooth: float = 1.0
    repeat: float = 0.5
    repeat_free: float = 1.5

    def levels(self, first: bool = False) -> list[float]:
        """Falling noise levels of a scale, in geometric steps."""
        begin, count = (self.noise_first, self.steps_first) if first else (self.noise_next, self.steps_next)
        return np.geomspace(begin, self.noise_last, count).tolist()


FILL = FillSettings()
