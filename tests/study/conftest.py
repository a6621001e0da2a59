"""Runs to vote on: tiny folders as an edit leaves them, with pictures of one colour that tells the method."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from diga3d_warp.files import write_image, write_json

VIEWS = ("view_000", "view_001", "view_002")


@pytest.fixture
def make_run(tmp_path) -> Callable[..., Path]:
    """`make_run("ours/bear", 200, prompt=...)`: a finished run whose result is that shade of grey."""

    def make(
        name: str,
        shade: int,
        command: str = "retexture",
        prompt: str | None = "white marble",
        scene: str = "bear",
        size: tuple[int, int] = (40, 30),
        views: tuple[str, ...] = VIEWS,
    ) -> Path:
        folder, (width, height) = tmp_path / name, size
        for place, view in enumerate(views):
            source = np.full((height, width, 3), 10 * place + 20, np.uint8)
            result = np.full((height, width, 3), shade - 10 * place, np.uint8)
            write_image(folder / "views" / "before" / f"{view}.png", source)
            write_image(folder / "views" / "after" / f"{view}.png", result)
        mask = np.zeros((height, width), bool)
        mask[10:20, 10:20] = True
        write_image(folder / "masks" / f"{VIEWS[0]}.png", mask)
        write_json(
            folder / "manifest.json",
            {
                "command": command,
                "command_line": f"diga3d {command} {scene} --out {folder}",
                "settings": {"scene": str(tmp_path / scene), "prompt": prompt},
                "versions": {}, "machine": {}, "seconds": 1.0, "stages": [], "notes": [],
                "held_to": {"capture": {"photographs": scene}},
            },
        )  # fmt: skip
        return folder

    return make


@pytest.fixture
def voted(tmp_path) -> Callable[..., Path]:
    """`voted(page, "name.json", participant, [method, ...])`: votes for these methods, one a question."""
    from diga3d_warp.study.seal import checksum, unseal

    def vote(
        page: Path, name: str, participant: str, methods: list[int | None], saved: str = "2026-01-01"
    ) -> Path:
        text = page.read_text(encoding="utf-8").split('id="study">')[1].split("</script>")[0]
        study = json.loads(text)
        sealed = unseal(study["sealed"])
        assert sealed is not None
        answers = []
        for question, method in zip(sealed["questions"], methods, strict=True):
            codes = question["candidates"]
            chosen = [code for code, place in codes.items() if place == method]
            answers += [
                {"question": question["code"], "choice": code, "order": list(codes)} for code in chosen
            ]
        votes = {
            "form": "diga3d-votes-1", "study": study["study"], "participant": participant, "saved": saved,
            "answers": answers, "sealed": study["sealed"],
        }  # fmt: skip
        path = tmp_path / "votes" / name
        write_json(path, {**votes, "checksum": checksum(votes)})
        return path

    return vote
