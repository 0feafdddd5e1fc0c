"""Proposals: masks of everything in a photo, among which a detector looks for its objects."""

import argparse
from collections.abc import Callable

import cv2
import numpy as np
import torch

from zeroshop_steps.detect.cnos.segment_anything import SegmentAnything, drop_small_masks
from zeroshop_steps.networks.fastsam.masks import propose_masks
from zeroshop_steps.networks.fastsam.model import NAME, load_fastsam
from zeroshop_steps.networks.pretrained import require_model
from zeroshop_steps.networks.weights import require_weights

SEGMENTER, FILES = "sam-vit-huge", ("config.json", "model.safetensors")
PROPOSALS = ("sam", "fastsam")

Proposer = Callable[[np.ndarray], list[np.ndarray]]
"""Takes a (height, width, 3) uint8 photo and gives (height, width) bool masks that are not empty, the most confident first."""


def add_proposal_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of what proposes masks: SAM asked at a grid of points, or FastSAM in one pass, with the thesis's numbers."""
    parser.add_argument("--proposals", choices=PROPOSALS, default=PROPOSALS[0], help="(default: %(default)s)")
    parser.add_argument("--points-per-side", type=int, default=32, help="sam: points along each side of the grid (default: %(default)s)")
    parser.add_argument("--least-iou", type=float, default=0.88, help="sam: least predicted IoU of a proposal (default: %(default)s)")
    parser.add_argument("--least-stability", type=float, default=0.97, help="sam: least stability of a border (default: %(default)s)")
    parser.add_argument("--least-likelihood", type=float, default=0.05, help="fastsam: of a proposal (default: %(default)s)")
    parser.add_argument("--most-iou", type=float, default=0.9, help="fastsam: of the boxes of two proposals (default: %(default)s)")
    parser.add_argument("--most-proposals", type=int, default=200, help="fastsam: in an image (default: %(default)s)")
    parser.add_argument("--width-px", type=int, default=640, help="width of the segmented images (default: %(default)s)")


def load_proposer(args: argparse.Namespace, device: torch.device) -> Proposer:
    """What proposes masks by these options. Raises StepError if its weights are missing or damaged."""
    segment = _load_fastsam(args, device) if args.proposals == "fastsam" else _load_sam(args, device)

    def propose(photo: np.ndarray) -> list[np.ndarray]:
        masks = drop_small_masks(segment(_scale_photo(photo, args.width_px)))
        masks = [_resize_mask(mask, photo.shape[:2]) for mask in masks]
        return [mask for mask in masks if mask.any()]

    return propose


def _load_sam(args: argparse.Namespace, device: torch.device) -> Proposer:
    segmenter = SegmentAnything(require_model(SEGMENTER, FILES), device)
    options = {"points_per_side": args.points_per_side, "least_iou": args.least_iou, "least_stability": args.least_stability}
    return lambda photo: segmenter.segment(photo, **options)


def _load_fastsam(args: argparse.Namespace, device: torch.device) -> Proposer:
    network = load_fastsam(require_weights(NAME)).to(device)
    options = (args.least_likelihood, args.most_iou, args.most_proposals)
    return lambda photo: propose_masks(network, photo, device, max(photo.shape[:2]), *options)


def _scale_photo(photo: np.ndarray, width_px: int) -> np.ndarray:
    height = round(photo.shape[0] * width_px / photo.shape[1])
    smaller = width_px < photo.shape[1]
    return cv2.resize(photo, (width_px, height), interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR)


def _resize_mask(mask: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    if mask.shape == shape:
        return mask
    return cv2.resize(mask.astype(np.uint8) * 255, shape[::-1], interpolation=cv2.INTER_LINEAR) >= 128
