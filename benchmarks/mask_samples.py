"""What the fit of masks learns from: channels of the cues and the true masks, for right and wrong guesses at the object's hull."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.geometry.images import read_mask
from zeroshop_steps.geometry.registered_views import View, read_views
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.networks.salient_object import SalientObjectNetwork
from zeroshop_steps.segment import fusion
from zeroshop_steps.segment.exposure import estimate_exposure
from zeroshop_steps.segment.finder import WIDTH_PX, look_closer
from zeroshop_steps.segment.scene import Guess, MaskScene, read_mask_scene, start_guess
from zeroshop_steps.segment.solve import make_guess
from zeroshop_steps.segment.support import propose_supports
from zeroshop_steps.segment.voxels import VoxelGrid, carve, render_silhouettes
from zeroshop_steps.segment.windows import Window

PIXELS, VIEWS = 300, 6  # of a view for each guess, half of them near the outline; and how many views are asked
VOXELS = 72
DROPPED = ((), ("network",), ("ground",))
"""Cues that know nothing in a part of the samples, so that one network serves without them."""
RING = 0.5  # around the object, of its size, the ground is known to be empty in most captures
KINDS = ("right", "large", "small", "lacks", "more")  # of hulls that are tried


@dataclass(frozen=True)
class Truth:
    """A capture whose masks are known: (h, w) bool of the scene's cameras, None where there is no reference."""

    scene: MaskScene
    masks: list[np.ndarray | None]


def name_object(folder: Path) -> str:
    """What a capture's folder shows."""
    return folder.name.rpartition("_")[0]


def read_truth(folder: Path, network: SalientObjectNetwork, cache: Path) -> Truth:
    """The capture of a folder; what the network sees is kept in `cache`."""
    views, model = read_views(folder / "scene")
    kept = cache / "saliency" / f"{folder.name}.npz"
    if not kept.is_file():
        kept.parent.mkdir(parents=True, exist_ok=True)
        maps = network.find_maps([view.image_path for view in views], WIDTH_PX)
        np.savez_compressed(kept, *(np.round(255 * seen).astype(np.uint8) for seen in maps))
    with np.load(kept) as stored:
        saliency = [stored[name].astype(np.float32) / 255 for name in stored.files]
    scene = read_mask_scene(views, model, estimate_exposure(folder / "scene", views), saliency, WIDTH_PX)
    masks_folder = folder / "capture/truth/masks"
    masks_folder = masks_folder if masks_folder.is_dir() else folder / "reference"
    paths = [masks_folder / f"{Path(view.camera.name).stem}.png" for view in views]
    masks = [
        resize_mask(path, camera.width_px, camera.height_px) if path.is_file() else None
        for path, camera in zip(paths, scene.cameras, strict=True)
    ]
    return Truth(scene, masks)


def resize_mask(path: Path, width_px: int, height_px: int) -> np.ndarray:
    """A reference mask at another size, (height, width) bool."""
    return cv2.resize(read_mask(path).astype(np.float32), (width_px, height_px), interpolation=cv2.INTER_AREA) > 0.5


def propose_guesses(truth: Truth, rng: np.random.Generator) -> Iterator[tuple[MaskScene, Guess, list[np.ndarray | None]]]:
    """What the network meets: nothing known yet; and hulls that are right, too large, too small, and lack a part or have too much."""
    candidates = list(propose_supports(truth.scene.model, truth.scene.views, 0))
    for candidate in (candidates[0], candidates[-1]):
        support = truth.scene.place(candidate.support)
        yield truth.scene, start_guess(truth.scene, support), truth.masks
        if any(mask is None for mask in truth.masks):
            continue  # a hull needs all masks
        for kind in rng.choice(KINDS, 3 if support is not None else 1, replace=False):
            yield from make_hull_guess(truth, support, [perturb(mask, kind, rng) for mask in truth.masks])


