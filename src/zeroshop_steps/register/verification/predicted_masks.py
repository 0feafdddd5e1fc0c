"""Masks of photos by a salient-object network.

They are enough to register the object alone, and to check cameras that little else holds. The network takes the thing in the middle of
each photo. Masks that show something else are found by the registration.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.cameras.sparse_files import read_reconstruction
from zeroshop_steps.geometry.imaging.images import write_mask
from zeroshop_steps.networks.saliency.object_finder import cut_main_things
from zeroshop_steps.networks.saliency.saliency_maps import FINE_WIDTH_PX, WIDTH_PX, write_maps
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.register.refinement.silhouette_refinement import measure_silhouette_misses_px
from zeroshop_steps.register.scene.image_set import MIN_IMAGES, ImageSet
from zeroshop_steps.register.scene.record import Evidence, Finding, Record, RegistrationFailed, find_lens
from zeroshop_steps.register.scene.undistortion import undistort_by_lens
from zeroshop_steps.register.verification.photometric_consistency import check_photometric_consistency
from zeroshop_steps.register.verification.verdict import verify
from zeroshop_steps.runtime.files import scratch_directory

SPARSE_OBSERVATIONS = 250
"""Points seen by an image, in the mean. On plain tables, cameras with 80 to 170 were bent or folded at times; print gives a thousand."""

ROUGH_MISSED_PX = 15.0
"""As `silhouette_refinement.MOST_MISSED_PX`, of masks that only a network has made: 1.5 to 5.7 with right cameras of a bowl and of a white
pitcher on a white table, 10 where they were bent by 3 %, 77 where they were folded. Bent ones are left to the segmentation, whose masks are
finer."""
CHECKED_VIEWS = 20  # at most, evenly spread: the network takes seconds for each, and cameras that are bent are so all around


def find_object_maps(network: SalientObjectNetwork, images: Sequence[Path]) -> list[np.ndarray]:
    """What a network sees in each image, (h, w) float32, as fine as it can: its outlines hold the cameras."""
    return network.look_closer(images, network.find_maps(images, WIDTH_PX), FINE_WIDTH_PX)


def register_by_predicted_masks(
    folder: Path, image_set: ImageSet, network: SalientObjectNetwork, maps: list[np.ndarray], register: Callable[[ImageSet], dict[str, Any]]
) -> dict[str, Any]:
    """Register the object alone by masks that are found in each photo; what was seen in the photos is kept beside the cameras.

    Args:
        folder: the registration.
        image_set: photos without masks.
        network, maps: what finds the object in each, and what it saw there.
        register: fills `folder` from images with masks, and returns its record.

    Raises:
        RegistrationFailed: it sees a thing in too few photos, or the registration fails.
    """
    with scratch_directory(folder, "masks") as scratch:
        record = register(mask_images(image_set, cut_main_things(maps, image_set.sizes_px), network, scratch))
    seen = {path.stem: (found, size_px) for path, found, size_px in zip(image_set.images, maps, image_set.sizes_px, strict=True)}
    stems = [Path(camera.name).stem for camera in read_sparse_model(folder / "sparse").cameras]
    write_maps(folder, network, {stem: _undistort_map(*seen[stem], find_lens(record, stem)) for stem in stems})
    return record | {"masks_by": network.name}


def _undistort_map(found: np.ndarray, size_px: tuple[int, int], lens: dict[str, Any] | None) -> np.ndarray:
    """The map, (h, w), of a photo of (width, height) as its undistorted image shows it."""
    if not lens:
        return found
    whole = undistort_by_lens(cv2.resize(found, size_px), lens, cv2.INTER_LINEAR, cv2.BORDER_REPLICATE)
    return np.asarray(cv2.resize(whole, found.shape[::-1], interpolation=cv2.INTER_AREA))


def mask_images(image_set: ImageSet, found: list[np.ndarray], network: SalientObjectNetwork, folder: Path) -> ImageSet:
    """The images in which the network sees a thing, with masks that are written to `folder`.

    Raises:
        RegistrationFailed: it sees one in too few.
    """
    chosen, masks = _write_useful(found, image_set.images, folder)
    if len(chosen) < MIN_IMAGES:
        raise RegistrationFailed(
            f"{network.name} sees something that stands out in {len(chosen)} of {len(found)} photos only", {"registered": 0}
        )
    return replace(image_set.take(chosen), masks=tuple(masks), masks_found=True)


def is_sparse(record: dict[str, Any]) -> bool:
    """Whether so few points hold the cameras that they may be bent or folded although they agree with each other."""
    return record["points"] * record["mean_track_length"] < SPARSE_OBSERVATIONS * record["registered"]


def check_by_predicted_masks(
    folder: Path, record: dict[str, Any], network: SalientObjectNetwork, max_wrong_probability: float
) -> dict[str, Any]:
    """Check cameras that were found without masks by those of a network: their outlines, and the pictures of neighbours.

    Args:
        folder: the registration.
        record: its record.
        network: sees the object.
        max_wrong_probability: see `verify`.

    Returns:
        The record with the figures of the checks.

    Raises:
        RegistrationFailed: the outlines miss each other, or distinct sides were merged (duplicate structure).
    """
    views, model = read_views(folder)[0], read_reconstruction(folder / "sparse")
    views = views[:: math.ceil(len(views) / CHECKED_VIEWS)]
    maps = network.find_maps([view.image_path for view in views], WIDTH_PX)
    write_maps(folder, network, {view.image_path.stem: seen for view, seen in zip(views, maps, strict=True)})
    found = cut_main_things(maps, [(view.camera.width_px, view.camera.height_px) for view in views])
    checked = Record(record).add(checked_by=network.path.name)
    with scratch_directory(folder, "masks") as scratch:
        chosen, paths = _write_useful(found, [view.image_path for view in views], scratch)
        masked = [replace(views[index], mask_path=path) for index, path in zip(chosen, paths, strict=True)]
        missed_px = measure_silhouette_misses_px([view.camera for view in masked], [found[index] for index in chosen])
        checks: list[Callable[[], Evidence]] = [partial(_check_outlines, missed_px)]
        if len(masked) >= MIN_IMAGES:
            checks.append(lambda: check_photometric_consistency(masked, wide=False))
        checked = verify(checked, checks, model, max_wrong_probability)
    return dict(checked.entries)


def _check_outlines(missed_px: float | None) -> Evidence:
    """What outlines say that miss each other by so much in the median photo, per 1000 px; None where nothing could be compared."""
    if missed_px is None:
        return Evidence({"outlines_miss_px": None})
    found = f"in half of the photos, the outline of the thing in the middle misses the others by {missed_px:.1f} px or more (of 1000)"
    return Evidence({"outlines_miss_px": round(missed_px, 2)}, (Finding("silhouettes", missed_px / ROUGH_MISSED_PX, found),))


def _write_useful(masks: Sequence[np.ndarray], images: Sequence[Path], folder: Path) -> tuple[list[int], list[Path]]:
    """Numbers of the masks that show something, and not all of the photo, and the files that they are written to, named by the images."""
    chosen = [index for index, mask in enumerate(masks) if mask.any() and not mask.all()]
    paths = [folder / f"{images[index].stem}.png" for index in chosen]
    for path, index in zip(paths, chosen, strict=True):
        write_mask(path, masks[index])
    return chosen, paths
