"""Masks from the candidates of FastSAM: the likely ones, without doubles, each cut out by its box."""

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from zeroshop_steps.networks.devices import run_network
from zeroshop_steps.networks.fastsam.model import STRIDES, BoxCandidates, FastSam

GREY = 114  # of 255, around an image whose sides are no multiples of the largest stride


def propose_masks(
    network: FastSam, photo: np.ndarray, device: torch.device, side_px: int, least_likelihood: float, most_iou: float, most: int
) -> list[np.ndarray]:
    """(height, width) bool masks of the things in a photo, the likeliest first.

    Args:
        network: with its weights.
        photo: (height, width, 3) uint8 RGB.
        device: of the network.
        side_px: the longer side of the photo for the network.
        least_likelihood: candidates with less are dropped.
        most_iou: of the boxes of two candidates; with more, the less likely one is dropped.
        most: masks.
    """
    image, inner = fit_image(photo, side_px)
    tensor = torch.from_numpy(image.transpose(2, 0, 1)[None].copy()).to(device).float() / 255
    with run_network(device, "FastSAM"):
        (found,) = network(tensor)
    kept = choose_candidates(found, least_likelihood, most_iou, most)
    masks = mix_masks(kept, image.shape[:2])[:, inner[0], inner[1]].cpu().numpy()
    return [_resize(mask, photo.shape[:2]) for mask in masks if mask.any()]


def fit_image(photo: np.ndarray, side_px: int) -> tuple[np.ndarray, tuple[slice, slice]]:
    """The photo in grey, with sides that are multiples of the largest stride, and the rows and columns that it fills."""
    scale = side_px / max(photo.shape[:2])
    size = [max(1, round(side * scale)) for side in photo.shape[:2]]
    resized = cv2.resize(photo, size[::-1], interpolation=cv2.INTER_LINEAR) if tuple(size) != photo.shape[:2] else photo
    whole = [-(-side // STRIDES[-1]) * STRIDES[-1] for side in size]
    inner = tuple(slice((outer - side) // 2, (outer - side) // 2 + side) for outer, side in zip(whole, size, strict=True))
    image = np.full((*whole, 3), GREY, np.uint8)
    image[inner] = resized
    return image, (inner[0], inner[1])


def choose_candidates(found: BoxCandidates, least_likelihood: float, most_iou: float, most: int) -> BoxCandidates:
    """The likely ones, the likeliest first, without those whose box nearly is that of a likelier one."""
    likely = torch.nonzero(found.likelihoods > least_likelihood)[:, 0]
    order = likely[found.likelihoods[likely].argsort(descending=True, stable=True)]
    boxes = found.boxes[order].float()
    kept: list[int] = []
    areas = (boxes[:, 2:] - boxes[:, :2]).prod(1)
    waiting = torch.ones(len(order), dtype=torch.bool, device=boxes.device)
    while waiting.any() and len(kept) < most:
        first = int(waiting.to(torch.uint8).argmax())
        kept.append(first)
        sides = torch.minimum(boxes[:, 2:], boxes[first, 2:]) - torch.maximum(boxes[:, :2], boxes[first, :2])
        common = sides.clamp(min=0).prod(1)
        waiting &= common <= most_iou * (areas + areas[first] - common)
        waiting[first] = False
    chosen = order[kept]
    return BoxCandidates(found.boxes[chosen], found.likelihoods[chosen], found.mixtures[chosen], found.prototypes)


def mix_masks(found: BoxCandidates, size: tuple[int, int]) -> Tensor:
    """(N, height, width) bool masks of an image of this size, each within its box."""
    height, width = found.prototypes.shape[1:]
    soft = (found.mixtures.float() @ found.prototypes.float().flatten(1)).sigmoid().unflatten(1, (height, width))
    scale = torch.tensor([width / size[1], height / size[0]] * 2, device=soft.device)
    left, top, right, bottom = (found.boxes.float() * scale).T[:, :, None, None]
    x, y = torch.arange(width, device=soft.device)[None, None], torch.arange(height, device=soft.device)[None, :, None]
    soft = soft * ((x >= left) & (x < right) & (y >= top) & (y < bottom))
    return F.interpolate(soft[:, None], size, mode="bilinear", align_corners=False)[:, 0] > 0.5


def _resize(mask: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    if mask.shape == shape:
        return mask
    return cv2.resize(mask.astype(np.uint8) * 255, shape[::-1], interpolation=cv2.INTER_LINEAR) >= 128
