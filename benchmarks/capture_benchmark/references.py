"""Reference masks: what an object really covers in the undistorted photos of a scene."""

from pathlib import Path

import cv2
import numpy as np

from capture_benchmark.table import Capture
from zeroshop_steps.geometry.imaging.images import list_images, read_image, read_mask
from zeroshop_steps.register.scene.record import find_lens, read_registration
from zeroshop_steps.register.scene.undistortion import undistort_by_lens
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json

LARGEST_ASPECT_CHANGE = 0.02  # between a mask, which may be smaller, and its photo


def read_references(
    capture: Capture, folder: Path, data: Path, drawn: Path, scene: Path | None = None, taken: Path | None = None
) -> dict[str, np.ndarray]:
    """The reference masks of a scene's photos, (H, W) bool, undistorted, by the stem of the registered image.

    Args:
        capture: which.
        folder: of its inputs.
        data: folder of real captures; a row's `masks` lie below it.
        drawn: folder of masks that were drawn for the benchmark, NAME/STEM.png: they count before those of the data.
        scene: what a registration wrote; by default the stored one.
        taken: the capture that it was made of; by default the stored one.

    Raises:
        StepError: a mask has another shape than its photo, or belongs to none.
    """
    scene = scene or folder / "scene"
    record = read_registration(scene)
    images = {path.stem: path for path in list_images(scene / "images")}
    found = {}
    for stem, path in find_mask_files(capture, folder, taken or folder / "capture", data, drawn).items():
        if stem not in images:
            continue
        height_px, width_px = read_image(images[stem]).shape[:2]
        mask = read_mask(path).astype(np.uint8)
        if abs(mask.shape[1] / mask.shape[0] * height_px / width_px - 1) > LARGEST_ASPECT_CHANGE:
            raise StepError(
                f"{path} is {mask.shape[1]} x {mask.shape[0]} px, its photo {width_px} x {height_px} px; expected the same shape"
            )
        whole = cv2.resize(mask * 255, (width_px, height_px), interpolation=cv2.INTER_LINEAR) >= 128
        lens = find_lens(record, stem)
        found[stem] = undistort_by_lens(whole.astype(np.uint8), lens, cv2.INTER_NEAREST, cv2.BORDER_REPLICATE) > 0
    return found


def find_mask_files(capture: Capture, folder: Path, taken: Path, data: Path, drawn: Path) -> dict[str, Path]:
    """Reference masks by the stem of the image in the capture `taken`; see `read_references`."""
    stems = [path.stem for path in list_images(taken / "images")]
    facts = read_json(taken / "capture.json")
    if capture.kind == "film":
        truth = folder / "film" / "truth" / "masks"
        return {f"{index:06d}": truth / f"{number:06d}.png" for index, number in enumerate(facts["source_frames"])}
    names = [Path(name).stem for name in facts.get("source_names") or stems]
    places = [folder / "capture" / "truth" / "masks"] if capture.kind == "rendered" else []
    places += [data / capture.masks] if capture.masks else []
    given = {path.stem: path for place in [*places, drawn / capture.name] if place.is_dir() for path in list_images(place)}
    took_all = facts.get("photos_found", len(names)) == len(names)
    if (unknown := sorted(set(given) - set(names))) and took_all:
        raise StepError(f"{capture.name}: no photo belongs to the reference masks {', '.join(unknown)}; name them as the photos, but .png")
    return {stem: given[name] for stem, name in zip(stems, names, strict=True) if name in given}
