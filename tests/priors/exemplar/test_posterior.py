"""The denoiser against the formula of its posterior mean, written out patch by patch."""

import numpy as np
import pytest
import torch

from diga3d_warp.priors.exemplar.posterior import (
    attend_all,
    attend_candidates,
    no_candidates,
    upsampled_candidates,
    window,
)
from diga3d_warp.priors.exemplar.query import query_at
from diga3d_warp.priors.exemplar.settings import PatchSettings
from diga3d_warp.priors.exemplar.source import Source, depth_control

NOISE = 0.3
SIZE = (17, 19)
SETTINGS = PatchSettings(radius=2, kept=4, apart=0.0)


def case(device="cpu", settings=SETTINGS):
    """A random image with a hole and a depth, as the source of its own hole."""
    generator = torch.Generator().manual_seed(0)
    image = torch.rand(*SIZE, 3, generator=generator) * 2.0 - 1.0
    depth = 1.0 + torch.rand(*SIZE, generator=generator)
    usable = torch.ones(SIZE, dtype=torch.bool)
    usable[6:10, 5:11] = False
    usable[:2, :3] = False
    controls = depth_control(depth, settings=settings)[..., None]
    source = Source(image.to(device), usable.to(device), controls.to(device))
    noisy = image + NOISE * torch.randn(*SIZE, 3, generator=generator)
    query = query_at(source, SIZE, 1.0, settings)
    return source, query, query.pasted(noisy.to(device))


def posterior_by_hand(source: Source, image: torch.Tensor, settings: PatchSettings) -> np.ndarray:
    """Mean over all patches of each query and vote of all queries, in float64."""
    r, (h, w) = settings.radius, SIZE
    clean, noisy, controls = (a.double().cpu().numpy() for a in (source.image, image, source.controls))
    known = source.usable.cpu().numpy()
    share = window(settings).double().numpy().reshape(settings.side, settings.side)
    variance = {True: min(NOISE, settings.known_noise) ** 2, False: NOISE**2}
    unit = 0.5 / (NOISE**2 + settings.noise_min**2) * 3 * settings.side**2 / (h * h + w * w)
    centers = [
        (y, x)
        for y in range(r, h - r)
        for x in range(r, w - r)
        if known[y - r : y + r + 1, x - r : x + r + 1].all()
    ]
    total, votes = np.zeros((h, w, 3)), np.zeros((h, w, 1))
    for y in range(h):
        for x in range(w):
            cells = [
                (y + dy, x + dx, dy, dx)
                for dy in range(-r, r + 1)
                for dx in range(-r, r + 1)
                if 0 <= y + dy < h and 0 <= x + dx < w
            ]
            if all(known[a, b] for a, b, _, _ in cells):
                continue
            distances = []
            for ky, kx in centers:
                d = unit * (settings.across * (kx - x) ** 2 + settings.down * (ky - y) ** 2)
                for a, b, dy, dx in cells:
                    weight = 0.5 / (variance[bool(known[a, b])] + settings.noise_min**2)
                    d += weight * ((noisy[a, b] - clean[ky + dy, kx + dx]) ** 2).sum()
                    d += weight * ((controls[a, b] - controls[ky + dy, kx + dx]) ** 2).sum()
                distances.append(d)
            attention = np.exp(min(distances) - np.array(distances))
            attention /= attention.sum()
            for a, b, dy, dx in cells:
                mean = sum(
                    p * clean[ky + dy, kx + dx] for p, (ky, kx) in zip(attention, centers, strict=True)
                )
                total[a, b] += share[dy + r, dx + r] * mean
                votes[a, b] += share[dy + r, dx + r]
    return np.where(known[..., None], clean, total / np.maximum(votes, 1e-30))


def test_full_attention_is_the_posterior_mean(device):
    source, query, image = case(device)
    estimate = attend_all(query, source.at(SIZE, SETTINGS), image, NOISE)
    expected = posterior_by_hand(source, image, SETTINGS)
    np.testing.assert_allclose(estimate.image.cpu().numpy(), expected, atol=2e-4)
    assert np.abs(expected - source.image.cpu().numpy())[6:10, 5:11].mean() > 0.1


def test_attention_to_all_candidates_is_full_attention(device):
    """A source of four patches, and four candidates for each query."""
    source, query, image = case(device)
    block = torch.zeros_like(source.usable)
    block[11:17, 12:18] = True
    keys = Source(source.image, block, source.controls).at(SIZE, SETTINGS)
    assert keys.count == SETTINGS.kept
    full = attend_all(query, keys, image, NOISE)
    shuffled = full.candidates[:, [2, 0, 3, 1]].contiguous()
    sparse = attend_candidates(query, keys, image, NOISE, shuffled, seed=0)
    torch.testing.assert_close(sparse.image, full.image, atol=2e-4, rtol=0.0)
    torch.testing.assert_close(sparse.distances, full.distances, rtol=1e-3, atol=1e-2)
    assert torch.equal(sparse.candidates, full.candidates)


def test_the_search_comes_near_full_attention(device):
    """Even in noise, where no patch leads to the next, it finds one of the nearest."""
    source, query, image = case(device)
    keys = source.at(SIZE, SETTINGS)
    full = attend_all(query, keys, image, NOISE)
    sparse = attend_candidates(query, keys, image, NOISE, no_candidates(query), seed=0, steps=40, spread=10.0)
    assert (sparse.distances[:, 0] <= full.distances[:, 3] * 1.001).float().mean() > 0.9
    assert torch.equal(sparse.image[source.usable], source.image[source.usable])


@pytest.mark.parametrize("steps", [1, 3])
def test_candidates_are_handed_down_the_same_way(steps):
    """A coarse way of (dy, dx) cells becomes twice as many fine pixels, for each of the four children."""
    source, _, _ = case()
    fine = query_at(source, SIZE, 1.0, SETTINGS)
    coarse_size = (9, 10)
    coarse = query_at(source, coarse_size, 2.0, SETTINGS)
    candidates = no_candidates(coarse)
    pixels = coarse.pixels.long()
    y, x = pixels // coarse.width + steps, pixels % coarse.width - steps
    inside = (y < coarse_size[0]) & (x >= 0)
    candidates[inside, 0] = (y * coarse.width + x)[inside].int()
    handed = upsampled_candidates(candidates, coarse, fine, coarse_size, SIZE)[:, 0].long()
    pixels = fine.pixels.long()
    found = handed >= 0
    assert found.float().mean() > 0.2
    way_y = (handed // SIZE[1] - pixels // SIZE[1])[found].float()
    way_x = (handed % SIZE[1] - pixels % SIZE[1])[found].float()
    assert ((way_y - steps * SIZE[0] / 9).abs() <= 1.0).all()
    assert ((way_x + steps * SIZE[1] / 10).abs() <= 1.0).all()
    assert (upsampled_candidates(candidates, coarse, fine, coarse_size, SIZE)[:, 1:] == -1).all()