def perturb(mask: np.ndarray, kind: str, rng: np.random.Generator) -> np.ndarray:
    """A wrong mask of a view."""
    if not mask.any() or kind == "right":
        return mask
    size = float(np.sqrt(mask.sum()))
    radius = max(1, round(size * rng.uniform(0.02, 0.08)))
    window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2)
    if kind == "large":
        return cv2.dilate(mask.astype(np.uint8), window) > 0
    if kind == "small":
        return cv2.erode(mask.astype(np.uint8), window) > 0
    rows, columns = np.nonzero(mask)
    # A part of the height, the same in all views, is missing, or a block beside the object is taken along.
    if kind == "lacks":
        cut = rows.min() + 0.3 * np.ptp(rows)
        return mask & (np.arange(mask.shape[0])[:, None] > cut)
    more = mask.copy()
    more[rows.max() - int(0.4 * np.ptp(rows)) : rows.max(), columns.max() : columns.max() + int(0.3 * size)] = True
    return more


def make_hull_guess(
    truth: Truth, support: SceneSupport | None, masks: list[np.ndarray]
) -> Iterator[tuple[MaskScene, Guess, list[np.ndarray | None]]]:
    """The guess whose hull masks share, seen in windows around it; none where they share nothing."""
    scene, known = truth.scene, truth.masks
    focus, distance = scene.focus
    axes = np.eye(3) if support is None else np.vstack([support.axes(), support.normal])
    extent = 0.5 * distance
    grid = VoxelGrid(axes, focus - extent * axes.sum(0), 2 * extent / VOXELS, (VOXELS,) * 3)
    index = np.argwhere(np.ones(grid.shape, bool))
    occupied = carve(grid, index, scene.cameras, [2 * mask.astype(np.float32) - 1 for mask in masks])
    if not occupied.any():
        return
    closer, support = look_closer(scene, support, grid, occupied, None)
    if closer is not scene:
        known = [cut_part(*parts) for parts in zip(known, closer.windows, scene.views, closer.cameras, strict=True)]
    hulls = render_silhouettes(grid, occupied, closer.cameras)
    yield closer, make_guess(closer, support, occupied, hulls, [np.zeros_like(hull) for hull in hulls]), known


def cut_part(mask: np.ndarray, window: Window, view: View, camera: Camera) -> np.ndarray:
    """The part of a view's mask, (h, w) bool, that a window shows, of the size of its camera."""
    part = mask[scale_to(mask, window, view).slices].astype(np.float32)
    return cv2.resize(part, (camera.width_px, camera.height_px), interpolation=cv2.INTER_LINEAR) > 0.5


def scale_to(mask: np.ndarray, window: Window, view: View) -> Window:
    """A window of a view in pixels of a mask, (h, w), of the whole view at another size."""
    return window.scaled(mask.shape[1] / view.camera.width_px, mask.shape[0] / view.camera.height_px)


def sample(truth: Truth, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(N, C) channels and (N,) whether they are of the object."""
    channels, labels = [], []
    for scene, guess, masks in propose_guesses(truth, rng):
        for without in DROPPED if guess.hulls is None else ((), ("network",)):
            see = fusion.prepare_channels(scene, guess, without)
            for index in rng.choice(len(masks), min(VIEWS, len(masks)), replace=False):
                mask = masks[index]
                if mask is None or not mask.any():
                    continue
                size = np.sqrt(mask.sum())
                away = ndimage.distance_transform_edt(~mask)
                near, shown = np.abs(ndimage.distance_transform_edt(mask) - away) < 0.1 * size, see(index)
                # Before there is a hull, other things on the ground are things, too. Nobody has drawn them, so they are left out.
                ground = (shown[..., fusion.CHANNELS.index("ground_known")] > 0) & (guess.hulls is None)
                places = [rng.choice(np.flatnonzero(part), PIXELS // 2) for part in (near, ~ground | (away < RING * size))]
                flat = np.concatenate(places)
                channels.append(shown.reshape(-1, len(fusion.CHANNELS))[flat])
                labels.append(mask.ravel()[flat])
    return np.concatenate(channels), np.concatenate(labels)
