"""Join the passes of an object that was put down differently, upright and upside down, into one set of cameras.

Each pass was registered by its own ground and masked. What lies between two passes is found by the object alone: by its print, where
that matches across them, else by its outlines, else by learned features. A way counts where outlines and pictures agree, and only if no
other way is as good, or if its shape is the same in all. Otherwise nothing is joined, and the first pass stands alone with a warning.
"""

import argparse
import functools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.registered_views import PASSES
from zeroshop_steps.geometry.cameras.sparse_files import write_reconstruction
from zeroshop_steps.geometry.cameras.transforms import compute_scale
from zeroshop_steps.join.evidence import (
    LARGEST_MISS_PX,
    SAME_SIDE_DEG,
    Judgement,
    PassObservation,
    choose,
    judge_by_outlines,
    judge_ways,
    measure_turn_deg,
)
from zeroshop_steps.join.learned_matches import load_networks, match_by_networks
from zeroshop_steps.join.merging import merge_models, triangulate_joined
from zeroshop_steps.join.object_matches import match_object, pair_points, triangulate_pass
from zeroshop_steps.join.pass_images import Pass, gather, read_pass, repeats
from zeroshop_steps.join.pass_refinement import refine
from zeroshop_steps.join.ways import Way, find_ways_by_matches
from zeroshop_steps.networks.aliked import FOLDER
from zeroshop_steps.networks.devices import DEVICES
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER
from zeroshop_steps.register.aliked import Prepare
from zeroshop_steps.register.features.sift import SiftOptions
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.register.scene.record import describe_model, find_lens, read_registration
from zeroshop_steps.register.submodels.outline_alignment import measure_misses
from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.failures import Failure, how_to_try_again, read_failure
from zeroshop_steps.runtime.files import atomic_directory, scratch_directory, write_json

