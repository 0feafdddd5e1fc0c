"""What every segmentation method writes: the registered images with their masks, without images whose mask is bad.

A cameras folder: images/ of equal exposure and white balance (photometry/exposure.py), masks/, confidence/, sparse/, registration.json as
the registration wrote it, segmentation.json with the quality of the masks, exposure.json, and contact_sheet.png, a picture of all masks.
"""

import argparse
import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.registered_views import CONFIDENCE, SEGMENTATION, View
from zeroshop_steps.geometry.cameras.sparse_files import read_reconstruction, write_reconstruction
from zeroshop_steps.geometry.imaging.contact_sheets import RED, arrange_in_rows, tile_size_px, write_label
from zeroshop_steps.geometry.imaging.images import read_image, write_image, write_mask
from zeroshop_steps.register.refinement.camera_deviation import write_deviations
from zeroshop_steps.register.refinement.silhouette_refinement import Straightened, carry_plane, straighten_cameras, warn_of_bent_cameras
from zeroshop_steps.register.scene.record import find_lens, read_registration
from zeroshop_steps.runtime.compute.thread_pool import map_in_threads
from zeroshop_steps.runtime.errors import warn
from zeroshop_steps.runtime.files import atomic_directory, link_or_copy, write_json
from zeroshop_steps.segment.photometry.exposure import Exposure, equalize_exposure, estimate_exposure
from zeroshop_steps.segment.quality.mask_agreement import assess_masks
from zeroshop_steps.segment.quality.mask_quality import MasksRejected, find_contradicted

WIDE_SHARE = 0.9  # of a photo, that is left of it undistorted: of ordinary lenses, more is
DARKENED_BY = 3  # what lies outside a mask, on the sheet of all masks


