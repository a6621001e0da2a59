"""Options that several commands share."""

from __future__ import annotations

import argparse

from diga3d_warp.cli.parsing import (
    effects,
    hold_out,
    non_negative,
    path,
    positive_int,
    scale,
    seed,
    share,
    whole_numbers,
)


def add_run_options(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "scene",
        type=path,
        metavar="SCENE",
        help="folder of a capture, or its file of poses or splat",
    )
    command.add_argument("--out", type=path, required=True, metavar="RUN", help="run folder to create")
    command.add_argument(
        "--masks",
        type=path,
        metavar="DIR",
        help="folder with a mask for each image (default: found in the capture)",
    )
    command.add_argument(
        "--mask-ids",
        type=whole_numbers,
        default=(),
        metavar="N,N",
        help="numbers of the objects to edit, where masks hold several (default: all)",
    )
    command.add_argument(
        "--image-scale",
        type=scale,
        default=1.0,
        metavar="S",
        help="image size relative to the largest images of the capture (default 1)",
    )
    command.add_argument(
        "--iterations",
        type=positive_int,
        metavar="N",
        help="iterations of the fit (default: by the number of views)",
    )
    command.add_argument(
        "--hold-out",
        type=hold_out,
        default=8,
        metavar="N",
        help="hold out every Nth view for testing, 0 for none (default 8)",
    )
    command.add_argument(
        "--effects",
        type=effects,
        default={},
        metavar="LIST",
        help="force effects, such as sh_degree=1,exposure=off (default: chosen from the capture)",
    )
    command.add_argument(
        "--representation",
        choices=["gaussians", "scaffold"],
        default="gaussians",
        help="what is fitted: gaussians, or anchors that decode to gaussians for each view (Scaffold-GS); "
        "the result is written as gaussians (default gaussians)",
    )
    add_accuracy(command, "accuracy of the fitted renderings")
    command.add_argument("--seed", type=seed, default=0, metavar="N", help="random seed (default 0)")
    command.add_argument("--resume", action="store_true", help="continue an interrupted run")


def add_accuracy(command: argparse.ArgumentParser, of_what: str) -> None:
    command.add_argument(
        "--accuracy",
        choices=["draft", "standard", "exact"],
        default="standard",
        help=f"{of_what}; more takes longer (default standard)",
    )


def add_marks(command: argparse.ArgumentParser) -> None:
    """Marks of the object in place of --masks."""
    command.add_argument(
        "--mask-box",
        dest="mask_boxes",
        nargs=5,
        action="append",
        default=[],
        metavar=("VIEW", "X0", "Y0", "X1", "Y1"),
        help="a box [px] around the object in one view, in place of masks; up to three, from other sides",
    )
    command.add_argument(
        "--mask-prompt",
        metavar="TEXT",
        help="name of the object, in place of masks: found by GroundingDINO and SAM",
    )
    command.add_argument(
        "--mask-models",
        type=path,
        metavar="DIR",
        help="folder with the weights of both in detector and cutter (default: the Hugging Face cache)",
    )


def add_exemplar(command: argparse._ActionsContainer, in_place_of: str) -> None:
    command.add_argument(
        "--exemplar",
        type=path,
        metavar="IMAGE",
        help=f"a photograph of the material, in place of {in_place_of}",
    )


def add_fill(command: argparse._ActionsContainer, use: str) -> None:
    command.add_argument(
        "--fill",
        action="append",
        default=[],
        metavar="VIEW=IMAGE|DIR",
        help=f"a view as filled by another program, or a folder of such images named after views; {use} "
        "(repeatable)",
    )


def add_prior(command: argparse.ArgumentParser) -> None:
    """Prior and method: the attributes of `pipelines.method.Choices`."""
    command.add_argument(
        "--prior",
        default="exemplar",
        metavar="PRIOR",
        help="prior that inpaints what no photograph shows: exemplar, classical, room, lama, sd-inpainting, "
        "powerpaint, an .onnx file of LaMa, or a folder in diffusers format (default exemplar)",
    )
    command.add_argument("--negative", default="", metavar="TEXT", help="negative prompt (default none)")
    add_reference_options(command)
    command.add_argument(
        "--propagation",
        choices=["attention", "warp", "none"],
        help="propagation of the references to the other views: by attention (AFP), depth warping, or none "
        "(default: attention with a Stable Diffusion prior, else warp)",
    )
    command.add_argument(
        "--tg-sds",
        action=argparse.BooleanOptionalAction,
        help="refine the edit by score distillation (default: with a Stable Diffusion prior)",
    )
    add_network(command)


def add_network(command: argparse.ArgumentParser) -> None:
    """Options of diffusion; None is the default of the prior."""
    network = command.add_argument_group("diffusion priors")
    network.add_argument(
        "--steps", type=positive_int, metavar="N", help="DDIM steps of a Stable Diffusion prior (default 30)"
    )
    network.add_argument(
        "--guidance",
        type=non_negative,
        metavar="S",
        help="guidance scale (default 7.5; 1 reads no negative prompt)",
    )
    network.add_argument(
        "--afp-weight", type=share, metavar="W", help="weight of the references' attention (default 0.6)"
    )
    network.add_argument(
        "--inversion",
        choices=["none", "photograph", "fill"],
        help="start sampling from noise, or from the DDIM inversion of the photographs with the object or of "
        "the warped fill (default: photograph in edits by free text, none in removals)",
    )
    network.add_argument(
        "--sds-weight", type=non_negative, metavar="W", help="weight of score distillation (default 1e-4)"
    )
    network.add_argument(
        "--edges-scale", type=non_negative, metavar="W", help="weight of the edges' ControlNet (default 0.8)"
    )
    network.add_argument(
        "--depth-scale", type=non_negative, metavar="W", help="weight of the depth ControlNet (default 1)"
    )
    network.add_argument(
        "--image-encoder",
        type=path,
        metavar="DIR",
        help="folder of CLIP's vision model, which tells the prior what inpainted references show",
    )
    network.add_argument(
        "--ip-adapter", type=path, metavar="FILE", help="IP-Adapter weights (.safetensors) for that"
    )


def add_surfaces(command: argparse.ArgumentParser) -> None:
    """What a removal alone may choose."""
    command.add_argument(
        "--surfaces",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="fill the surfaces behind the object in their own coordinates, once for all views (default on)",
    )


def add_reference_options(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--references",
        type=positive_int,
        default=3,
        metavar="K",
        help="reference views, edited before the others (default 3)",
    )
    command.add_argument(
        "--selection",
        choices=["kmeans", "random"],
        default="kmeans",
        help="how references are chosen (default kmeans)",
    )
