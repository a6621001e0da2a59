"""Records of fixed size on disk, appended while others read them.

One file for each array and a line of JSON for each record. A record counts once its line is complete, and the
line is written last: whoever is killed in between leaves a longer file of arrays, which is cut when writing
goes on.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from diga3d_warp.errors import InputError

Layout = Mapping[str, tuple[tuple[int, ...], str]]
"""Shape and numpy type of each array of a record, by name."""


class Store:
    """A folder of records.

    Args:
        folder: Made if it does not exist.
        layout: Arrays of a record.
        version: Of the recipe.

    Raises:
        InputError: the folder holds records of another layout or version.
    """

    def __init__(self, folder: Path, layout: Layout, version: int | str) -> None:
        self.folder, self.layout = folder, layout
        folder.mkdir(parents=True, exist_ok=True)
        described = {"version": version, "layout": {k: [list(s), t] for k, (s, t) in layout.items()}}
        about = folder / "about.json"
        if about.exists():
            present = json.loads(about.read_text())
            if present != described:
                raise InputError(
                    f"{folder} was made by version {present['version']} of the recipe, not {version}: "
                    "delete it, or give another --work folder"
                )
        else:
            _write_whole(about, json.dumps(described))
        self.rows: list[dict[str, Any]] = []
        self._read = 0
        self._maps: dict[str, np.ndarray] = {}
        self.refresh()

    def refresh(self) -> int:
        """See what was appended since; the number of records."""
        lines = self.folder / "rows.jsonl"
        if lines.exists():
            with lines.open("rb") as file:
                file.seek(self._read)
                fresh = file.read()
            whole = fresh[: fresh.rfind(b"\n") + 1]
            self._read += len(whole)
            self.rows += [json.loads(line) for line in whole.splitlines()]
            self._maps = {}
        return len(self.rows)

    def array(self, name: str) -> np.ndarray:
        """One array of all records, shape (N, *shape), mapped from disk."""
        if name not in self._maps:
            shape, kind = self.layout[name]
            if not self.rows:
                return np.zeros((0, *shape), kind)
            self._maps[name] = np.memmap(self._file(name), kind, "r", shape=(len(self.rows), *shape))
        return self._maps[name]

    def append(self, rows: Sequence[Mapping[str, Any]], arrays: Mapping[str, np.ndarray]) -> None:
        """Add records, all or none.

        Args:
            rows: What JSON keeps of each.
            arrays: Stacked arrays of them, by name.
        """
        self.refresh()
        for name, (shape, kind) in self.layout.items():
            part = np.ascontiguousarray(arrays[name], kind)
            assert part.shape == (len(rows), *shape), (name, part.shape)
            with self._file(name).open("ab") as file:
                file.truncate(len(self.rows) * int(np.prod(shape)) * np.dtype(kind).itemsize)
                file.write(part.tobytes())
                file.flush()
                os.fsync(file.fileno())
        with (self.folder / "rows.jsonl").open("ab") as file:
            file.truncate(self._read)
            file.write("".join(json.dumps(row) + "\n" for row in rows).encode())
            file.flush()
            os.fsync(file.fileno())
        self.refresh()

    def _file(self, name: str) -> Path:
        return self.folder / f"{name}.raw"


def _write_whole(path: Path, text: str) -> None:
    part = path.with_suffix(".part")
    part.write_text(text)
    part.replace(path)
