"""Models whose truth is known, right and wrong ones, with the findings about them: what the verdict on cameras is fitted on.

Each capture is matched as a whole scene, and by the object alone, with true masks and with those of a network. Of each set of matches,
several models are made: of all images, of some that follow each other, of some drawn at random, of few matches, and of two halves that few
matches hold together. Objects alone, with rough masks and few matches, give wrong models of all kinds: bent, torn apart, with single images
astray. Objects whose sides look alike (alike_objects.py) give folded ones.
"""

import random
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pycolmap

from zeroshop_steps.evaluate.camera_error import compare_cameras
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model, take_cameras
from zeroshop_steps.networks.saliency.object_finder import cut_main_things
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.register.colmap import ColmapOptions, match_images
from zeroshop_steps.register.features.sift import SiftOptions, fit_to_count
from zeroshop_steps.register.final_checks import FinalChecks
from zeroshop_steps.register.final_refinement import Hypothesis, Improver
from zeroshop_steps.register.mapping.mapper import make_mapping_options, map_incrementally
from zeroshop_steps.register.mapping.reregistration import refine_robustly
from zeroshop_steps.register.pipeline import WRONG_MASKS_OF_OBJECT, StructureOptions, improve, refine_and_repair
from zeroshop_steps.register.scene.database import delete_pair
from zeroshop_steps.register.scene.image_set import ImageSet, read_image_set
from zeroshop_steps.register.scene.record import Record, Stopwatch
from zeroshop_steps.register.scene.undistortion import undistort
from zeroshop_steps.register.verification.consistency import ConsistencyLimits, check_consistency, find_jump
from zeroshop_steps.register.verification.duplicate_structure import MayMatch
from zeroshop_steps.register.verification.predicted_masks import find_object_maps, mask_images
from zeroshop_steps.runtime.files import read_json

FEWEST = 5  # images of a model
KINDS = {"scene": ("all", "hinge"), "true_masks": ("all", "few", "hinge"), "found_masks": ("all", "row", "few_1")}
ALIKE_KINDS = {"scene": ("all", "row"), "true_masks": ("all", "row", "draw", "row_1", "few_1")}
"""Of the models that are made, by how the matches were found; `ALIKE_KINDS` of objects whose sides look alike."""
ENOUGH_FEATURES, MOST_FEATURES = 300, 800  # of an image, where models are not refined: those of few points are made soon
FEW_MATCHES = {"few": 25, "few_1": 60}  # of a pair, at most, as objects with little print give
HINGE_MATCHES, HINGE_PAIRS = 20, 3  # that hold two halves together


@dataclass(frozen=True)
class Matches:
    """Verified matches of a capture.

    Attributes:
        name: of how they were found.
        database: COLMAP's.
        image_set: the images, with the masks that gave the matches, if there are any.
        may_match: whether two images may show the same after all.
    """

    name: str
    database: Path
    image_set: ImageSet
    may_match: MayMatch | None


def sample(capture: Path, network: SalientObjectNetwork | None, scratch: Path, refined: bool = True) -> Iterator[dict[str, Any]]:
    """Models of a capture, each as a row: how wrong it is, {measure: strength} of what was found, and all figures.

    Args:
        capture: folder with capture/ (images/, truth/ with cameras and masks/) and model/model_info.json.
        network: finds masks; without one, the sides of the object look alike.
        scratch: an empty folder.
        refined: whether features are many, and models repaired and refined, which takes most of the time.
    """
    truth = read_sparse_model(capture / "capture" / "truth").cameras
    diameter_mm = read_json(capture / "model" / "model_info.json")["diameter"]
    kinds = KINDS if network else ALIKE_KINDS
    for matches in match_in_all_ways(capture, network, scratch, refined):
        for kind, database, image_set in choose_images(matches, kinds[matches.name], scratch / matches.name, random.Random(capture.name)):
            begun_s, folder = time.monotonic(), database.parent
            by_object, found = image_set.masks is not None, image_set.masks_found
            limits = ConsistencyLimits(wrong_masks_share=WRONG_MASKS_OF_OBJECT) if found else ConsistencyLimits()
            structure = StructureOptions(object_only=by_object and not found, leave_out=True, limits=limits)
            model = map_incrementally(database, image_set.images[0].parent, folder / "models", make_mapping_options(FEWEST, 0))
            if model is None:
                continue
            check = partial(check_consistency, image_set=image_set, database=database, limits=limits, doubt_masks=structure.doubt_masks)
            if refined:
                hypothesis = refine_and_repair(model, image_set, database, folder, structure)
            else:
                refine_robustly(model)
                hypothesis = Hypothesis(model, check(model))
            if refined and not hypothesis.report.is_doubtful:
                improver = Improver(image_set, check, hypothesis.registered)
                hypothesis, _ = improve(improver, hypothesis, by_object, Record())
            if hypothesis.registered < FEWEST:
                continue
            pinhole_model = undistort(hypothesis.model, image_set, folder / "out")
            asked = FinalChecks(folder / "out", database, matches.may_match, by_object)
            strengths, figures = {}, {}
            for ask in asked.about(hypothesis, pinhole_model):
                evidence = ask()
                strengths |= {finding.measure: finding.strength for finding in evidence.findings}
                figures |= evidence.entries
            jump = find_jump(hypothesis.model)
            error = compare_cameras(list(take_cameras(pinhole_model)), truth)
            yield {
                "matches": matches.name,
                "kind": kind,
                "images": len(image_set.images),
                "registered": len(error.names),
                "mean_error": float(error.centre_mm.mean()) / diameter_mm,
                "worst_error": float(error.centre_mm.max()) / diameter_mm,
                "strengths": strengths,
                "jump": jump.strength if jump else 0.0,
                "figures": figures,
                "fault": hypothesis.report.fault is not None,
                "errors": (error.centre_mm / diameter_mm).round(5).tolist(),
                "seconds": round(time.monotonic() - begun_s, 1),
            }
            shutil.rmtree(folder)


