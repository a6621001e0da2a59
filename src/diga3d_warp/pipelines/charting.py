"""The stage that finds and fills charts of the surfaces behind the object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TypedDict

import numpy as np

from diga3d_warp.files import write_arrays, write_image, write_json
from diga3d_warp.pipelines.method import Method
from diga3d_warp.pipelines.own_fills import NO_FILLS, Fills, by_index
from diga3d_warp.pipelines.run import Run, say
from diga3d_warp.priors.protocol import Prior
from diga3d_warp.propagation.charted import photo_of
from diga3d_warp.propagation.own import colored_by
from diga3d_warp.propagation.unseen import Background
from diga3d_warp.scene.scene import Points, View
from diga3d_warp.state import read_arrays, read_state
from diga3d_warp.surfaces.bend import Bend
from diga3d_warp.surfaces.chart import Chart, Frame
from diga3d_warp.surfaces.fill import fill_chart
from diga3d_warp.surfaces.find import find_charts
from diga3d_warp.surfaces.picture import charts_picture

PICTURE = "charts.png"
"""Every chart before and after it was filled, in the run folder."""


PLANES = ("image", "known", "through", "wanted", "alpha")
"""Arrays of a chart over its texels."""


class ChartsRecord(TypedDict):
    """What was found.

    Attributes:
        count: Number of charts.
    """

    count: int


def chart_surfaces(
    run: Run,
    views: Sequence[View],
    backgrounds: Sequence[Background],
    depths: Sequence[np.ndarray],
    points: Points,
    prior: Prior,
    method: Method,
    seed: int,
    own: Fills = NO_FILLS,
) -> list[Chart]:
    """Charts behind the object, filled; none if the method does without or no surface goes on there.

    Args:
        run: Run folder that receives the stage, and a picture.
        views: Training views.
        backgrounds: What is known behind the object, one per view.
        depths: z of the splat without the object, one per view, shape (H, W); 0 where it shows nothing.
        points: Sparse points.
        prior: Fills what does not repeat.
        method: Whether to use surfaces.
        seed: Of the search and of the prior.
        own: Views that the user filled, whose colours charts take on.
    """
    if not method.surfaces:
        return []

    def compute(folder: Path) -> None:
        photos = [photo_of(*each) for each in zip(views, backgrounds, depths, strict=True)]
        found = find_charts(photos, points.positions, seed)
        filled = []
        for number, chart in enumerate(colored_by(found, views, backgrounds, by_index(own, views)), 1):
            say(f"charts: filling {number} of {len(found)}, {int(chart.wanted.sum())} texels")
            filled.append(fill_chart(chart, prior, seed))
        # What the user's views show is no more than a fill: the hole's part of a chart starts with gaussians.
        filled = [
            replace(each, known=chart.known, wanted=chart.wanted)
            for each, chart in zip(filled, found, strict=True)
        ]
        for number, chart in enumerate(filled):
            _keep(folder / f"{number}.npz", chart)
        if filled:
            write_image(folder / PICTURE, charts_picture(found, filled))
        write_json(folder / "charts.json", {"count": len(filled)})

    folder = run.stage("charts", compute)
    count = read_state(folder / "charts.json", ChartsRecord)["count"]
    if count:
        run.publish(folder / PICTURE, PICTURE)
    elif any(at.unseen.any() for at in backgrounds):
        run.note("no surface goes on behind the object: all of it is filled image by image")
    return [_read(folder / f"{number}.npz") for number in range(count)]


def _keep(path: Path, chart: Chart) -> None:
    planes = {name: getattr(chart, name) for name in PLANES}
    write_arrays(
        path, trusted=np.array(chart.trusted), deep=np.array(chart.deep),
        **frame_arrays(chart.frame), **planes,
    )  # fmt: skip


def _read(path: Path) -> Chart:
    arrays = read_arrays(path)
    planes = {name: arrays[name] for name in PLANES}
    return Chart(frame_of(arrays), **planes, trusted=bool(arrays["trusted"]), deep=bool(arrays["deep"]))


def frame_arrays(frame: Frame) -> dict[str, np.ndarray]:
    """A frame as arrays of a stage's file."""
    arrays = {
        "origin": frame.origin, "axes": frame.axes, "low": np.asarray(frame.low),
        "texel": np.array(frame.texel), "size": np.array(frame.size), "agreed": np.array(frame.agreed),
    }  # fmt: skip
    if frame.bend is not None:
        named = {field.name: getattr(frame.bend, field.name) for field in fields(Bend)}
        arrays |= {f"bend_{name}": np.asarray(value) for name, value in named.items()}
    return arrays


def frame_of(arrays: Mapping[str, np.ndarray]) -> Frame:
    """The frame back from arrays."""
    rows, columns = arrays["size"].tolist()
    bend = None
    if "bend_reach" in arrays:
        bend = Bend(
            arrays["bend_origin"], arrays["bend_axes"], float(arrays["bend_reach"]),
            arrays["bend_coefficients"],
        )  # fmt: skip
    return Frame(
        arrays["origin"], arrays["axes"], arrays["low"], float(arrays["texel"]), (rows, columns), bend,
        bool(arrays["agreed"]),
    )  # fmt: skip
