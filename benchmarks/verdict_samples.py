"""Models whose truth is known, right and wrong ones, with the findings about them: what the verdict on cameras is fitted on.

Each capture is matched as a whole scene, and by the object alone, with true masks and with those of a network. Of each set of matches,
several models are made: of all images, of some that follow each other, and of some drawn at random. Objects alone, with rough masks and few
matches, give wrong models of all kinds: folded, bent, torn apart, with single images astray.
"""

import random
import shutil
from collections.abc import Iterator
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
from zeroshop_steps.register.final_refinement import Improver
from zeroshop_steps.register.mapping.mapper import make_mapping_options, map_incrementally
from zeroshop_steps.register.pipeline import StructureOptions, improve, refine_and_repair
from zeroshop_steps.register.scene.database import delete_pair
from zeroshop_steps.register.scene.image_set import ImageSet, read_image_set
from zeroshop_steps.register.scene.record import Record, Stopwatch
from zeroshop_steps.register.scene.undistortion import undistort
from zeroshop_steps.register.verification.consistency import check_consistency
from zeroshop_steps.register.verification.duplicate_structure import MayMatch
from zeroshop_steps.register.verification.predicted_masks import find_object_maps, mask_images
from zeroshop_steps.runtime.files import read_json

FEWEST = 5  # images of a model
SUBSETS = 4  # of the images of a capture, beside all of them
FEW_MATCHES = (60, 25)  # of a pair, at most, as objects with little print give


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


def sample(capture: Path, network: SalientObjectNetwork, scratch: Path) -> Iterator[dict[str, Any]]:
    """Models of a capture, each as a row: how wrong it is, and {measure: strength} of what was found.

    Args:
        capture: folder with capture/ (images/, truth/ with cameras and masks/) and model/model_info.json.
        network: finds masks.
        scratch: an empty folder.
    """
    truth = read_sparse_model(capture / "capture" / "truth").cameras
    diameter_mm = read_json(capture / "model" / "model_info.json")["diameter"]
    for matches in match_in_all_ways(capture, network, scratch):
        for kind, database, image_set in choose_images(matches, scratch / matches.name, random.Random(capture.name)):
            folder = database.parent
            structure = StructureOptions(object_only=matches.image_set.masks is not None, leave_out=True)
            model = map_incrementally(database, image_set.images[0].parent, folder / "models", make_mapping_options(FEWEST, 0))
            if model is None:
                continue
            hypothesis = refine_and_repair(model, image_set, database, folder, structure)
            if not hypothesis.report.is_doubtful:
                check = partial(check_consistency, image_set=image_set, database=database, limits=structure.limits, doubt_masks=False)
                improver = Improver(image_set, check, hypothesis.registered)
                hypothesis, _ = improve(improver, hypothesis, structure.object_only, Record())
            if hypothesis.registered < FEWEST:
                continue
            pinhole_model = undistort(hypothesis.model, image_set, folder / "out")
            asked = FinalChecks(folder / "out", database, matches.may_match, structure.object_only)
            strengths = {}
            for check in asked.about(hypothesis, pinhole_model):
                strengths |= {finding.measure: finding.strength for finding in check().findings}
            error = compare_cameras(list(take_cameras(pinhole_model)), truth)
            yield {
                "matches": matches.name,
                "kind": kind,
                "images": len(image_set.images),
                "registered": len(error.names),
                "mean_error": float(error.centre_mm.mean()) / diameter_mm,
                "worst_error": float(error.centre_mm.max()) / diameter_mm,
                "strengths": strengths,
            }
            shutil.rmtree(folder)


def match_in_all_ways(capture: Path, network: SalientObjectNetwork, scratch: Path) -> Iterator[Matches]:
    """Matches of the whole scene, and of the object alone."""
    whole = read_image_set(capture / "capture")
    true_masks = tuple(capture / "capture" / "truth" / "masks" / f"{path.stem}.png" for path in whole.images)
    found = scratch / "found"
    found.mkdir()
    ways = {
        "scene": whole,
        "true_masks": replace(whole, masks=true_masks),
        "found_masks": mask_images(whole, cut_main_things(find_object_maps(network, whole.images), whole.sizes_px), network, found),
    }
    for name, image_set in ways.items():
        folder = scratch / name
        folder.mkdir()
        structure = StructureOptions(object_only=image_set.masks is not None, leave_out=True)
        options = ColmapOptions(fit_to_count(SiftOptions(threads=1), len(image_set.images)), structure)
        graph = match_images(folder / "database.db", image_set, options, Stopwatch())
        yield Matches(name, folder / "database.db", image_set, graph.may_match())


def choose_images(matches: Matches, scratch: Path, draw: random.Random) -> Iterator[tuple[str, Path, ImageSet]]:
    """All images of a capture, some of them, and all with few of their matches: a name, a database of these alone, and the images."""
    names = matches.image_set.names
    choices = {"all": names}
    for number in range(SUBSETS if len(names) > FEWEST + 2 else 0):
        count = draw.randint(FEWEST + 1, len(names) - 1)
        start = draw.randrange(len(names) - count + 1)
        choices[f"some_{number}"] = names[start : start + count] if number % 2 else sorted(draw.sample(names, count))
    choices |= {f"few_{count}": names for count in FEW_MATCHES}
    for kind, chosen in choices.items():
        folder = scratch / kind
        folder.mkdir()
        database = Path(shutil.copy(matches.database, folder / "database.db"))
        with pycolmap.Database.open(database) as opened:
            by_id = {image.image_id: image.name for image in opened.read_all_images()}
            for pair, geometry in zip(*opened.read_two_view_geometries(), strict=True):
                ends = pycolmap.pair_id_to_image_pair(pair)
                found, most = (
                    geometry.inlier_matches,
                    int(kind.removeprefix("few_")) if kind.startswith("few") else len(geometry.inlier_matches),
                )
                if not {by_id[end] for end in ends} <= set(chosen):
                    delete_pair(opened, *ends)
                elif most < len(found):
                    geometry.inlier_matches = found[sorted(draw.sample(range(len(found)), most))]
                    delete_pair(opened, *ends)
                    opened.write_two_view_geometry(*ends, geometry)
        yield kind, database, matches.image_set.take([number for number, name in enumerate(names) if name in chosen])
