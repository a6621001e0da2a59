"""The curves of all trainings as a picture."""

from __future__ import annotations

from pathlib import Path

from diga3d_warp.errors import InputError
from training.card import NETWORKS, read_curve


def draw_curves(work: Path, picture: Path) -> None:
    """Plot the loss over the samples of each network that was trained.

    Args:
        work: Folder of data, checkpoints and curves.
        picture: A .png file to write.

    Raises:
        InputError: nothing was trained yet.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    curves = {said: read_curve(work / f"{name}.jsonl") for name, said in NETWORKS.items()}
    curves = {said: curve for said, curve in curves.items() if curve}
    if not curves:
        raise InputError(f"{work} holds no curve: train a network first")
    figure, axes = pyplot.subplots(1, len(curves), figsize=(4 * len(curves), 3), squeeze=False)
    for panel, (said, curve) in zip(axes[0], curves.items(), strict=True):
        panel.plot([line["samples"] / 1000 for line in curve], [line["loss"] for line in curve])
        panel.set(title=said, xlabel="samples [thousands]", ylabel="loss", yscale="log")
        panel.grid(alpha=0.3, which="both")
    figure.tight_layout()
    figure.savefig(picture, dpi=100)
    pyplot.close(figure)
