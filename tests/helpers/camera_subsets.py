"""Register subsets of the views of rendered captures under many seeds, and compare the verdict with the true cameras.

The features and matches of all views are computed once and kept: COLMAP's database of SIFT, and ALIKED's features with LightGlue's matches.
For each seed, some views are drawn; what matches among them goes through registration `auto`, with that seed for all RANSAC loops: mapping,
re-registration, keypoint refinement, silhouettes, merging, and all checks. Seed 0 takes all views: its cameras are those of the workflow.
As a command, one row of the CSV for each capture and seed; rows that are there are not made again:

    PYTHONPATH=tests python tests/helpers/camera_subsets.py results/ycbv/obj_000001/{su_l,se}/capture --seeds 0 1 2 3 4 5 --out subsets.csv

With `--network`, an ONNX file, masks are those that it finds in each photo alone. Leave the attempt by COLMAP out then: here it would be
led by these masks, and in `auto` it sees the whole photos. SIFT's views that match badly get features of stretched copies as in the whole
capture. A pair of views that the network first meets in a subset is matched then, and kept.
"""

import argparse
import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from helpers.stored_captures import StoredCapture, SubsetMatcher, copy_matches
from zeroshop_steps.evaluate.camera_error import compare_cameras
from zeroshop_steps.geometry.cameras.pinhole import LEAST_PAIRS, Camera, read_sparse_model
from zeroshop_steps.geometry.cameras.sparse_files import write_reconstruction
from zeroshop_steps.register import aliked, colmap, silhouette_sfm
from zeroshop_steps.register.camera_proposals import Proposer, propose
from zeroshop_steps.register.features.sift import SiftOptions
from zeroshop_steps.register.matching.view_graph import ViewGraph
from zeroshop_steps.register.pipeline import StructureOptions
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.register.scene.record import OBJECT_ONLY, RegistrationFailed, Stopwatch
from zeroshop_steps.runtime.files import scratch_directory, write_json
from zeroshop_steps.runtime.tables import read_table, write_table

KINDS = ("all", "random", "half", "random", "gap", "above")
"""Of subsets: that of a seed is the one of its number, and again from the start."""
MORE_KINDS = ("ring", "single")
"""One ring has too few views to register. Of two opposite views, `single` has one: where sides that look alike are laid onto each other,
no two views lie side by side that could be compared."""
LEAST_SHARE, LARGEST_SHARE = 0.6, 0.9  # of the views that are drawn at random
HALF_DEG, GAP_DEG = 100.0, 45.0  # azimuths up to so far on either side of one are in a half, or in the gap
RING_DEG = 5.0  # between elevations of one ring and the next
WRONG_MEAN_MM, WRONG_LARGEST_MM, WRONG_TURN_DEG, DOUBTFUL_MM = 10.0, 30.0, 5.0, 5.0
ATTEMPTS = ("colmap", "aliked", "outlines")
COLUMNS = ("capture", "seed", "kind", "views", "method", "registered", "accepted", "cameras", "mean_mm", "largest_mm", "turn_deg")
COLUMNS += ("seconds", "attempts", "reason")


def draw_views(truth: Sequence[Camera], kind: str, rng: np.random.Generator) -> np.ndarray:
    """Sorted numbers of the views that a subset of a kind has.

    Args:
        truth: the true cameras of all views, around the z axis.
        kind: one of `KINDS` or `MORE_KINDS`.
        rng: what is drawn by.
    """
    centres = np.array([camera.centre_in_world for camera in truth])
    azimuths = np.degrees(np.arctan2(centres[:, 1], centres[:, 0]))
    elevations = np.degrees(np.arctan2(centres[:, 2], np.hypot(centres[:, 0], centres[:, 1])))
    levels = np.sort(elevations)
    starts = [levels[0], *levels[1:][np.diff(levels) > RING_DEG]]
    away_deg = np.abs((azimuths - rng.uniform(-180, 180) + 180) % 360 - 180)
    if kind == "random":
        count = round(len(centres) * rng.uniform(LEAST_SHARE, LARGEST_SHARE))
        return np.sort(rng.choice(len(centres), count, replace=False))
    turned = (azimuths + RING_DEG) % 360
    _, axis = np.unique(np.round(np.stack([elevations, turned % 180], 1)), axis=0, return_inverse=True)
    chosen = {
        "all": np.ones(len(centres), bool),
        "half": away_deg <= HALF_DEG,
        "gap": away_deg > GAP_DEG,
        "above": elevations >= starts[min(1, len(starts) - 1)],
        "ring": np.searchsorted(starts, elevations, "right") - 1 == rng.integers(len(starts)),
        "single": (turned < 180) == rng.integers(2, size=len(centres))[axis],
    }[kind]
    return np.flatnonzero(chosen)


def restrict(images: ImageSet, numbers: np.ndarray) -> ImageSet:
    """The images of these numbers."""

    def pick(values: Sequence[Any]) -> tuple[Any, ...]:
        return tuple(values[number] for number in numbers)

    masks = None if images.masks is None else pick(images.masks)
    return replace(images, images=pick(images.images), masks=masks, sizes_px=pick(images.sizes_px), sources=())


