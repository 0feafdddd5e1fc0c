"""Register by SIFT (colmap); where that fails, by learned features (aliked), if their weights are there; then by outlines alone.

The record says which gave the cameras, and why the others did not.

Whatever SIFT registers keeps the cameras, the bytes and the seconds that `colmap` gives. Learned features are tried only with masks, which
check their cameras: on whole photos of plain tables they match other sides and other things too readily. Photos without masks get them
by a salient-object network, if one is named; then SIFT's cameras, too, are checked by such masks where few points hold them. Without a
network, what contrasts with a plain ground gives the masks for learned features. Outlines alone are tried with given masks only: found
ones are too rough for them.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pycolmap

from zeroshop_steps.networks.aliked import EXTRACTOR, FOLDER, MATCHER, has_weights
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER, read_table
from zeroshop_steps.register import aliked, colmap, found_masks, outlines
from zeroshop_steps.register.ground_contrast import GroundContrast
from zeroshop_steps.register.image_set import read_image_set
from zeroshop_steps.register.record import RegistrationFailed, fill_apart, write_registration
from zeroshop_steps.register.structure import add_matching_arguments
from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.runtime.errors import warn

CACHED = Cached(inputs=("capture/images", "capture/masks", "weights", "saliency_weights"), ignored=("threads", "device"))
METHOD = {"title": "automatic", "rank": 4, "tries": ("colmap", "aliked"), "saliency": True}

Attempt = Callable[[Path], dict[str, Any]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_matching_arguments(parser)
    colmap.add_own_arguments(parser)
    aliked.add_own_arguments(parser)
    found_masks.add_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    image_set = read_image_set(args.capture)
    pycolmap.logging.minloglevel = pycolmap.logging.ERROR
    learned = aliked.read_options(args)
    network = None if image_set.masks is not None else found_masks.load_network(args)

    def register_scene(folder: Path) -> dict[str, Any]:
        record = colmap.register(image_set, folder, colmap.read_options(args))
        return found_masks.check_by_found_masks(folder, record, network) if network and found_masks.is_thin(record) else record

    attempts: dict[str, Attempt] = {"colmap": register_scene}
    there = has_weights(args.weights)
    if there:
        prepare = aliked.make_matcher(args, learned)

        def register_object(folder: Path) -> dict[str, Any]:
            if image_set.masks is not None:
                return aliked.register(image_set, folder, learned, prepare)
            return found_masks.register_by_found_masks(
                folder, image_set, network or GroundContrast(), lambda masked: aliked.register(masked, folder, learned, prepare)
            )

        attempts["aliked"] = register_object
    if image_set.masks is not None:
        scene = colmap.read_options(args)
        attempts["outlines"] = lambda folder: outlines.register(image_set, folder, outlines.OutlineOptions(scene.sift, scene.structure))
    write_registration(
        args.out, lambda folder: register(folder, attempts, _advise(there, image_set.masks is not None or network is not None))
    )


def register(out: Path, attempts: dict[str, Attempt], advice: str = "") -> dict[str, Any]:
    """Try one registration after the other, and keep the first that succeeds.

    Args:
        out: folder to fill.
        attempts: by name, what fills a folder with cameras and returns its record.
        advice: ends the reason where none succeeded.

    Returns:
        The record of the one that succeeded, with `tried`: why those before it failed, and how long they took.

    Raises:
        RegistrationFailed: none succeeded; with the figures and the model of the one that registered most images.
    """
    failures: dict[str, RegistrationFailed] = {}
    tried: dict[str, dict[str, Any]] = {}
    for name, attempt in attempts.items():
        start_s = time.monotonic()
        try:
            return fill_apart(out, name, attempt) | {"tried": tried}
        except RegistrationFailed as error:
            failures[name] = error
            tried[name] = {"reason": str(error), "seconds": round(time.monotonic() - start_s, 3)}
            if name != list(attempts)[-1]:
                warn(f"registration by {name} failed ({error}); trying the next")
    best = max(failures.values(), key=lambda error: error.figures.get("registered", 0))
    reason = "; ".join(f"by {name}: {error}" for name, error in failures.items()) if len(failures) > 1 else str(best)
    raise RegistrationFailed(reason + advice, best.figures | {"tried": tried}, best.rejected)


def _advise(there: bool, has_masks: bool) -> str:
    """What would let learned features find the cameras, as the end of a reason; empty where they had all that helps."""
    advice = ""
    if not there:
        rows = [read_table()[f"{FOLDER}/{name}"] for name in (EXTRACTOR, MATCHER)]
        megabytes = sum(row.size_bytes or 0 for row in rows) / 1e6
        advice += (
            f". Learned features may find the cameras; they need their weights, which `snakemake {WEIGHTS_FOLDER / FOLDER}/"
            f"{{{EXTRACTOR},{MATCHER}}}` downloads ({megabytes:.0f} MB, {rows[0].licence})"
        )
    if not has_masks:
        advice += ". Masks of the object help them, yours or by a salient-object network (segment.saliency.weights)"
    return advice
