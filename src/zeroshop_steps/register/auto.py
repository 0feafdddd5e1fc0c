"""Register by SIFT (colmap); where that fails, by learned features (aliked), if their weights are there; then by outlines alone.

The record says which gave the cameras, and why the others did not.

What SIFT registers keeps the cameras, the bytes and the seconds that `colmap` gives, but where many images were left out: then the next
is tried, too. Learned features and outlines are tried only with masks, which check their cameras: on whole photos of plain tables they
match other sides and other things too readily. Photos without masks get them by a salient-object network, if one is named; then SIFT's
cameras, too, are checked by such masks where few points hold them.
"""

import argparse
import functools
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras import fit_similarity, read_sparse_model
from zeroshop_steps.geometry.transforms import transform_points
from zeroshop_steps.networks.aliked import EXTRACTOR, FOLDER, MATCHER, has_weights
from zeroshop_steps.networks.salient_networks import DEFAULT, NETWORKS
from zeroshop_steps.networks.salient_object import add_network_arguments, load_network
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER, read_table
from zeroshop_steps.register import aliked, colmap, silhouette_sfm
from zeroshop_steps.register.pipeline import add_matching_arguments
from zeroshop_steps.register.registration import write_registration
from zeroshop_steps.register.scene.image_set import ImageSet, read_image_set
from zeroshop_steps.register.scene.record import Record, RegistrationFailed, fill_apart
from zeroshop_steps.register.verification import predicted_masks
from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.runtime.errors import warn
from zeroshop_steps.runtime.files import scratch_directory

CACHED = Cached(inputs=("capture/images", "capture/masks", "weights", "network"), ignored=("threads", "device"))
METHOD = {"title": "automatic", "rank": 4, "tries": ("colmap", "aliked"), "saliency": True}

