"""What the fit of masks learns from: channels of the cues and the true masks, for the guesses that the finder makes (auto-context)."""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

import cv2
import numpy as np
from scipy import ndimage

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.registered_views import View, read_views
from zeroshop_steps.geometry.imaging.images import read_mask
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.segment import mask_hull
from zeroshop_steps.segment.cues import fusion
from zeroshop_steps.segment.finder import WIDTH_PX, try_support
from zeroshop_steps.segment.objects import NothingFound
from zeroshop_steps.segment.outlines.prompts import PromptedSegmenter
from zeroshop_steps.segment.outlines.windows import Window
from zeroshop_steps.segment.photometry.exposure import estimate_exposure
from zeroshop_steps.segment.scene import Guess, MaskScene, read_mask_scene, start_guess
from zeroshop_steps.segment.support import propose_supports

PIXELS, VIEWS = 300, 6  # of a view for each guess, half of them near the outline; and how many views are asked
DROPPED = ((), ("network",), ("ground",))
DROPPED_WITH_HULL = ((), ("network",), ("prompted",))
"""Cues that know nothing in a part of the samples, so that one network serves without them."""
RING = 0.5  # around the object, of its size, the ground is known to be empty in most captures
MISLED, FAILED_OVERLAP = 0.15, 0.5  # share of the samples in which a cue fails; networks overlap with the hull by at most so much there
MISLED_TOGETHER, SURE_POINTS = 0.2, 0.4  # of those where points say more than this, in which all cues fail that say what a thing is
SAY_WHAT = ("network", "prompted", "hull", "own_colors")


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


def list_guesses(truth: Truth, network: SalientObjectNetwork) -> Iterator[tuple[MaskScene, Guess, list[np.ndarray | None]]]:
    """What the fusion meets while the finder runs with the weights that it has: the scene, the guess, and the true masks of its windows."""
    candidates = list(propose_supports(truth.scene.model, truth.scene.views, truth.scene.planes))
    for candidate in (candidates[0], candidates[-1]):
        met: list[tuple[MaskScene, Guess]] = [(truth.scene, start_guess(truth.scene, truth.scene.place(candidate.support)))]

        def observe(
            scene: MaskScene, guess: Guess, without: Sequence[str] = (), met: list[tuple[MaskScene, Guess]] = met
        ) -> list[np.ndarray]:
            met.append((scene, guess))
            return fusion.estimate_odds(scene, guess, without)

        with mock.patch.object(mask_hull, "estimate_odds", observe), contextlib.suppress(NothingFound):
            list(try_support(truth.scene, candidate, network))
        for scene, guess in met:
            masks = truth.masks
            if scene is not truth.scene:
                parts = zip(truth.masks, scene.windows, scene.views, scene.cameras, strict=True)
                masks = [None if mask is None else cut_part(mask, *part) for mask, *part in parts]
            yield scene, guess, masks


def mislead(channels: np.ndarray, labels: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A part of the (N, C) channels and (N,) labels in which one cue alone fails: it says what it said elsewhere.

    A network fails in single photos, and a hull where single photos show something else than the others. And all cues that say what a thing
    is fail together where they take a sheet that the object stands on for a part of it, or lack a part: then the points' heights tell.
    """
    column = fusion.CHANNELS.index
    known, failed = np.flatnonzero((channels[:, column("hull")] != 0) & (channels[:, column("network_known")] > 0)), []
    for cue in ("network", "prompted", "hull"):
        chosen = known[rng.random(len(known)) < MISLED]
        columns = [column(name) for name in fusion.CUES[cue].CHANNELS]
        misled = channels[chosen]
        misled[:, columns] = rng.permutation(misled[:, columns])
        for agreement in (name for name in fusion.CHANNELS if name.endswith("_agrees")):
            misled[:, column(agreement)] = rng.uniform(0, FAILED_OVERLAP, len(misled))
        failed.append((misled, labels[chosen]))
    together = [column(name) for cue in SAY_WHAT for name in fusion.CUES[cue].CHANNELS]
    for sign, label in ((-1, False), (1, True)):
        told = known[(sign * channels[known, column("points_raised")] > SURE_POINTS) & (labels[known] == label)]
        chosen, others = told[rng.random(len(told)) < MISLED_TOGETHER], known[labels[known] != label]
        if len(chosen) and len(others):
            misled = channels[chosen]
            misled[:, together] = channels[rng.choice(others, len(chosen))][:, together]
            failed.append((misled, labels[chosen]))
    samples, truths = zip(*failed, strict=True)
    return np.concatenate(samples), np.concatenate(truths)


def cut_part(mask: np.ndarray, window: Window, view: View, camera: Camera) -> np.ndarray:
    """The part of a view's mask, (h, w) bool, that a window shows, of the size of its camera."""
    part = mask[scale_to(mask, window, view).slices].astype(np.float32)
    return cv2.resize(part, (camera.width_px, camera.height_px), interpolation=cv2.INTER_LINEAR) > 0.5


def scale_to(mask: np.ndarray, window: Window, view: View) -> Window:
    """A window of a view in pixels of a mask, (h, w), of the whole view at another size."""
    return window.scaled(mask.shape[1] / view.camera.width_px, mask.shape[0] / view.camera.height_px)


def sample(
    truth: Truth, network: SalientObjectNetwork, segmenter: PromptedSegmenter, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """(N, C) channels and (N,) whether they are of the object."""
    channels, labels = [], []
    known = [index for index, mask in enumerate(truth.masks) if mask is not None]
    asked = rng.choice(known, min(VIEWS, len(known)), replace=False)
    for scene, guess, masks in list_guesses(truth, network):
        see = fusion.prepare_channels(replace(scene, segmenter=segmenter), guess)
        for index in asked:
            mask = masks[index]
            if not mask.any():
                continue
            size = np.sqrt(mask.sum())
            away = ndimage.distance_transform_edt(~mask)
            near, shown = np.abs(ndimage.distance_transform_edt(mask) - away) < 0.1 * size, see(index)
            # Before there is a hull, other things on the ground are things, too. Nobody has drawn them, so they are left out.
            ground = (shown[..., fusion.CHANNELS.index("ground_known")] > 0) & (guess.hull is None)
            # A window may show nothing but the object, far from its outline.
            places = [np.flatnonzero(part) for part in (near, ~ground | (away < RING * size))]
            for without in DROPPED if guess.hull is None else DROPPED_WITH_HULL:
                flat = np.concatenate([rng.choice(place, PIXELS // 2) for place in places if len(place)])
                sampled = shown.reshape(-1, len(fusion.CHANNELS))[flat]
                sampled[:, [fusion.CHANNELS.index(name) for cue in without for name in fusion.CUES[cue].CHANNELS]] = 0
                channels.append(sampled)
                labels.append(mask.ravel()[flat])
    return np.concatenate(channels), np.concatenate(labels)
