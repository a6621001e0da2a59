"""Rooms and prompts that the room prior is trained on."""

from dataclasses import replace

import numpy as np
import pytest
from training.captions import caption_of, prompt_of
from training.recipe import RECIPE
from training.rooms import PLAIN
from training.windows import open_windows, render_rooms

from diga3d_warp.scene.synthetic.situations.things import KINDS

SMALL = replace(RECIPE.data, side=32, windows=1, cameras=2, first_seed=10_003)
"""Of a seed whose situation, a corner, is quick to light."""


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rooms")
    render_rooms(folder, SMALL, 1)
    return folder


def test_a_window_shows_the_room_with_and_without_each_object(rendered):
    store = open_windows(rendered, SMALL)
    alone, *shown = range(len(store.rows))
    assert store.rows[alone]["thing"] is None and shown
    images = store.array("image").astype(int)
    masks = np.unpackbits(store.array("mask"), axis=-1).astype(bool)
    assert images[alone].std() > 5
    for index in shown:
        row = store.rows[index]
        mask = masks[index][row["thing"]]
        differs = np.abs(images[index] - images[alone]).mean(-1)
        assert 0.01 < mask.mean() < 0.9
        assert differs[mask].mean() > 3 * differs[~mask].mean()
        assert row["words"][2] in (*KINDS, *PLAIN)
    assert store.array("depth").max() == 255


def test_rendering_goes_on_where_it_stopped(rendered):
    before = len(open_windows(rendered, SMALL).rows)
    render_rooms(rendered, SMALL, 1)
    assert len(open_windows(rendered, SMALL).rows) == before


def test_held_out_rooms_and_those_of_benchmarks_are_never_trained_on():
    data = RECIPE.data
    assert data.held_out_seed + data.held_out_rooms <= data.first_seed
    assert 100 < data.held_out_seed < data.tested_seed < data.held_out_seed + data.held_out_rooms


def test_prompts_name_the_object_and_rooms_alone_often_go_without():
    row = {"thing": 0, "words": ["dark green", "gold", "ball"], "stands": "on", "place": "a red rug"}
    rng = np.random.default_rng(0)
    prompts = {prompt_of(rng, row, RECIPE.prompts) for _ in range(200)}
    assert caption_of(row) == "a dark green golden ball"
    assert {"a ball", "a dark green golden ball", "a dark green golden ball on a red rug"} <= prompts
    assert "" not in prompts
    place = {prompt_of(rng, {**row, "thing": None}, RECIPE.prompts) for _ in range(50)}
    assert place == {"", "a red rug"}
