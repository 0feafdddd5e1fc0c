"""Register by MASt3R: a network's dense features are matched between pairs; then COLMAP's mapper and the same checks as for colmap.

Leroy et al., Grounding Image Matching in 3D with MASt3R, ECCV 2024; Duisterhof et al., MASt3R-SfM, 3DV 2025. Settings as in the
thesis: up to 20 images (30 without a surface) all pairs are matched; one shared camera with radial distortion; only keypoints
whose tracks have five images count. The network's weights have a licence of their own, which allows no commercial use.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import torch

from zeroshop_steps.networks.devices import choose_device
from zeroshop_steps.networks.mast3r.framing import LONG_SIDE_PX, Framing
from zeroshop_steps.networks.mast3r.inference import NAME, Mast3rPredictor, PairPredictor
from zeroshop_steps.networks.mast3r.matching import Matches, match_pair
from zeroshop_steps.networks.mast3r.model import SIZES, load_mast3r
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER, resolve_weights
from zeroshop_steps.register.matching.network_matches import PairMatches, write_matches
from zeroshop_steps.register.matching.pair_selection import choose_pairs
from zeroshop_steps.register.pipeline import StructureOptions, add_matching_arguments, read_structure_options, reconstruct
from zeroshop_steps.register.registration import add_network_arguments, add_options, read_options, write_registration
from zeroshop_steps.register.scene.image_set import ImageSet, mask_files, read_image_set, read_masks
from zeroshop_steps.register.scene.record import OBJECT_ONLY, Record
from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.runtime.files import scratch_directory
from zeroshop_steps.runtime.progress import track

CACHED = Cached(inputs=("capture/images", "capture/masks", "capture/cameras.json", "weights"), ignored=("threads", "device"))
# For images without a surface, which have fewer matches: more pairs, and less sure matches.
ANCHORS_WITHOUT_SURFACE = 30
CONFIDENCE_WITHOUT_SURFACE = 0.01


@dataclass(frozen=True)
class Mast3rOptions:
    """Parameters of the method.

    Attributes:
        object_only: pictures that are black outside the masks, and matches inside them only, for images without a surface.
        anchors: up to so many images all pairs are matched, beyond it those of pair_selection.choose_pairs.
        neighbours: of each image, beyond that.
        subsampling: pixels of the network's picture from one start of a match to the next.
        min_confidence: of the features of a match.
        min_track: images that a track must have for its keypoints to count.
        focal_px: known focal length; None reads EXIF, else estimates.
        structure: of the reconstruction.
    """

    object_only: bool = False
    anchors: int = 20
    neighbours: int = 10
    subsampling: int = 8
    min_confidence: float = 1.0
    min_track: int = 5
    focal_px: float | None = None
    structure: StructureOptions = field(default_factory=StructureOptions)


METHOD = {
    "title": "MASt3R",
    "rank": 2,
    "weights": ("MASt3R_ViTLarge_BaseDecoder_512_catmlpdpt_metric.pth",),
    "mem_mb": 6000,
    "runtime_min": 480,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_matching_arguments(parser)
    anchors, confidence = "up to so many images all pairs are matched; of se, 30", "of a match; of se, 0.01"
    add_options(parser, Mast3rOptions(), anchors=anchors, min_confidence=confidence, min_track="images of a track")
    side_help = "length of the network's pictures along the longer side (default: %(default)s)"
    parser.add_argument("--long-side-px", type=int, default=LONG_SIDE_PX, help=side_help)
    add_network_arguments(parser, WEIGHTS_FOLDER / NAME)


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    bare = args.scene in OBJECT_ONLY
    options = read_options(Mast3rOptions, args, object_only=bare, structure=read_structure_options(args))
    if bare:
        anchors, confidence = max(args.anchors, ANCHORS_WITHOUT_SURFACE), min(args.min_confidence, CONFIDENCE_WITHOUT_SURFACE)
        options = replace(options, anchors=anchors, min_confidence=confidence)
    device = torch.device(choose_device(args.device))
    weights = resolve_weights(args.weights, NAME, SIZES)
    image_set = read_image_set(args.capture)
    torch.set_num_threads(args.threads)

    def predictor() -> Mast3rPredictor:
        # Of photos in which the object was turned, the network must not see the ground, which stood still.
        masks = mask_files(image_set) if bare else None
        return Mast3rPredictor(load_mast3r(weights), image_set.images, device, args.long_side_px, masks)

    write_registration(args.out, lambda folder: register(image_set, folder, options, predictor))


def register(image_set: ImageSet, out: Path, options: Mast3rOptions, predictor: Callable[[], PairPredictor]) -> dict[str, Any]:
    """Estimate cameras and write images/, sparse/ and, where there are masks, masks/ to `out`; returns the record.

    Raises:
        RegistrationFailed: nothing matches, too few images, or an inconsistent model.
        StepError: the network cannot run.
    """
    record = Record.begin("mast3r", image_set, options, pycolmap, torch)
    prepared = predictor()
    record.stopwatch.lap("encode")
    keypoints, matches = match_images(prepared, image_set, options)
    record.stopwatch.lap("match")
    with scratch_directory(out, "mast3r") as scratch:
        database = scratch / "database.db"
        structure = options.structure
        kept = write_matches(database, image_set, keypoints, matches, options.min_track, structure.seed, options.focal_px)
        record = record.add(**kept)
        record.stopwatch.lap("verify")
        if not kept["matches"]:
            raise record.fail(
                f"the network finds no matches between the images, or none that {options.min_track} of them share; take more pictures"
                " with more overlap"
            )
        return dict(reconstruct(database, image_set, out, structure, record).entries)


def match_images(predictor: PairPredictor, image_set: ImageSet, options: Mast3rOptions) -> tuple[list[np.ndarray], PairMatches]:
    """Match the chosen pairs: keypoints of each image, in pixels of the image, and which of them match."""
    count = len(image_set.images)
    pairs = choose_pairs(count, options.anchors, options.neighbours, lambda: predictor.similarities().numpy())
    masks = read_masks(image_set) if options.object_only else None
    inside = (
        [_sample_mask(masks[name], framing) for name, framing in zip(image_set.names, predictor.framings, strict=True)] if masks else None
    )
    found: dict[tuple[int, int], Matches] = {}
    for pair in track(pairs, "matching pairs", len(pairs)):
        matches = match_pair(*predictor.pair(*pair), options.min_confidence, options.subsampling)
        if inside:
            kept = inside[pair[0]][tuple(matches.first.T[::-1])] & inside[pair[1]][tuple(matches.second.T[::-1])]
            matches = Matches(matches.first[kept], matches.second[kept], matches.confidence[kept])
        if len(matches.confidence):
            found[pair] = matches
    return merge_keypoints(found, predictor.framings)


def merge_keypoints(found: dict[tuple[int, int], Matches], framings: list[Framing]) -> tuple[list[np.ndarray], PairMatches]:
    """Give each pixel that is matched one number in its image, whatever the pair."""
    flat: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]] = {}
    used: list[list[np.ndarray]] = [[] for _ in framings]
    for (first, second), matches in found.items():
        ends = [
            pixels[:, 1] * framings[image].width_px + pixels[:, 0] for image, pixels in ((first, matches.first), (second, matches.second))
        ]
        flat[first, second] = (ends[0], ends[1])
        used[first].append(ends[0])
        used[second].append(ends[1])
    unique = [np.unique(np.concatenate(parts)) if parts else np.zeros(0, np.int64) for parts in used]
    keypoints = [
        framing.to_original(np.stack([pixels % framing.width_px, pixels // framing.width_px], axis=1) + 0.5)
        for framing, pixels in zip(framings, unique, strict=True)
    ]
    numbers = {
        (first, second): (np.searchsorted(unique[first], one), np.searchsorted(unique[second], other))
        for (first, second), (one, other) in flat.items()
    }
    return keypoints, numbers


def _sample_mask(mask: np.ndarray, framing: Framing) -> np.ndarray:
    """(height, width) bool: the mask where the network's pixels have their centres."""
    columns, rows = np.arange(framing.width_px) + 0.5, np.arange(framing.height_px) + 0.5
    x = framing.to_original(np.stack([columns, np.zeros_like(columns)], axis=1))[:, 0]
    y = framing.to_original(np.stack([np.zeros_like(rows), rows], axis=1))[:, 1]
    return mask[np.ix_(np.clip(y.astype(int), 0, mask.shape[0] - 1), np.clip(x.astype(int), 0, mask.shape[1] - 1))]
