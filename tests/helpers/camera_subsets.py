"""Register subsets of the views of rendered captures under many seeds, and compare the verdict with the true cameras.

The features and matches of all views are computed once and kept: COLMAP's database of SIFT, and ALIKED's features with LightGlue's matches.
For each seed, some views are drawn; what matches among them goes through registration `auto`, with that seed for all RANSAC loops: mapping,
repair, sharpening, outlines, joining of groups, and all checks. Seed 0 takes all views: its cameras are those of the workflow. As a
command, one row of the CSV for each capture and seed; rows that are there are not made again:

    python tests/helpers/camera_subsets.py results/ycbv/obj_000001/{su_l,se}/capture --seeds 0 1 2 3 4 5 --out subsets.csv

With `--network`, an ONNX file, masks are those that it finds in each photo alone. Leave the attempt by COLMAP out then: here it would be
led by these masks, and in `auto` it sees the whole photos. SIFT's views that match badly get features of stretched copies as in the whole
capture. A pair of views that the network first meets in a subset is matched then, and kept.
"""

import argparse
import pickle
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from zeroshop_steps.evaluate.camera_error import compare_cameras
from zeroshop_steps.geometry.cameras import LEAST_PAIRS, Camera, read_sparse_model
from zeroshop_steps.geometry.images import write_mask
from zeroshop_steps.geometry.sparse_files import write_reconstruction
from zeroshop_steps.networks.aliked import FeatureMatcher
from zeroshop_steps.networks.object_finder import cut_main_things
from zeroshop_steps.networks.salient_object import IMAGE_DEVIATION, IMAGE_MEAN, SalientObjectNetwork
from zeroshop_steps.register import aliked, auto, colmap, outlines
from zeroshop_steps.register.found_masks import find_object_maps
from zeroshop_steps.register.image_set import ImageSet, read_image_set
from zeroshop_steps.register.lenses import import_images
from zeroshop_steps.register.record import OBJECT_ONLY, RegistrationFailed
from zeroshop_steps.register.sift import SiftOptions, make_verification_options, write_pairs
from zeroshop_steps.register.structure import Stopwatch, StructureOptions
from zeroshop_steps.runtime.files import read_json, write_json
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


class StoredMatcher:
    """A network's features of all views, and the matches of the pairs that were asked for so far, kept in a file.

    Attributes:
        keypoints, similar: of all views, as `FeatureMatcher` has them.
    """

    def __init__(self, path: Path, prepare: Callable[[], FeatureMatcher]) -> None:
        self._path, self._prepare = path, prepare
        self._network: FeatureMatcher | None = None
        self._matches: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]] = {}
        if path.is_file():
            self.keypoints, self.similar, self._matches = pickle.loads(path.read_bytes())
        else:
            self._network = prepare()
            self.keypoints, self.similar = self._network.keypoints, self._network.similarities()

    def match(self, first: int, second: int) -> tuple[np.ndarray, np.ndarray]:
        """As `FeatureMatcher.match`, by the numbers among all views."""
        if (first, second) not in self._matches:
            self._network = self._network or self._prepare()
            self._matches[first, second] = self._network.match(first, second)
        return self._matches[first, second]

    def save(self) -> None:
        """Keep all that is known."""
        self._path.write_bytes(pickle.dumps((self.keypoints, self.similar, self._matches)))


@dataclass(frozen=True)
class SubsetMatcher:
    """What a network would say of some views: `FeatureMatcher` from what is stored of all."""

    stored: StoredMatcher
    numbers: np.ndarray

    @property
    def keypoints(self) -> list[np.ndarray]:
        """Of each view."""
        return [self.stored.keypoints[number] for number in self.numbers]

    def similarities(self) -> np.ndarray:
        """(N, N)."""
        return self.stored.similar[np.ix_(self.numbers, self.numbers)]

    def match(self, first: int, second: int) -> tuple[np.ndarray, np.ndarray]:
        """Of two views."""
        return self.stored.match(int(self.numbers[first]), int(self.numbers[second]))