def add_common_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that all segmentation methods share."""
    parser.add_argument("--scene", type=Path, required=True, help="registered scene: images/, sparse/ and perhaps masks/")
    parser.add_argument("--seed", type=int, default=0, help="seed of RANSAC (default: %(default)s)")
    add_rejected_argument(parser)
    parser.add_argument("--out", type=Path, required=True, help="cameras folder to write")


def add_rejected_argument(parser: argparse.ArgumentParser) -> None:
    """Option for the image of rejected masks."""
    parser.add_argument("--rejected", type=Path, help="picture to write of the masks where they are refused")


@contextlib.contextmanager
def show_rejected_masks(paths: list[Path], picture: Path | None) -> Iterator[None]:
    """Where this block rejects the masks of the images `paths`, write an image of them that shows why."""
    if picture is not None:
        picture.unlink(missing_ok=True)
    try:
        yield
    except MasksRejected as error:
        if picture is None:
            raise
        write_image(picture, draw_mask_sheet(paths, error.masks, error.dropped))
        raise MasksRejected(f"{error}; all masks are shown in {picture}", error.masks, error.dropped) from None


def write_segmented(
    scene: Path,
    out: Path,
    views: list[View],
    masks: list[np.ndarray],
    dropped: set[str],
    record: dict[str, Any],
    exposure: Exposure | None = None,
    missed_px: float | None = None,
    bent_px: float | None = None,
) -> None:
    """Write the cameras folder.

    Args:
        scene: the registration's folder.
        views: its views.
        masks: (H, W) bool in their order and size.
        dropped: names of images that are left out.
        record: for segmentation.json.
        exposure: of the views, where it was estimated already.
        missed_px: by how much the outlines of the masks that are kept miss each other, likewise.
        bent_px: the same before the scene's cameras were adjusted to outlines, where they were.
    """
    registration = read_registration(scene)
    exposure = exposure or estimate_exposure(scene, views)
    with atomic_directory(out) as folder:
        for part in ("images", "masks"):
            (folder / part).mkdir()

        def write(view: View, mask: np.ndarray) -> None:
            if view.camera.name not in dropped:
                link_or_copy(view.image_path, folder / "images" / view.camera.name)
                write_mask(folder / "masks" / f"{Path(view.camera.name).stem}.png", mask)

        map_in_threads(write, views, masks)
        model = read_reconstruction(scene / "sparse")
        for image_id in sorted(model.reg_image_ids()):
            if model.images[image_id].name in dropped:
                model.deregister_frame(model.images[image_id].frame_id)
        kept = [index for index, view in enumerate(views) if view.camera.name not in dropped]
        cameras, kept_masks = [views[index].camera for index in kept], [masks[index] for index in kept]
        straightened = straighten_cameras(model, cameras, kept_masks, missed_px)
        if bent_px is not None:
            straightened = replace(straightened, before_px=bent_px)
        write_reconstruction(straightened.model, folder / "sparse")
        equalize_exposure(folder, views, exposure)
        _write_confidence(folder, straightened.cameras, kept_masks)
        registration |= write_deviations(folder, by_outlines=straightened.before_px is not None)
        record = record | _describe_straightened(straightened, cameras, record)
        registration |= {"registered": model.num_reg_images(), "left_out_by_mask": sorted(dropped)}
        write_json(folder / "registration.json", registration)
        write_json(folder / SEGMENTATION, record)
        write_image(folder / "contact_sheet.png", draw_mask_sheet([view.image_path for view in views], masks, dropped))
    warn_of_dropped(record, registration)
    warn_of_bent_cameras(straightened)


def _describe_straightened(straightened: Straightened, before: list[Camera], record: dict[str, Any]) -> dict[str, Any]:
    """What changes in the record by how the outlines fit, and by cameras that were adjusted to them."""
    missed_px, before_px = straightened.missed_px, straightened.before_px
    changes: dict[str, Any] = {"outlines_miss_px": None if missed_px is None else round(missed_px, 2)}
    if missed_px is None or before_px is None:
        return changes
    changes["outlines_missed_before_px"] = round(before_px, 2)
    if "plane" in record:
        normal, offset = carry_plane(np.array(record["plane"]["normal"]), record["plane"]["offset"], before, straightened.cameras)
        changes["plane"] = {"normal": normal.tolist(), "offset": offset}
    return changes


def _write_confidence(folder: Path, cameras: list[Camera], masks: list[np.ndarray]) -> None:
    """Write how sure each mask is at each pixel, where it is not sure everywhere: not where the other masks contradict it."""
    hulls, _ = assess_masks(masks, cameras)

    def write(camera: Camera, mask: np.ndarray, hull: np.ndarray) -> None:
        contradicted = find_contradicted(mask, hull) if hull.any() else np.zeros_like(mask)
        if contradicted.any():
            write_mask(folder / CONFIDENCE / f"{Path(camera.name).stem}.png", ~contradicted)

    map_in_threads(write, cameras, masks, hulls)


def warn_of_dropped(record: dict[str, Any], registration: Mapping[str, Any] | None = None) -> None:
    """Warn of images that are left out, with the reason, and of images that cut the object off, also since they were undistorted."""
    for name, fault in record.get("dropped", {}).items():
        warn(f"{name} is left out: {fault}")
    if cut := record.get("cut_off"):
        shown = min(((find_lens(registration or {}, Path(name).stem) or {}).get("shown_share", 1.0) for name in cut), default=1.0)
        wide = f"; undistorted, they show {shown:.0%} of the photos, as the lens is wide: keep the object in the middle"
        warn(
            f"the object is cut off at the border in {', '.join(cut)}; step back and keep all of it in the image"
            f"{wide if shown < WIDE_SHARE else ''}"
        )


def draw_mask_sheet(paths: list[Path], masks: list[np.ndarray], dropped: set[str]) -> np.ndarray:
    """(H, W, 3) uint8: every image with what lies outside its mask darkened, the outline red; dropped ones crossed out."""

    def draw(path: Path, mask: np.ndarray) -> np.ndarray:
        size = tile_size_px(mask)
        tile = cv2.resize(read_image(path), size, interpolation=cv2.INTER_AREA)
        small = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
        tile = np.where(small[..., None], tile, tile // DARKENED_BY)
        tile[small & ~(cv2.erode(small.astype(np.uint8), np.ones((3, 3))) > 0)] = RED
        if path.name in dropped:
            cv2.line(tile, (0, 0), size, RED, 3)
        write_label(tile, path.stem)
        return tile

    return arrange_in_rows(map_in_threads(draw, paths, masks))
