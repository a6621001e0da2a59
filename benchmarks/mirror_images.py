"""Mirror images of generated captures, with gloss and without: what tells of them, and whether it suffices.

Usage: python benchmarks/mirror_images.py run/mirror_images [SITUATION:SEED:GLOSS ...]

Gloss 0 is a matte capture. Two minutes a capture on two cores; finished fits are reused.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

from diga3d_warp.process import tune_process

DEFAULT = (
    "tiles:1:0.3", "tiles:3:0.05", "tiles:5:0", "tiles:6:0.2", "table-edge:1:0.3", "table-edge:4:0",
    "shelf:1:0.3", "shelf:2:0", "curved:3:0.3", "curved:4:0", "corner:1:0.15", "corner:1:0", "rug:2:0.3",
    "rug:4:0.2", "rug:5:0", "paving:1:0.3", "paving:4:0.15", "paving:2:0", "bench:3:0.1", "bench:4:0",
    "lawn:1:0",
)  # fmt: skip
"""Captures of every situation."""


def evidence(capture: Path, work: Path) -> str:
    """What the plan says of the mirror image once the object is known."""
    from diga3d_warp.gaussians.fit import FitSettings
    from diga3d_warp.gaussians.lift import LiftSettings
    from diga3d_warp.pipelines import clearing, mask_propagation, mirroring, stages
    from diga3d_warp.pipelines.marking import OWN_MASKS
    from diga3d_warp.pipelines.run import Run
    from diga3d_warp.pipelines.standing import Masked
    from diga3d_warp.scene.load import load_scene

    run = Run(work, "remove", {"scene": capture}, resume=work.exists())
    scene = stages.begin(run, load_scene(capture), {}, takes_out=True)
    source = stages.fit_source(run, scene, replace(FitSettings(), iterations=400, budget=40_000), 0)
    scene = stages.correct_exposure(run, scene)
    lift, masking = LiftSettings(), clearing.MaskSettings()
    masks = mask_propagation.propagate_masks(run, scene, source, OWN_MASKS, lift)
    rows, edit_masks = clearing.lift_object(run, scene, masks, source, lift, masking)
    mirroring.find_image(Masked(run, scene, edit_masks, source, rows, lift, masking, 0), None)
    choice = next(each for each in run.recorded("effects")["choices"] if each["effect"] == "mirror")
    run.close()
    return f"{'found' if choice['value'] else 'none ':5s} {choice['evidence']}"


def main(folder: Path, specifications: list[str]) -> None:
    """Generate the captures, and print a line for each."""
    from diga3d_warp.scene.synthetic.generate import SyntheticScene, generate

    for specification in specifications or DEFAULT:
        situation, seed, gloss = specification.split(":")
        name = specification.replace(":", "-")
        capture = folder / "captures" / name
        if not capture.exists():
            chosen = float(gloss) or None
            generate(SyntheticScene(situation=situation, seed=int(seed), gloss=chosen), capture)
        print(f"{specification:18s} {evidence(capture, folder / 'runs' / name)}", flush=True)


if __name__ == "__main__":
    tune_process()
    main(Path(sys.argv[1]), sys.argv[2:])
