"""What a prior is worth in rooms that were never trained on, one window at a time.

Removal: each window shows an object; its silhouette is grown and filled without a prompt. The truth is the
room without the object. Text: the silhouettes of both objects of a window are filled by the caption of one
object in one material; the truths of all objects and materials of that window are compared with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from diga3d_warp.evaluation.metrics import compare, psnr
from diga3d_warp.priors.classical import ClassicalPrior, mean_color_fill, telea_fill
from diga3d_warp.priors.conditioning import Guidance
from diga3d_warp.priors.exemplar.prior import ExemplarPrior
from diga3d_warp.priors.exemplar.settings import FILL
from diga3d_warp.priors.settings import SamplingSettings
from diga3d_warp.priors.stable_diffusion.load import load_stable_diffusion
from diga3d_warp.priors.views import inpaint_views
from training.autoencoder import contact_sheet
from training.captions import caption_of
from training.samples import grown
from training.sheet import GROWN
from training.store import Store

Fill = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
"""Image (H, W, 3) and mask (H, W) to a filled image."""

STEPS = 20
"""DDIM steps; more change masked PSNR by less than 0.1 dB."""

SCALE = 4.0
"""Guidance of prompts [1]."""


@dataclass(frozen=True)
class Case:
    """A held-out window.

    Attributes:
        image: With the object, shape (H, W, 3).
        truth: Without it.
        mask: Its grown silhouette, shape (H, W), bool.
    """

    image: torch.Tensor
    truth: torch.Tensor
    mask: torch.Tensor


def cases(windows: Store, count: int, seed: int = 0) -> list[Case]:
    """Windows drawn at random, at most one of each window."""
    rng = np.random.default_rng(seed)
    things = [i for i, row in enumerate(windows.rows) if row["thing"] is not None]
    found: dict[tuple[int, int], Case] = {}
    for index in rng.permutation(things):
        row = windows.rows[index]
        if (row["seed"], row["window"]) in found:
            continue
        alone = next(i for i in range(index, -1, -1) if windows.rows[i]["thing"] is None)
        mask = grown(_silhouette(windows, int(index), row["thing"]), GROWN)
        found[row["seed"], row["window"]] = Case(_image(windows, index), _image(windows, alone), mask)
        if len(found) == count:
            break
    return list(found.values())


def fills(prior: Any) -> dict[str, Fill]:
    """Every fill by name."""
    one = ExemplarPrior(settings=replace(FILL, seeds=1))
    unprompted = Guidance(prior.encode_prompts("", "", "remove"), 1.0)

    def room(image: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        return next(inpaint_views(prior, [image], [mask], unprompted, SamplingSettings(steps=STEPS)))

    return {
        "mean colour": mean_color_fill,
        "Telea": telea_fill,
        "classical (shift map)": ClassicalPrior().fill,
        "exemplar, one proposal": one.fill,
        "room": room,
    }


def removal(prior: Any, windows: Store, count: int, pictures: Path | None) -> str:
    """A table of masked PSNR and SSIM, and a picture of the first 16 windows."""
    chosen, methods = cases(windows, count), fills(prior)
    scores: dict[str, list[tuple[float, float]]] = {name: [] for name in methods}
    shown: list[torch.Tensor] = []
    for number, case in enumerate(tqdm(chosen, "removal", unit="window")):
        results = {name: fill(case.image, case.mask) for name, fill in methods.items()}
        for name, result in results.items():
            masked = compare(result, case.truth, case.mask)["masked"]
            scores[name].append((masked.psnr, masked.ssim))
        if number < 16:
            given = torch.where(case.mask[..., None], 0.5, case.image)
            shown += [given, results["Telea"], results["exemplar, one proposal"], results["room"], case.truth]
    if pictures is not None:
        _write(pictures / "removal.jpg", shown, 10)
    share = float(np.mean([float(case.mask.float().mean()) for case in chosen]))
    lines = [
        f"{len(chosen)} windows of {len({row['seed'] for row in windows.rows})} rooms that were never "
        f"trained on, {windows.array('image').shape[1]} px; the mask covers {share:.0%} on average.",
        "",
        "| fill | masked PSNR [dB] | masked SSIM | better than Telea in PSNR |",
        "|---|---|---|---|",
    ]
    telea = np.array(scores["Telea"])[:, 0]
    for name, values in scores.items():
        mean = np.array(values)
        wins = f"{float((mean[:, 0] > telea).mean()):.0%}" if name != "Telea" else ""
        lines.append(f"| {name} | {mean[:, 0].mean():.2f} | {mean[:, 1].mean():.3f} | {wins} |")
    return "\n".join(lines)


def text(prior: Any, windows: Store, count: int, pictures: Path | None, seed: int = 0) -> str:
    """A table of prompts: whether the fill is nearer to the truth of its prompt than to any other."""
    rng = np.random.default_rng(seed)
    groups: dict[tuple[int, int], list[int]] = {}
    for index, row in enumerate(windows.rows):
        groups.setdefault((row["seed"], row["window"]), []).append(index)
    whole = [g for g in groups.values() if len({windows.rows[i]["thing"] for i in g}) == 3]
    rooms = list({windows.rows[g[0]]["seed"]: g for g in rng.permutation(np.array(whole, object))}.values())
    lines = ["| prompt | nearest truth | PSNR to its own, to the next [dB] |", "|---|---|---|"]
    right, shown = 0, []
    for group in tqdm(rooms[:count], "text", unit="prompt"):
        things = [i for i in group if windows.rows[i]["thing"] is not None]
        asked = int(rng.choice(things))
        mask = grown(_silhouette(windows, asked, 0) | _silhouette(windows, asked, 1), GROWN)
        prompt = caption_of(windows.rows[asked])
        guidance = Guidance(prior.encode_prompts(prompt, "", "replace"), SCALE)
        image = _image(windows, asked)
        filled = next(inpaint_views(prior, [image], [mask], guidance, SamplingSettings(steps=STEPS)))
        near = {i: psnr(filled, _image(windows, i), mask) for i in group}
        best = max(near, key=lambda i: near[i])
        other = max(value for i, value in near.items() if i != asked)
        said = "the room alone" if windows.rows[best]["thing"] is None else caption_of(windows.rows[best])
        right += best == asked
        said = "its own" if best == asked else said
        lines.append(f"| {prompt} | {said} | {near[asked]:.2f}, {other:.2f} |")
        shown += [torch.where(mask[..., None], 0.5, image), filled, image]
    if pictures is not None:
        _write(pictures / "text.jpg", shown, 6)
    verdict = f"{right} of {len(lines) - 2} fills are nearest to the truth of their prompt."
    return "\n".join([verdict, "", *lines])


def load(folder: Path) -> Any:
    """The prior of a folder that `export` wrote."""
    return load_stable_diffusion(folder)


def _image(windows: Store, index: int) -> torch.Tensor:
    return torch.from_numpy(windows.array("image")[index].copy()).float() / 255


def _silhouette(windows: Store, index: int, thing: int) -> torch.Tensor:
    return torch.from_numpy(np.unpackbits(windows.array("mask")[index][thing], axis=-1).astype(bool))


def _write(path: Path, shown: list[torch.Tensor], columns: int) -> None:
    import cv2

    path.parent.mkdir(parents=True, exist_ok=True)
    whole = shown[: len(shown) // columns * columns]
    sheet = contact_sheet(2 * torch.stack(whole).permute(0, 3, 1, 2) - 1, columns)
    cv2.imwrite(str(path), np.ascontiguousarray(sheet[..., ::-1]))
