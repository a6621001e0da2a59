"""Pose files: what in a folder holds camera poses, whether it is read here or not.

Poses that a user brings are never dropped without a word: what is not read is named.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from diga3d_warp.scene.colmap_files import is_model
from diga3d_warp.scene.folders import walk
from diga3d_warp.scene.names import IMAGE_SUFFIXES

# Levels below a scene folder at which poses are looked for: colmap/sparse/0, dense/0/sparse.
DEPTH = 3
# Start of a file that tells what it is [bytes].
_START = 1 << 14


@dataclass(frozen=True)
class PoseFile:
    """A file or folder with poses.

    Attributes:
        path: The file; of a COLMAP reconstruction, its folder.
        what: Whose it is: "COLMAP", "Metashape" and so on.
        readable: Whether poses of this kind are read here.
    """

    path: Path
    what: str
    readable: bool = True


def _start(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(_START)
    except OSError:
        return b""


def _numbers(*counts: int) -> Callable[[bytes], bool]:
    """Whether a text begins with a line of so many numbers."""

    def check(start: bytes) -> bool:
        lines = [line for line in start.splitlines() if line.strip() and not line.startswith(b"#")]
        try:
            numbers = [float(word) for word in lines[0].replace(b",", b" ").split()] if lines else []
        except ValueError:
            return False
        return len(numbers) in counts

    return check


def _csv(start: bytes) -> bool:
    head = start.split(b"\n", 1)[0].lower()
    return b"name" in head and any(word in head for word in (b"heading", b"yaw", b"omega", b"quat", b"qw"))


_Sniffer = tuple[str, str, Callable[[bytes], bool]]
# Of poses that are not read: pattern of the name in lower case, whose they are, and what its start must be.
_UNREAD: tuple[_Sniffer, ...] = (
    (r".*\.xml", "Metashape", lambda start: b"<document" in start and b"<chunk" in start),
    (r".*\.out", "Bundler", lambda start: start.startswith(b"# Bundle file")),
    (r".*\.nvm", "VisualSFM", lambda start: start.startswith(b"NVM_V3")),
    (r".*\.csv", "RealityScan", _csv),
    (r".*\.xmp", "RealityScan", lambda start: b"xcr:Rotation" in start),
    (r"sfm_data(_.*)?\.json|.*\.sfm", "OpenMVG or Meshroom", lambda start: b'"views"' in start),
    (r"reconstruction\.json", "OpenSfM", lambda start: b"shots" in start or b"cameras" in start),
    (r"metadata(\.json)?", "Record3D", lambda start: b'"poses"' in start),
    (r"(traj|trajectory|poses?|groundtruth|camera_path).*\.txt", "trajectory", _numbers(7, 8, 12, 16)),
)  # fmt: skip
_READ = {
    "cameras.json": ("3DGS", lambda start: b'"position"' in start and b'"rotation"' in start),
    "poses_bounds.npy": ("LLFF", lambda start: True),
}


def pose_files(root: Path) -> Iterator[PoseFile]:
    """Everything below a folder that looks like poses, in sorted order, outermost folders first."""
    found = [each for folder, files in walk(root, DEPTH) for each in _in_folder(folder, files)]
    yield from sorted(found, key=lambda each: (len(each.path.parts), each.path))


def _in_folder(folder: Path, files: list[Path]) -> Iterator[PoseFile]:
    if is_model(folder):
        yield PoseFile(folder, "COLMAP")
    matrices = 0
    for path in files:
        name = path.name.lower()
        if path.suffix.lower() in IMAGE_SUFFIXES:
            continue
        if re.fullmatch(r"transforms.*\.json", name) and b'"frames"' in _start(path):
            yield PoseFile(path, "nerfstudio")
        elif name in _READ and _READ[name][1](_start(path)):
            yield PoseFile(path, _READ[name][0])
        elif kind := next(
            (k for pattern, k, sure in _UNREAD if re.fullmatch(pattern, name) and sure(_start(path))), None
        ):
            yield PoseFile(path, kind, readable=False)
        elif name.endswith(".txt") and re.fullmatch("poses?|camera_?poses?|cam(era)?s", folder.name.lower()):
            matrices += _numbers(4)(_start(path))
    if matrices > 1:
        yield PoseFile(folder, "matrices", readable=False)


def _unread(path: Path) -> str | None:
    """Whose poses a file holds that is not read, or None."""
    kinds = (
        kind
        for pattern, kind, sure in _UNREAD
        if re.fullmatch(pattern, path.name.lower()) and sure(_start(path))
    )
    return next(kinds, None)