def register_subset(stored: StoredCapture, numbers: np.ndarray, seed: int, attempts: Sequence[str], out: Path) -> dict[str, Any]:
    """Registration `auto` of some views, in a new folder `out`. Raises RegistrationFailed as it does."""
    images = restrict(stored.images, numbers)
    structure = StructureOptions(seed=seed, object_only=stored.scene in OBJECT_ONLY)
    scene = colmap.ColmapOptions(SiftOptions(seed=seed), structure)

    def match(database: Path, image_set: ImageSet, options: colmap.ColmapOptions, _: Stopwatch) -> ViewGraph:
        source, graph = stored.read_matches(replace(options, sift=replace(options.sift, seed=0)))
        copy_matches(source, database, image_set, options.sift.seed)
        return replace(graph, pairs=None)

    learned = aliked.AlikedOptions(structure=structure)
    out.mkdir(parents=True)
    with scratch_directory(out, "scene") as scratch:
        proposers = [
            *colmap.make_proposers(images, scene, scratch, match),
            Proposer(
                "aliked",
                lambda folder, _: aliked.register(images, folder, learned, lambda crops: SubsetMatcher(stored.matcher(), numbers)),
            ),
            Proposer(
                "outlines",
                lambda folder, _: silhouette_sfm.register(images, folder, silhouette_sfm.SilhouetteOptions(scene.sift, structure)),
            ),
        ]
        return propose(out, [proposer for proposer in proposers if proposer.name in attempts])


def judge(cameras: Sequence[Camera], truth: Sequence[Camera]) -> dict[str, Any]:
    """How far cameras are from the true ones, and whether that is right, doubtful or wrong."""
    error = compare_cameras(tuple(cameras), tuple(truth))
    mean_mm, largest_mm, turn_deg = float(error.centre_mm.mean()), float(error.centre_mm.max()), float(error.rotation_deg.max())
    wrong = mean_mm > WRONG_MEAN_MM or largest_mm > WRONG_LARGEST_MM or turn_deg > WRONG_TURN_DEG
    verdict = "wrong" if wrong else "doubtful" if mean_mm > DOUBTFUL_MM else "right"
    return {"cameras": verdict, "mean_mm": round(mean_mm, 3), "largest_mm": round(largest_mm, 3), "turn_deg": round(turn_deg, 3)}


def make_row(stored: StoredCapture, seed: int, kind: str, attempts: Sequence[str]) -> dict[str, Any]:
    """One row of the table; the whole record goes beside what is stored of the capture."""
    numbers = draw_views(stored.truth, kind, np.random.default_rng(seed))
    row = {"capture": stored.capture.parent.as_posix(), "seed": seed, "kind": kind, "views": len(numbers), "attempts": "+".join(attempts)}
    start_s = time.monotonic()
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "cameras"
        model = out / "sparse"
        try:
            record = register_subset(stored, numbers, seed, attempts, out)
            row |= {"method": record["method"], "accepted": "yes", "registered": record["registered"]}
        except RegistrationFailed as error:
            record = {**error.figures, "reason": str(error)}
            row |= {"method": record["method"], "accepted": "no", "registered": record["registered"], "reason": str(error)}
            shutil.rmtree(out)
            if error.rejected is not None:
                write_reconstruction(error.rejected, model)
        if model.is_dir() and row["registered"] >= LEAST_PAIRS:
            row |= judge(read_sparse_model(model).cameras, stored.truth)
    row["seconds"] = round(time.monotonic() - start_s, 1)
    stored.save()
    write_json(stored.folder / f"{kind}_{seed}.json", {**row, "record": record})
    return row


def main() -> None:
    """Complete the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", type=Path, nargs="+", help="folders of rendered captures, DATASET/OBJECT/SCENE/capture")
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(6)), help="a row each (default: %(default)s)")
    parser.add_argument("--kind", choices=sorted({*KINDS, *MORE_KINDS}), help="of all subsets; by default, that of the seed's number")
    parser.add_argument("--attempts", nargs="+", choices=ATTEMPTS, default=ATTEMPTS, help="those of auto to make (default: all)")
    parser.add_argument(
        "--weights", type=Path, default=aliked.WEIGHTS_FOLDER / aliked.FOLDER, help="of the networks (default: %(default)s)"
    )
    parser.add_argument("--network", type=Path, help="ONNX file of a salient-object network that finds the masks (default: given ones)")
    parser.add_argument("--store", type=Path, default=Path("results/subsets"), help="what is kept, and records (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="CSV to complete")
    args = parser.parse_args()
    pycolmap.logging.minloglevel = pycolmap.logging.ERROR
    rows = read_table(args.out).to_dict("records") if args.out.is_file() else []
    for capture in args.captures:
        stored = StoredCapture(capture, args.store / "-".join(capture.parent.parts[-3:]), args.weights, args.network)
        for seed in args.seeds:
            kind = args.kind or KINDS[seed % len(KINDS)]
            key = (capture.parent.as_posix(), str(seed), kind, "+".join(args.attempts))
            if key in {(row["capture"], str(row["seed"]), row["kind"], row["attempts"]) for row in rows}:
                continue
            rows.append(make_row(stored, seed, kind, args.attempts))
            write_table(args.out, rows, COLUMNS)
            print({name: rows[-1].get(name) for name in COLUMNS if name != "attempts"}, flush=True)


if __name__ == "__main__":
    sys.exit(main())
