"""What every registration method has: arguments, and the folder that it writes."""

import argparse
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import pycolmap

from zeroshop_steps.register.refinement.camera_deviation import write_deviations
from zeroshop_steps.register.scene.record import OBJECT_ONLY, SCENES
from zeroshop_steps.register.verification.verdict import MAX_WRONG_PROBABILITY
from zeroshop_steps.register.verification.view_coverage import record_view_coverage
from zeroshop_steps.runtime.compute.kernel_devices import DEVICES
from zeroshop_steps.runtime.errors import warn
from zeroshop_steps.runtime.files import atomic_directory, write_json

Options = TypeVar("Options")


def add_common_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that all registration methods share."""
    parser.add_argument("--capture", type=Path, required=True, help="folder with images/ and, unless the whole scene is meant, masks/")
    parser.add_argument("--scene", required=True, choices=SCENES, help=f"{' and '.join(OBJECT_ONLY)} go by the object alone")
    parser.add_argument("--out", type=Path, required=True, help="cameras folder to write")
    parser.add_argument("--threads", type=int, default=2, help="worker threads (default: %(default)s)")


def add_options(parser: argparse.ArgumentParser, defaults: Any, **helps: str) -> None:
    """An argument for each of these fields of a dataclass, whose type and default are those of the field; with what it means."""
    for name, text in helps.items():
        usual = getattr(defaults, name)
        parser.add_argument(f"--{name.replace('_', '-')}", type=type(usual), default=usual, help=f"{text} (default: %(default)s)")


def read_options(kind: type[Options], args: argparse.Namespace, **others: Any) -> Options:
    """A dataclass of options from the arguments that are called like its fields, and others."""
    return kind(**{field.name: vars(args)[field.name] for field in fields(kind) if field.name in vars(args)} | others)  # type: ignore[arg-type]


def add_estimation_arguments(parser: argparse.ArgumentParser, defaults: Any) -> None:
    """Arguments of every method that estimates cameras; the defaults have its fewest images and its seed."""
    add_options(parser, defaults, min_share="share of images needed", min_images="number of images needed", seed="seed of all RANSAC loops")
    wrong_help = "cameras are refused from this probability of being wrong on (default: %(default)s)"
    parser.add_argument("--max-wrong-probability", type=float, default=MAX_WRONG_PROBABILITY, help=wrong_help)


def add_network_arguments(parser: argparse.ArgumentParser, weights: Path, what: str = "the network's weights") -> None:
    """Where a network runs, and where its weights lie."""
    parser.add_argument("--device", choices=DEVICES, default="auto", help="where the network runs (default: %(default)s)")
    parser.add_argument("--weights", type=Path, default=weights, help=f"{what} (default: %(default)s)")


def write_registration(out: Path, register: Callable[[Path], dict[str, Any]], estimated: bool = True) -> None:
    """Run `register` on a folder that becomes `out` when it succeeds, and write its record, with advice on what to film again.

    Args:
        out: folder to write.
        register: fills it; returns the entries of registration.json.
        estimated: whether the cameras were, and so are uncertain; true ones have no deviations.
    """
    pycolmap.logging.minloglevel = pycolmap.logging.ERROR
    with atomic_directory(out) as folder:
        record = {"status": "ok", "reason": None, **register(folder)} | record_view_coverage(folder)
        if estimated:
            outlines = record.get("outlines", {"adjusted": False})
            record |= write_deviations(folder, by_outlines=outlines.get("adjusted", True))
        write_json(folder / "registration.json", record)
    for line in [*record.get("warnings", []), *record["advice"]]:
        warn(line)