DOUBTFUL_SHARE = 0.8
"""Share of the images. Where fewer were registered and the others left out, such as one of two rounds, learned features may find more."""
LEAST_COMMON, APART_SHARE = 5, 0.05
"""Two registrations agree where so many images stand in both, apart by at most this share of their distance from their middle."""
Attempt = Callable[[Path], dict[str, Any]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_matching_arguments(parser)
    colmap.add_own_arguments(parser)
    aliked.add_own_arguments(parser)
    add_network_arguments(parser, None)


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    image_set = read_image_set(args.capture)
    pycolmap.logging.minloglevel = pycolmap.logging.ERROR
    learned = aliked.read_options(args)
    network = None if image_set.masks is not None or args.network is None else load_network(args)
    find_maps = functools.cache(predicted_masks.find_object_maps)

    def register_scene(folder: Path) -> dict[str, Any]:
        record = colmap.register(image_set, folder, colmap.read_options(args))
        return (
            predicted_masks.check_by_predicted_masks(folder, record, network) if network and predicted_masks.is_sparse(record) else record
        )

    def register_object(folder: Path, by: Callable[[ImageSet, Path], dict[str, Any]]) -> dict[str, Any]:
        if image_set.masks is not None:
            return by(image_set, folder)
        assert network is not None  # without masks and a network, these attempts are not made
        maps = find_maps(network, image_set.images)
        return predicted_masks.register_by_predicted_masks(folder, image_set, network, maps, lambda masked: by(masked, folder))

    attempts: dict[str, Attempt] = {"colmap": register_scene}
    there, masked = has_weights(args.weights), image_set.masks is not None or network is not None
    if there and masked:
        prepare = aliked.make_matcher(args, learned)
        attempts["aliked"] = lambda folder: register_object(folder, lambda masked, into: aliked.register(masked, into, learned, prepare))
    if masked:
        scene = colmap.read_options(args)
        by_outlines = silhouette_sfm.SilhouetteOptions(scene.sift, scene.structure)
        attempts["outlines"] = lambda folder: register_object(
            folder, lambda masked, into: silhouette_sfm.register(masked, into, by_outlines)
        )
    write_registration(args.out, lambda folder: register(folder, attempts, _advise(there, masked)))


def register(out: Path, attempts: dict[str, Attempt], advice: str = "") -> dict[str, Any]:
    """Try one registration after the other, and keep the first that succeeds and leaves few images out.

    Where many were left out, the next is tried, too, and taken if it registers more of them and agrees.

    Args:
        out: folder to fill.
        attempts: by name, what fills a folder with cameras and returns its record.
        advice: ends the reason where none succeeded.

    Returns:
        The record of the one that is kept, with `tried`: why the others were not, and how long they took.

    Raises:
        RegistrationFailed: none succeeded; with the figures and the model of the one that registered most images.
    """
    failures: dict[str, RegistrationFailed] = {}
    tried: dict[str, dict[str, Any]] = {}
    with scratch_directory(out, "attempts") as scratch:
        kept: tuple[Path, dict[str, Any]] | None = None
        for name, attempt in attempts.items():
            start_s, last = time.monotonic(), name == list(attempts)[-1]
            (scratch / name).mkdir()
            try:
                found = scratch / name, fill_apart(scratch / name, name, attempt)
            except RegistrationFailed as error:
                failures[name], reason = error, str(error)
            else:
                kept, reason = _choose(kept, found) if kept else (found, _count(found[1]))
            tried[name] = {"reason": reason, "seconds": round(time.monotonic() - start_s, 3)}
            if kept and not _is_doubtful(kept[1]):
                break
            if not last:
                warn(f"registration by {name} {'failed' if name in failures else 'is doubtful'} ({reason}); trying the next")
        if kept is not None:
            folder, record = kept
            tried.pop(folder.name, None)
            for part in folder.iterdir():
                shutil.move(part, out / part.name)
            return record | {"tried": tried}
    best = max(failures.values(), key=lambda error: error.figures.get("registered", 0))
    reason = "; ".join(f"by {name}: {error}" for name, error in failures.items()) if len(failures) > 1 else str(best)
    raise RegistrationFailed(reason + advice, best.figures | {"tried": tried}, best.rejected)


def _is_doubtful(record: dict[str, Any]) -> bool:
    return bool(record["registered"] < DOUBTFUL_SHARE * record.get("images", 0))


def _count(record: dict[str, Any]) -> str:
    return f"{record['registered']} of {record.get('images', record['registered'])} images registered"


def _choose(kept: tuple[Path, dict[str, Any]], other: tuple[Path, dict[str, Any]]) -> tuple[tuple[Path, dict[str, Any]], str]:
    """The folder and record of the better one of two registrations, the first unless the other has more images and agrees, and why."""
    (folder, record), (other_folder, other_record) = kept, other
    if other_record["registered"] <= record["registered"]:
        return kept, _count(other_record)
    if not _agree(folder, other_folder):
        doubt = f"the cameras by {folder.name} and by {other_folder.name} contradict each other; one of them is wrong"
        return (folder, dict(Record(record).warn(f"{doubt}. Put the object on print, or take more photos").entries)), doubt
    return other, _count(other_record)


def _agree(one: Path, other: Path) -> bool:
    """Whether the images that two registrations have in common stand alike in both."""
    first, second = (
        {camera.name: camera.centre_in_world for camera in read_sparse_model(folder / "sparse").cameras} for folder in (one, other)
    )
    common = sorted(first.keys() & second.keys())
    if len(common) < LEAST_COMMON:
        return False
    source, target = (np.array([centres[name] for name in common]) for centres in (first, second))
    apart = np.linalg.norm(transform_points(source, fit_similarity(source, target)) - target, axis=1)
    return bool(np.sqrt((apart**2).mean()) < APART_SHARE * np.linalg.norm(target - target.mean(0), axis=1).mean())


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
        advice += (
            ". Masks of the object help them, yours or by a salient-object network (segment.saliency.network), such as"
            f" {DEFAULT}, which `snakemake {NETWORKS[DEFAULT].path}` downloads"
        )
    return advice