def match_in_all_ways(capture: Path, network: SalientObjectNetwork | None, scratch: Path, many: bool) -> Iterator[Matches]:
    """Matches of the object alone, and of the whole scene; of as many features as a registration has, or of few."""
    whole = read_image_set(capture / "capture")
    true_masks = tuple(capture / "capture" / "truth" / "masks" / f"{path.stem}.png" for path in whole.images)
    ways = {"true_masks": replace(whole, masks=true_masks), "scene": whole}
    if network:
        found = scratch / "found"
        found.mkdir()
        maps = cut_main_things(find_object_maps(network, whole.images), whole.sizes_px)
        ways["found_masks"] = mask_images(whole, maps, network, found)
    for name, image_set in ways.items():
        folder = scratch / name
        folder.mkdir()
        structure = StructureOptions(object_only=image_set.masks is not None, leave_out=True)
        few = SiftOptions(threads=1, max_features=MOST_FEATURES, enough_features=ENOUGH_FEATURES)
        sift = fit_to_count(SiftOptions(threads=1), len(image_set.images)) if many else few
        options = ColmapOptions(sift, structure)
        graph = match_images(folder / "database.db", image_set, options, Stopwatch())
        yield Matches(name, folder / "database.db", image_set, graph.may_match())


def choose_images(matches: Matches, kinds: Sequence[str], scratch: Path, draw: random.Random) -> Iterator[tuple[str, Path, ImageSet]]:
    """A database of some images and matches of a capture, for each kind of model: its kind, the database, and the images."""
    names = matches.image_set.names
    for kind in kinds:
        chosen, count = list(names), draw.randint(max(FEWEST + 1, len(names) // 2), max(FEWEST + 1, len(names) - 1))
        if kind.startswith("row"):  # around a ring, which the photos may close
            first = draw.randrange(len(names))
            chosen = sorted({names[(first + step) % len(names)] for step in range(count)})
        elif kind.startswith("draw"):
            chosen = sorted(draw.sample(names, min(count, len(names))))
        folder = scratch / kind
        folder.mkdir()
        database = Path(shutil.copy(matches.database, folder / "database.db"))
        with pycolmap.Database.open(database) as opened:
            by_id = {image.image_id: image.name for image in opened.read_all_images()}
            pairs, found_geometries = opened.read_two_view_geometries()
            geometries = dict(zip(map(pycolmap.pair_id_to_image_pair, pairs), found_geometries, strict=True))
            halves = {number: name in names[: len(names) // 2] for number, name in by_id.items()}
            across = [ends for ends, found in geometries.items() if halves[ends[0]] != halves[ends[1]] and len(found.inlier_matches)]
            held = {ends: HINGE_MATCHES for ends in draw.sample(across, min(len(across), HINGE_PAIRS))}
            for ends, geometry in geometries.items():
                found = geometry.inlier_matches
                most = FEW_MATCHES.get(kind, len(found))
                if kind == "hinge" and ends in across:
                    most = held.get(ends, 0)
                if not {by_id[end] for end in ends} <= set(chosen):
                    delete_pair(opened, *ends)
                elif most < len(found):
                    geometry.inlier_matches = found[sorted(draw.sample(range(len(found)), most))]
                    delete_pair(opened, *ends)
                    if most:
                        opened.write_two_view_geometry(*ends, geometry)
        yield kind, database, matches.image_set.take([number for number, name in enumerate(names) if name in chosen])
