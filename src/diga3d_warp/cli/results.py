"""Commands that read a finished run: render, eval and export."""

from __future__ import annotations

from pathlib import Path

from diga3d_warp.cli.options import add_accuracy
from diga3d_warp.cli.parsing import Commands, path, positive_int, scale, size


def add_results(commands: Commands) -> None:
    """render, eval and export."""
    render = commands.add(
        "render", _render, "render a run along a path", "diga3d render run/statue --out statue.webm"
    )
    render.add_argument("folder", type=path, metavar="RUN", help="folder of a finished run")
    render.add_argument(
        "--out",
        type=path,
        metavar="FILE|DIR",
        help="a .webm, .mp4 or .avi video, or a folder for PNG frames (default RUN/path.webm)",
    )
    render.add_argument(
        "--path",
        choices=["spline", "views"],
        default="spline",
        help="a smooth path through the views, or the views themselves (default spline)",
    )
    render.add_argument(
        "--frames", type=positive_int, default=120, metavar="N", help="frames of a spline (default 120)"
    )
    render.add_argument(
        "--size", type=size, metavar="WxH", help="size of a frame in pixels (default that of the first view)"
    )
    add_accuracy(render, "accuracy of the frames")

    evaluate = commands.add("eval", _evaluate, "measure a run on held-out views", "diga3d eval run/statue")
    evaluate.add_argument("folder", type=path, metavar="RUN", help="folder of a finished run")
    evaluate.add_argument(
        "--protocol",
        choices=["held-out", "spin-nerf"],
        default="held-out",
        help="against held-out photographs, or those without the object of SPIn-NeRF, 360-USID or "
        "Inpaint360GS (default held-out)",
    )
    evaluate.add_argument(
        "--image-scale", type=scale, metavar="S", help="size of the images (default that of the run)"
    )
    evaluate.add_argument(
        "--weights",
        type=path,
        metavar="DIR",
        help="folder with weights of the perceptual metrics (default the caches that they are downloaded to)",
    )
    evaluate.add_argument(
        "--source-prompt",
        metavar="TEXT",
        help="what the scene shows before the edit, for CLIP_dir",
    )
    evaluate.add_argument(
        "--edit-prompt",
        metavar="TEXT",
        help="what the scene shows after the edit, for CLIP_dir (default the prompt of the run)",
    )

    export = commands.add(
        "export",
        _export,
        "write a splat in the format of other programs",
        "diga3d export run/statue --format spz",
        "Write the result of a run, or a splat file, in the format of other programs. Formats other than ply "
        "need: pip install 'diga3d-warp[formats]'.",
    )
    export.add_argument(
        "source", type=Path, metavar="RUN|FILE", help="folder of a finished run, or a splat file"
    )
    export.add_argument(
        "--format",
        dest="form",
        choices=["ply", "compressed-ply", "spz", "splat", "sog"],
        required=True,
        help="compressed-ply is PlayCanvas' and SuperSplat's",
    )
    export.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="file to write (default beside the splat)",
    )


def _render(
    folder: Path, out: Path | None, path: str, frames: int, size: tuple[int, int] | None, accuracy: str
) -> int:
    from diga3d_warp.config import ACCURACIES
    from diga3d_warp.pipelines.render import render_path

    print(render_path(folder, out, path=path, frames=frames, size=size, accuracy=ACCURACIES[accuracy]))
    return 0


def _evaluate(
    folder: Path,
    protocol: str,
    image_scale: float | None,
    weights: Path | None,
    source_prompt: str | None,
    edit_prompt: str | None,
) -> int:
    from diga3d_warp.checkpoints import best_device
    from diga3d_warp.evaluation.perceptual import Perceptual, edit_text
    from diga3d_warp.evaluation.protocols import evaluate
    from diga3d_warp.evaluation.record import read_manifest
    from diga3d_warp.evaluation.report import write_report

    text = edit_text(read_manifest(folder), source_prompt, edit_prompt)
    perceptual = Perceptual.load(weights, best_device("auto"), text)
    for table in evaluate(folder, protocol, image_scale=image_scale, perceptual=perceptual):
        print(table.text())
    print(write_report(folder))
    return 0


def _export(source: Path, form: str, out: Path | None) -> int:
    from diga3d_warp.pipelines.export import export_splat
    from diga3d_warp.pipelines.run import say

    exported = export_splat(source, form, out)
    for note in exported.notes:
        say(f"note: {note}")
    print(exported.path)
    return 0
