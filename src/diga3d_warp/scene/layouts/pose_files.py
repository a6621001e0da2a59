"""Pose files: files and folders of a capture that hold camera poses, in readable formats or others.

Poses of the user are never ignored silently: files that are not read are named.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from diga3d_warp.scene.colmap.files import is_model
from diga3d_warp.scene.photographs.folders import walk
from diga3d_warp.scene.photographs.names import IMAGE_SUFFIXES

DEPTH = 3
"""Levels below a scene folder at which poses are looked for: colmap/sparse/0, dense/0/sparse."""

# Start of a file that tells what it is [bytes].
_START = 1 << 14


@dataclass(frozen=True)
class PoseFile:
    """A file or folder with poses.

    Attributes:
        path: The file; the folder of a COLMAP reconstruction, or of files for each image.
        what: Program that wrote it: "COLMAP", "Metashape" and so on.
        readable: Whether poses of this kind are read here.
    """

    path: Path
    what: str
    readable: bool = True


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


def _has(*words: bytes) -> Callable[[bytes], bool]:
    return lambda start: all(word in start for word in words)


def _begins(word: bytes) -> Callable[[bytes], bool]:
    return lambda start: start.startswith(word)


def _csv(start: bytes) -> bool:
    head = start.split(b"\n", 1)[0].lower()
    return b"name" in head and any(word in head for word in (b"heading", b"yaw", b"omega", b"quat", b"qw"))


# What files are: pattern of the path in lower case, whose they are, and what their start must be.
_Kind = tuple[str, str, Callable[[bytes], bool]]
_READ: Sequence[_Kind] = (
    (r".*/transforms[^/]*\.json", "nerfstudio", _has(b'"frames"')),
    (r".*/cameras\.json", "3DGS", _has(b'"position"', b'"rotation"')),
    (r".*/poses_bounds\.npy", "LLFF", lambda start: True),
)
_UNREAD: Sequence[_Kind] = (
    (r".*\.xml", "Metashape", _has(b"<document", b"<chunk")),
    (r".*\.out", "Bundler", _begins(b"# Bundle file")),
    (r".*\.nvm", "VisualSFM", _begins(b"NVM_V3")),
    (r".*\.csv", "RealityScan", _csv),
    (r".*/sfm_data[^/]*\.json|.*\.sfm", "OpenMVG or Meshroom", _has(b'"views"')),
    (r".*/reconstruction\.json", "OpenSfM", _has(b'"shots"')),
    (r".*/metadata(\.json)?", "Record3D", _has(b'"poses"')),
    (r".*/cameras[^/]*\.npz", "NeuS", _begins(b"PK")),
    (
        r".*/(traj|trajectory|poses?|groundtruth|camera_path)[^/]*\.txt",
        "a trajectory",
        _numbers(7, 8, 12, 16),
    ),
)
# Files for each image, of which a folder holds several.
_UNREAD_EACH: Sequence[_Kind] = (
    (r".*\.xmp", "RealityScan", _has(b"xcr:Rotation")),
    (r".*_cam\.txt", "MVSNet", _begins(b"extrinsic")),
    (r".*/(camera_?)?poses?/[^/]*\.txt", "matrices", _numbers(4, 16)),
    (r".*/(corrected_)?cameras/[^/]*\.json", "Polycam", _has(b'"t_00"')),
    (r".*/camera/[^/]*\.json", "Nerfies", _has(b'"orientation"')),
)  # fmt: skip


def pose_files(root: Path) -> list[PoseFile]:
    """Pose files below a folder, outermost folders first."""
    found = [each for folder, files in walk(root, DEPTH) for each in _in_folder(folder, files)]
    return sorted(found, key=lambda each: (len(each.path.parts), each.path))


def _in_folder(folder: Path, files: list[Path]) -> Iterator[PoseFile]:
    if is_model(folder):
        yield PoseFile(folder, "COLMAP")
    each_image: Counter[str] = Counter()
    for path in files:
        if path.suffix.lower() in IMAGE_SUFFIXES:
            continue
        if kind := _kind(path, _READ):
            yield PoseFile(path, kind)
        elif kind := _kind(path, _UNREAD):
            yield PoseFile(path, kind, readable=False)
        elif kind := _kind(path, _UNREAD_EACH):
            each_image[kind] += 1
    for kind, count in each_image.items():
        if count > 1:
            yield PoseFile(folder, kind, readable=False)


def _kind(path: Path, kinds: Sequence[_Kind]) -> str | None:
    """Program that wrote the poses of a file, or None."""
    name = path.absolute().as_posix().lower()
    fitting = [(kind, sure) for pattern, kind, sure in kinds if re.fullmatch(pattern, name)]
    if not fitting:
        return None
    try:
        with path.open("rb") as file:
            start = file.read(_START)
    except OSError:
        return None
    return next((kind for kind, sure in fitting if sure(start)), None)