@dataclass
class StoredCapture:
    """A capture with the features and matches of all its views; `read_matches` and `matcher` compute them where they are not kept yet.

    Attributes:
        network: finds the masks, in place of those that the renderer gave.
    """

    capture: Path
    folder: Path
    weights: Path
    network: Path | None = None
    images: ImageSet = field(init=False)
    truth: tuple[Camera, ...] = field(init=False)

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        self.images = read_image_set(self.capture)
        if self.network:
            self.images = replace(self.images, masks=self._find_masks(self.network), masks_found=True)
        self.truth = read_sparse_model(self.capture / "truth").cameras
        self._matcher: StoredMatcher | None = None

    @property
    def scene(self) -> str:
        """Its name in the path."""
        return self.capture.parent.name

    def _find_masks(self, network: Path) -> tuple[Path, ...]:
        paths = tuple(self.folder / "masks" / name for name in self.images.names)
        if not all(path.is_file() for path in paths):
            maps = find_object_maps(SalientObjectNetwork(network, IMAGE_MEAN, IMAGE_DEVIATION), self.images.images)
            for path, mask in zip(paths, cut_main_things(maps, self.images.sizes_px), strict=True):
                write_mask(path, mask)
        return paths

    def matcher(self) -> StoredMatcher:
        """ALIKED's features and LightGlue's matches."""
        if self._matcher is None:
            arguments = argparse.Namespace(device="auto", weights=self.weights, threads=1)
            options = aliked.AlikedOptions()
            prepare = aliked.make_matcher(arguments, options)
            self._matcher = StoredMatcher(self.folder / "aliked.pkl", lambda: prepare(aliked.cut_crops(self.images, options.side_px)))
        return self._matcher

    def read_matches(self, options: colmap.ColmapOptions) -> tuple[Path, dict[str, Any]]:
        """The database of SIFT's features and matches of all views, and its figures."""
        database, record = self.folder / "sift.db", self.folder / "sift.json"
        if not record.is_file():
            database.unlink(missing_ok=True)
            figures: dict[str, Any] = {}
            colmap.match_images(database, self.images, options, figures, Stopwatch())
            write_json(record, figures)
        return database, read_json(record)

    def save(self) -> None:
        """Keep what was matched."""
        if self._matcher is not None:
            self._matcher.save()


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


def copy_matches(stored: Path, database: Path, images: ImageSet, seed: int) -> None:
    """Write the features of some images and their matches from a database into a new one, and verify these by another seed."""
    import_images(database, images)
    pairs = []
    with pycolmap.Database.open(stored) as source, pycolmap.Database.open(database) as target:
        numbers = {name: (source.read_image_with_name(name).image_id, target.read_image_with_name(name).image_id) for name in images.names}
        for number, copied in numbers.values():
            target.write_keypoints(copied, source.read_keypoints(number))
        for place, one in enumerate(images.names):
            for other in images.names[place + 1 :]:
                if source.exists_matches(numbers[one][0], numbers[other][0]):
                    target.write_matches(numbers[one][1], numbers[other][1], source.read_matches(numbers[one][0], numbers[other][0]))
                    pairs.append((one, other))
    pycolmap.verify_matches(database, write_pairs(database, pairs), make_verification_options(seed))


def register_subset(stored: StoredCapture, numbers: np.ndarray, seed: int, attempts: Sequence[str], out: Path) -> dict[str, Any]:
    """Registration `auto` of some views, in a new folder `out`. Raises RegistrationFailed as it does."""
    images = restrict(stored.images, numbers)
    structure = StructureOptions(seed=seed, object_only=stored.scene in OBJECT_ONLY)
    scene = colmap.ColmapOptions(SiftOptions(seed=seed), structure)

    def match(database: Path, image_set: ImageSet, options: colmap.ColmapOptions, figures: dict[str, Any], _: Stopwatch) -> None:
        source, found = stored.read_matches(replace(options, sift=replace(options.sift, seed=0)))
        figures |= found
        copy_matches(source, database, image_set, options.sift.seed)

    learned = aliked.AlikedOptions(structure=structure)
    ways: dict[str, auto.Attempt] = {
        "colmap": lambda folder: colmap.register(images, folder, scene, match),
        "aliked": lambda folder: aliked.register(images, folder, learned, lambda crops: SubsetMatcher(stored.matcher(), numbers)),
        "outlines": lambda folder: outlines.register(images, folder, outlines.OutlineOptions(scene.sift, structure)),
    }
    out.mkdir(parents=True)
    return auto.register(out, {name: ways[name] for name in attempts})


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
