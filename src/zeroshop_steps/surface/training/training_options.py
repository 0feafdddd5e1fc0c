"""The options and settings that the optimizers share. This module does not import PyTorch, so that `--help` answers at once."""

import os
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

from zeroshop_steps.runtime.compute.kernel_devices import DEVICES

INITIALIZATIONS = ("stereo", "sparse")
"""What training starts from: the depths that stereo has confirmed, or nothing but the registration's sparse points, as in the papers."""


class TrainingSettings:
    """What the settings of every optimizer hold; each optimizer's own dataclass adds to it.

    Attributes:
        iterations: training views drawn in a run, one after the other. Settings ending in `_share` are fractions of it.
        sh_degree: spherical-harmonics degree of the colour at the end; it rises from 0 during the first half of the run.
        seed: of everything random.
        initialization: what training starts from, one of `INITIALIZATIONS`.
        lambda_depth: weight of the depths that are known before training: those that stereo has confirmed, or of the sparse points.
        normal_from_share: when the loss begins to compare normals.
        coarse_share: when training changes from the coarse images to the fine ones.
        device: where the kernels run, one of `DEVICES`.
    """

    iterations: int
    sh_degree: int
    seed: int
    initialization: str
    lambda_depth: float
    normal_from_share: float
    coarse_share: float
    device: str


def add_setting_arguments(parser: ArgumentParser, settings: type[TrainingSettings], options: dict[str, str]) -> None:
    """Add an option for each of an optimizer's own settings, by its name and help text. A setting that is a tuple takes several values."""
    for name, text in options.items():
        default = getattr(settings, name)
        several = isinstance(default, tuple)
        kind, number = (type(default[0]), "+") if several else (type(default), None)
        parser.add_argument(f"--{name.replace('_', '-')}", type=kind, nargs=number, default=default, help=text)


def chosen_settings(args: Namespace, options: dict[str, str]) -> dict[str, Any]:
    """The settings that the command line gives: the shared ones, and those of `add_setting_arguments`."""
    shared = ("iterations", "sh_degree", "seed", "initialization", "device")
    values = {name: getattr(args, name) for name in (*shared, *options)}
    return {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}


def add_training_arguments(parser: ArgumentParser, product: str, iterations: int, image_width_px: int, sh_degree: int) -> None:
    """Add the options, with an optimizer's own defaults; product: the file that holds the trained model."""
    parser.add_argument("--cameras", type=Path, required=True, help="folder of a registration: images, masks and sparse model")
    parser.add_argument("--initialization", choices=INITIALIZATIONS, default="stereo", help="what training starts from")
    parser.add_argument("--stereo", type=Path, help="seeds.npz that stereo has made from these cameras, to start from")
    parser.add_argument("--out", type=Path, required=True, help=f"folder for {product}, training.csv and training.json")
    parser.add_argument("--iterations", type=int, default=iterations)
    parser.add_argument("--image-width-px", type=int, default=image_width_px, help="images are resized to this width, never enlarged")
    parser.add_argument("--sh-degree", type=int, default=sh_degree, choices=range(4), help="spherical-harmonics degree of the colour")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--device", choices=DEVICES, default="cpu", help="where the kernels run (default: %(default)s)")
    parser.add_argument("--checkpoint-every", type=int, default=100, help="iterations between checkpoints")
    parser.add_argument("--resume", action="store_true", help="continue from a checkpoint made with the same settings")