AXIS_DEG = 10.0  # of a turn's axis from the pass's up
MISS_PX = 1.0  # by which the outlines of a pass, turned, may miss its own in the mean, per 1000 px
MOST_TELLING = 20  # patches in what both passes see that tell places of the object apart: with more, it has print there
CACHED = Cached(inputs=("cameras", "weights"), ignored=("threads", "device"))
# A later pass that failed is left out.
READS_FAILURES = True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument(
        "--cameras", type=Path, nargs="+", required=True, help="registered cameras with masks of each pass, the first first"
    )
    parser.add_argument(
        "--weights", type=Path, default=WEIGHTS_FOLDER / FOLDER, help="folder of the learned features' weights (default: %(default)s)"
    )
    parser.add_argument("--device", choices=DEVICES, default="auto", help="where the networks run (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of RANSAC (default: %(default)s)")
    parser.add_argument("--threads", type=int, default=2, help="worker threads (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="cameras folder to write")


def run(args: argparse.Namespace) -> None:
    """Write the cameras of all passes that could be joined."""
    pycolmap.logging.minloglevel = pycolmap.logging.ERROR
    prepare = load_networks(args)
    failed = {number: failure for number, folder in enumerate(args.cameras, start=1) if (failure := read_failure(folder))}
    if 1 in failed:
        raise StepError(explain_first_failure(failed[1]))
    folders = {number: folder for number, folder in enumerate(args.cameras, start=1) if number not in failed}
    records = [read_registration(folder) for folder in folders.values()]
    first, *later = [read_pass(number, folder) for number, folder in folders.items()]
    repeated = [one for one in later if repeats(first, one)]
    left_out = [describe_failure(number, failure) for number, failure in failed.items()]
    left_out += [describe_pass(one, [], reason=explain_repetition(one.number)) for one in repeated]
    passes = [first, *(one for one in later if one not in repeated)]
    with atomic_directory(args.out) as folder:
        figures = join(passes, folder, SiftOptions(threads=args.threads, seed=args.seed), left_out, prepare)
        lenses = join_lenses({one.number: record for one, record in zip([first, *later], records, strict=True)}, [first, *later])
        write_json(folder / "registration.json", records[0] | figures | {"images": sum(record["images"] for record in records)} | lenses)
    for line in figures["warnings"]:
        warn(line)


def join_lenses(records: Mapping[int, Mapping[str, Any]], passes: Sequence[Pass]) -> dict[str, Any]:
    """The lenses that the photos of all passes had before they were undistorted, as registration.json has them."""
    lenses = {
        Path(name).stem: find_lens(records[one.number], path.stem) for one in passes for name, path in sorted(one.images.items())
    }  # fmt: skip
    return {"lens": None, "lenses": {stem: lens for stem, lens in lenses.items() if lens}}


def join(
    passes: list[Pass], out: Path, options: SiftOptions, left_out: list[dict[str, Any]], prepare: Prepare | None = None
) -> dict[str, Any]:
    """Write images/, masks/, sparse/ and passes.json of the passes that fit to the first; returns entries of registration.json.

    Args:
        passes: pass 1, and those that may be joined to it.
        out: folder to write into.
        options: of the features that are matched across passes.
        left_out: the entries of passes.json of the others.
        prepare: what finds learned features, for passes that neither print nor outlines join; None without.
    """
    start_s = time.monotonic()
    kept, model, described = passes[:1], passes[0].model, [*left_out, describe_pass(passes[0], [])]
    if len(passes) > 1:
        with scratch_directory(out, "join") as scratch:
            kept, model, compared = _join_later(passes, scratch, options, prepare)
        described += compared
    write_reconstruction(model, out / "sparse")
    gather(kept, out)
    described.sort(key=lambda entry: entry["number"])
    write_json(out / PASSES, {"passes": described})
    warnings = [entry["reason"] for entry in described if entry["reason"]]
    return {**describe_model(model), "passes": described, "warnings": warnings, "join_seconds": round(time.monotonic() - start_s, 2)}


@dataclass(frozen=True)
class _Matches:
    """Matched features of all passes: their database, and the points that each pass sees, in its own frame."""

    database: Path
    models: list[pycolmap.Reconstruction]

    @classmethod
    def of(cls, database: Path, passes: list[Pass], image_set: ImageSet, seed: int) -> "_Matches":
        """Triangulate the features of a database."""
        return cls(database, [triangulate_pass(database, one, image_set, seed) for one in passes])

    def find_ways(self, number: int, seed: int) -> list[Way]:
        """The ways in which a pass may lie to the first, by points that match."""
        pairs = pair_points(self.database, self.models[0], self.models[number])
        return [refine(way, pairs, self.models[0], self.models[number]) for way in find_ways_by_matches(pairs, seed)]


def _join_later(
    passes: list[Pass], scratch: Path, options: SiftOptions, prepare: Prepare | None
) -> tuple[list[Pass], pycolmap.Reconstruction, list[dict[str, Any]]]:
    """The passes that fit to the first, and it; the model of them all; and the entries of passes.json of the later ones."""
    image_set = gather(passes, scratch)
    matches = _Matches.of(match_object(image_set, passes, scratch, options), passes, image_set, options.seed)
    sights = [PassObservation.of(one) for one in passes]

    match_again = None
    if prepare:
        match_again = functools.cache(functools.partial(_match_by_networks, image_set, passes, scratch, prepare, options.seed))
    kept, placed, described = [passes[0]], [np.eye(4)], []
    for number, (other, sight) in enumerate(zip(passes[1:], sights[1:], strict=True), start=1):
        find_others = functools.cache(functools.partial(judge_by_outlines, sights[0], sight))
        found = judge_ways(matches.find_ways(number, options.seed), sights[0], sight, find_others)
        if choose(found) is None and match_again:
            again = judge_ways(match_again().find_ways(number, options.seed), sights[0], sight, find_others)
            found = again if choose(again) else found
        right = choose(found) or choose_any(found, sights[0], sight)
        if right is None:
            described.append(describe_pass(other, found, reason=explain(other.number, found)))
            continue
        kept.append(other)
        placed.append(right.way.target_from_source)
        described.append(describe_pass(other, found, right, explain_joined(other.number, right, sights[0], sight)))
    if len(kept) == 1:
        return kept, passes[0].model, described
    joined = triangulate_joined(matches.database, kept, placed, image_set, options.seed, scratch / "joined")
    return kept, merge_models(joined, passes[0]), described


def _match_by_networks(image_set: ImageSet, passes: list[Pass], scratch: Path, prepare: Prepare, seed: int) -> _Matches:
    return _Matches.of(match_by_networks(image_set, passes, scratch / "learned", prepare, seed), passes, image_set, seed)


def describe_pass(one: Pass, found: list[Judgement], right: Judgement | None = None, reason: str | None = None) -> dict[str, Any]:
    """The entry of passes.json; `reason` says why it was left out, or why it brings little."""
    return {
        "number": one.number,
        "images": sorted(one.images),
        "joined": one.number == 1 or right is not None,
        "reason": reason,
        "ways": [judgement.figures() for judgement in found],
    }


def describe_failure(number: int, failure: Failure) -> dict[str, Any]:
    """The entry of passes.json of a pass that was not registered."""
    return {"number": number, "images": [], "joined": False, "reason": explain_failure(number, failure), "ways": []}


def choose_any(found: list[Judgement], target: PassObservation, source: PassObservation) -> Judgement | None:
    """The way that fits best, where several fit, none is known to be right, and the shape is the same in all; else None."""
    possible = sorted((one for one in found if one.verdict != "wrong"), key=lambda one: one.miss_px)
    if len(possible) < 2 or any(one.verdict == "right" or one.likeness.telling > MOST_TELLING for one in possible):
        return None
    best, *others = possible
    for other in others:
        turns = (
            (source, np.linalg.inv(best.way.target_from_source) @ other.way.target_from_source),
            (target, best.way.target_from_source @ np.linalg.inv(other.way.target_from_source)),
        )
        if not all(fits_itself(*turn) for turn in turns):
            return None
    return best


def fits_itself(sight: PassObservation, turn: np.ndarray) -> bool:
    """Whether a pass has the same outlines after a turn, a (4, 4) similarity in its own frame, about its upright axis."""
    vector = Rotation.from_matrix(turn[:3, :3] / compute_scale(turn)).as_rotvec()
    upright = abs(vector @ sight.group.up) >= np.cos(np.radians(AXIS_DEG)) * np.linalg.norm(vector)
    return bool(upright and measure_misses(sight.group, sight.group, turn).mean() <= MISS_PX)


def explain(number: int, found: list[Judgement]) -> str:
    """Why a pass could not be joined, and what helps."""
    left_out = _leave_out(number)
    if sum(one.verdict != "wrong" for one in found) > 1:
        return f"pass {number} fits to pass 1 in several ways, because sides of the object look alike: {left_out}"
    if not found or (found[0].miss_px > LARGEST_MISS_PX and found[0].elsewhere_px is not None):
        return (
            f"neither print nor outlines of the object in pass {number} fit to pass 1: {left_out}. Film both passes from low enough that"
            " the sides are seen in both, or lay the object on its side; was it the same object, and are the masks right?"
        )
    if found[0].miss_px > LARGEST_MISS_PX:
        return f"print matches, but the outlines of pass {number} contradict those of pass 1: {left_out}. Has the object changed its shape?"
    if found[0].verdict == "wrong":
        return (
            f"the outlines of pass {number} fit to pass 1, but where the passes lie on each other the pictures differ: {left_out}."
            " Take both passes in the same soft light, without highlights; was it the same object?"
        )
    return f"pass {number} fits to pass 1, but too little print shows that it is right: {left_out}"


def explain_repetition(number: int) -> str:
    """Why a pass whose pictures are those of the first was left out."""
    return f"the pictures of pass {number} are those of pass 1: {_leave_out(number)}. Turn the object over and capture it again"


def explain_failure(number: int, failure: Failure) -> str:
    """Why a later pass that has no cameras was left out."""
    return f"pass {number} failed ({failure.reason}): {_leave_out(number)}. {how_to_try_again(failure.place)}"


def explain_first_failure(failure: Failure) -> str:
    """Why nothing was joined: the frame and the height are those of the first pass."""
    return (
        f"pass 1, in whose frame all stand and of which the height is known, failed ({failure.reason}). Capture it again, or give another"
        f" pass alone. {how_to_try_again(failure.place)}"
    )


def explain_joined(number: int, chosen: Judgement, first: PassObservation, other: PassObservation) -> str | None:
    """What a pass that was joined leaves unknown; None where it leaves nothing."""
    if chosen.verdict != "right":
        return (
            f"pass {number} fits to pass 1 in several turns about its upright axis, and in each it has the same shape: one was taken. How"
            " print that only one of the passes shows lies to that of the other stays unknown"
        )
    if measure_turn_deg(chosen.way, first, other) > SAME_SIDE_DEG:
        return None
    return (
        f"in pass {number} the object stands as in pass 1, so its underside stays unknown: both are used, but turn the object over for"
        " the second pass"
    )


def _leave_out(number: int) -> str:
    return f"pass {number} is left out, and what only it shows stays unknown"
