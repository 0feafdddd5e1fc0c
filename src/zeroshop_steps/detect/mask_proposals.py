"""The networks of CNOS and of SAM-6D's instance segmentation: what proposes masks of everything in a photo, and what describes them."""

import argparse
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import torch

from zeroshop_steps.detect.cnos.crops import CropDescriber
from zeroshop_steps.detect.cnos.segment_anything import SegmentAnything, drop_small_masks
from zeroshop_steps.networks.devices import PROCESS_BYTES, MemoryNeeds, check_memory
from zeroshop_steps.networks.fastsam.masks import propose_masks
from zeroshop_steps.networks.fastsam.model import NAME, SIZES, load_fastsam
from zeroshop_steps.networks.pretrained import WEIGHTS_FILE, require_model
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER, resolve_weights

SEGMENTER, DESCRIBER, FILES = "sam-vit-huge", "dinov2-large", ("config.json", WEIGHTS_FILE)
PROPOSALS = ("sam", "fastsam")
CROPS_BYTES = 300_000_000
"""Of the views of a model and DINOv2 on the crops that go through it together, beside the process itself; measured."""
FASTSAM_BYTES = 600_000_000
"""Of FastSAM with its weights; measured."""
ATTENTION_COPIES = 4
"""Of the largest matrix of attention in SAM: three were measured, with hardly a mask in the image, and one is for many masks."""

Proposer = Callable[[np.ndarray], list[np.ndarray]]
"""Takes a (height, width, 3) uint8 photo and gives (height, width) bool masks that are not empty, the most confident first."""


def add_network_arguments(parser: argparse.ArgumentParser) -> None:
    """What proposes masks, SAM asked at a grid of points or FastSAM in one pass, with the thesis's numbers, and what describes them."""
    parser.add_argument("--proposals", choices=PROPOSALS, default=PROPOSALS[0], help="(default: %(default)s)")
    parser.add_argument("--points-per-side", type=int, default=32, help="sam: points along each side of the grid (default: %(default)s)")
    parser.add_argument("--least-iou", type=float, default=0.88, help="sam: least predicted IoU of a proposal (default: %(default)s)")
    parser.add_argument("--least-stability", type=float, default=0.97, help="sam: least stability of a border (default: %(default)s)")
    parser.add_argument("--least-likelihood", type=float, default=0.05, help="fastsam: of a proposal (default: %(default)s)")
    parser.add_argument("--most-iou", type=float, default=0.9, help="fastsam: of the boxes of two proposals (default: %(default)s)")
    parser.add_argument("--most-proposals", type=int, default=200, help="fastsam: in an image (default: %(default)s)")
    parser.add_argument("--describer", default=DESCRIBER, help="folder of DINOv2 below resources/weights (default: %(default)s)")
    parser.add_argument("--width-px", type=int, default=640, help="width of the segmented images (default: %(default)s)")


def load_networks(args: argparse.Namespace, device: torch.device) -> tuple[Proposer, CropDescriber]:
    """What proposes masks by these options, and what describes them.

    Raises:
        StepError: weights are missing or damaged, or memory would not do.
    """
    fast = args.proposals == "fastsam"
    weights = resolve_weights(WEIGHTS_FOLDER / NAME, NAME, SIZES) if fast else require_model(SEGMENTER, FILES)
    describer = require_model(args.describer, FILES)
    check_memory(predict_memory(describer, None if fast else weights), device)
    segment = _load_fastsam(args, weights, device) if fast else _load_sam(args, weights, device)

    def propose(photo: np.ndarray) -> list[np.ndarray]:
        masks = drop_small_masks(segment(_scale_photo(photo, args.width_px)))
        masks = [_resize_mask(mask, photo.shape[:2]) for mask in masks]
        return [mask for mask in masks if mask.any()]

    return propose, CropDescriber(describer, device)


def predict_memory(describer: Path, segmenter: Path | None) -> MemoryNeeds:
    """Memory at the peak with the networks in these folders; FastSAM proposes where there is no segmenter."""
    peak = PROCESS_BYTES + CROPS_BYTES + (describer / WEIGHTS_FILE).stat().st_size
    if segmenter is None:
        return MemoryNeeds(peak + FASTSAM_BYTES, "FastSAM with DINOv2", "free memory, or use the detector contour, which needs no network")
    from transformers import SamConfig

    vision = SamConfig.from_pretrained(segmenter).vision_config
    attention = 4 * vision.num_attention_heads * (vision.image_size // vision.patch_size) ** 4
    peak += (segmenter / WEIGHTS_FILE).stat().st_size + ATTENTION_COPIES * attention
    return MemoryNeeds(peak, "SAM with DINOv2", "free memory, or use --proposals fastsam, which needs less, or the detector contour")


def _load_sam(args: argparse.Namespace, folder: Path, device: torch.device) -> Proposer:
    segmenter = SegmentAnything(folder, device)
    options = {"points_per_side": args.points_per_side, "least_iou": args.least_iou, "least_stability": args.least_stability}
    return lambda photo: segmenter.segment(photo, **options)


def _load_fastsam(args: argparse.Namespace, path: Path, device: torch.device) -> Proposer:
    network = load_fastsam(path).to(device)
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
