"""How long, how large and how accurate a fit is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from diga3d_warp import cli
from diga3d_warp.config import Accuracy
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.pipelines import fit as fitting
from diga3d_warp.pipelines import request
from diga3d_warp.pipelines.fit import BUDGET_LEAST, BUDGET_MOST, ITERATIONS_MOST, fit_settings
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.scene import Points, Scene, View


@pytest.fixture
def scene() -> Scene:
    camera = Camera(16, 16, 20.0, 20.0, 8.0, 8.0, torch.eye(4))
    view = View("first", camera, np.zeros((16, 16, 3), np.uint8), None)
    points = Points(np.zeros((1, 3), np.float32), np.zeros((1, 3), np.uint8))
    return Scene(Path("room"), "colmap", (view,), (), points)


@pytest.mark.parametrize(
    ("views", "iterations"), [(20, FitSettings().iterations), (84, 4200), (500, ITERATIONS_MOST)]
)
def test_more_views_are_fitted_longer(scene, views, iterations):
    assert fit_settings(replace(scene, views=scene.views * views), None).iterations == iterations


def test_the_users_number_of_iterations_stands(scene):
    assert fit_settings(replace(scene, views=scene.views * 500), 7).iterations == 7


@pytest.mark.parametrize(("count", "budget"), [(1, BUDGET_LEAST), (25_000, 100_000), (90_000, BUDGET_MOST)])
def test_more_points_get_more_gaussians(scene, count, budget):
    points = Points(np.zeros((count, 3), np.float32), np.zeros((count, 3), np.uint8))
    assert fit_settings(replace(scene, points=points), None).budget == budget


def test_the_wanted_accuracy_is_fitted_and_recorded(scene, monkeypatch):
    class Fitted(Exception):
        """Carries what a fit was begun with."""

    recorded = {}

    def begin(folder, command, settings, *, resume):
        recorded.update(settings)
        return SimpleNamespace(hold_to=recorded.update)

    def fit_source(run, capture, settings, seed):
        raise Fitted(settings)

    monkeypatch.setattr(request, "load_scene", lambda *_, **__: scene)
    monkeypatch.setattr(request, "Run", begin)
    monkeypatch.setattr(fitting.stages, "begin", lambda run, capture, effects: capture)
    monkeypatch.setattr(fitting.stages, "fit_source", fit_source)
    with pytest.raises(Fitted) as fit:
        cli.main(["fit", "room", "--out", "run", "--accuracy", "draft"])
    assert fit.value.args[0].accuracy == Accuracy.DRAFT
    assert recorded["accuracy"] == "draft"
    assert recorded["settings"] == fit.value.args[0] and "capture" in recorded, "held to all of it"
