"""Detect without any network: regions between edges of depth and colour are compared with views of the models.

Large planes are removed. Basins between depth jumps, creases and colour edges are merged step by step, and every region on the way is
a proposal. Its size, silhouette, relief, colours and gradients are compared at true scale with 42 views of each model in all in-plane
rotations. The confidence means the same for every object. Needs RGB-D images. Writes BOP's COCO JSON.
"""

import argparse
from dataclasses import replace

import cv2
import numpy as np

from zeroshop_steps.bop.formats.bop_scenes import Frame
from zeroshop_steps.bop.formats.models import ObjectModel
from zeroshop_steps.detect.contour.depth_surface import prepare_surface
from zeroshop_steps.detect.contour.descriptors import linear_rgb, make_region_patch
from zeroshop_steps.detect.contour.edges import detect_edges
from zeroshop_steps.detect.contour.regions import RegionProposal, propose_regions
from zeroshop_steps.detect.contour.template_matching import ReferenceViews, describe_reference, estimate_confidences
from zeroshop_steps.detect.detector_io import (
    LEAST_CONFIDENCE,
    Detector,
    ObjectMask,
    ViewsOf,
    add_image_arguments,
    detect_in_files,
    read_depth,
    read_photo,
    suppress_masks,
)

NO_DEPTH = "and this detector needs depth: add depth images, or use --method cnos, which needs colour only"
MOST_CANDIDATES = 40  # regions of an object in an image that are considered, before doubles are dropped
PART_IOU = 0.5  # of two detections of an object; with more, the less confident one is dropped. A part and the whole overlap by less

METHOD = {"rank": 0, "mem_mb": 3000, "runtime_min": 60, "threads": 1}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_image_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Detect the models of a folder in the images of a split."""
    detect_in_files(args, prepare)


def prepare(args: argparse.Namespace, models: dict[int, ObjectModel], views_of: ViewsOf) -> Detector:
    """The detector of these models; it has no options."""
    references = {number: describe_reference(views_of(number), model.diameter_mm) for number, model in models.items()}
    return lambda frame: detect_objects(frame, references)


def detect_objects(frame: Frame, references: dict[int, ReferenceViews]) -> list[ObjectMask]:
    """Detect the objects in one image."""
    photo = read_photo(frame)
    largest_mm = max(reference.diameter_mm for reference in references.values())
    surface = prepare_surface(read_depth(frame, photo, NO_DEPTH), frame.intrinsics, largest_mm, frame.name)
    lab = cv2.cvtColor(photo.astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
    proposals = propose_regions(surface, detect_edges(surface, lab))
    linear, focal_px = linear_rgb(photo), float(np.sqrt(frame.intrinsics[0, 0] * frame.intrinsics[1, 1]))
    patches = [make_region_patch(one.mask, linear[one.window], surface.depth_mm[one.window], focal_px) for one in proposals]
    scores = estimate_confidences(patches, np.array([(one.border, one.inside) for one in proposals]).reshape(-1, 2), references)
    found = []
    for number, mine in zip(references, scores.T, strict=True):
        best = [index for index in np.argsort(-mine, kind="stable")[:MOST_CANDIDATES] if mine[index] >= LEAST_CONFIDENCE]
        masks = [_paste_mask(proposals[index], photo.shape[:2]) for index in best]
        found += [ObjectMask(number, float(mine[best[kept]]), masks[kept]) for kept in suppress_masks(masks, mine[best], PART_IOU)]
    return discount_explained(found)


def discount_explained(found: list[ObjectMask]) -> list[ObjectMask]:
    """The detections, each with its confidence reduced by the share of its mask that more confident ones explain."""
    found = sorted(found, key=lambda one: -one.score)
    if not found:
        return found
    flat = np.stack([one.mask.ravel() for one in found]).astype(np.float32)
    covered = flat @ flat.T / flat.sum(1)[:, None]
    scores = np.array([one.score for one in found])
    for index in range(1, len(found)):
        scores[index] *= np.prod(1 - scores[:index] * covered[index, :index])
    return [replace(one, score=float(score)) for one, score in zip(found, scores, strict=True)]


def _paste_mask(proposal: RegionProposal, shape: tuple[int, int]) -> np.ndarray:
    """The mask of a proposal in the whole image."""
    mask = np.zeros(shape, bool)
    mask[proposal.window] = proposal.mask
    return mask
