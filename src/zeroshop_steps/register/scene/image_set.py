"""The images and masks of a capture, checked before anything is computed. A whole scene has no masks yet."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
import pycolmap

from zeroshop_steps.capture.cameras_json import FILE, read_given_cameras
from zeroshop_steps.geometry.imaging.images import list_images, read_image, read_mask, require_one_size
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json

REFERENCE_PX = 1000  # the longer side of the images on which limits in pixels were set
CELLS = 8  # along each side of a picture
T = TypeVar("T")
MIN_IMAGES = 3  # of a capture, and views of a point: of two, nothing can be checked, and one that is wrong decides


@dataclass(frozen=True)
class ImageSet:
    """Images, each with a mask of the same stem and size, or none of them.

    Attributes:
        images: image files, sorted by name.
        masks: mask files, in the order of the images; None for a whole scene.
        sizes_px: (width, height) of each image.
        sources: how the user names the images, in their order; empty where they have no other name.
        film: whether the images are frames of a film, named by their place in it.
        cuts: places of the frames before which the film was cut.
        masks_found: whether the masks were not given, but found in each image: good to a pixel at best.
        lenses: {image stem: camera} that came with the capture, from which registrations start; None where they are not known.
    """

    images: tuple[Path, ...]
    masks: tuple[Path, ...] | None
    sizes_px: tuple[tuple[int, int], ...]
    sources: tuple[str, ...] = ()
    film: bool = False
    cuts: tuple[int, ...] = ()
    masks_found: bool = False
    lenses: dict[str, pycolmap.Camera] | None = None

    @property
    def names(self) -> list[str]:
        """File names of the images."""
        return [path.name for path in self.images]

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height) of all, for methods whose network takes all images as one array. Raises StepError where they differ."""
        return require_one_size(
            self.sizes_px,
            f"{self.images[0].parent} holds images of",
            "this method's network takes all images as one array; use the registration colmap or mast3r, or give images of one size",
        )

    @property
    def shown(self) -> dict[str, str]:
        """{image name: the name that the user knows}."""
        return dict(zip(self.names, self.sources or self.names, strict=True))

    def take(self, numbers: Sequence[int]) -> "ImageSet":
        """The images of these numbers alone, in their order."""

        def pick(values: tuple[T, ...]) -> tuple[T, ...]:
            return tuple(values[number] for number in numbers)

        masks = None if self.masks is None else pick(self.masks)
        sources = pick(self.sources) if self.sources else ()
        return replace(self, images=pick(self.images), masks=masks, sizes_px=pick(self.sizes_px), sources=sources)

    @property
    def scales(self) -> dict[str, float]:
        """{image name: its longer side over 1000 px}: limits in pixels are set for that length."""
        return {name: max(size) / REFERENCE_PX for name, size in zip(self.names, self.sizes_px, strict=True)}


def find_cells(keypoints: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
    """(K,) numbers of the `CELLS` x `CELLS` cells of a picture of (width, height) in which (K, 2) keypoints lie: how much they cover."""
    columns, rows = np.clip(np.floor(keypoints / size_px * CELLS).astype(int), 0, CELLS - 1).T
    return np.asarray(rows * CELLS + columns)


def read_image_set(capture: Path) -> ImageSet:
    """List and check `capture`/images and, where they exist, `capture`/masks and the lenses of `capture`/cameras.json.

    Raises:
        StepError: too few images, an unreadable one, a mask that is missing, empty, full or of another size, or a lens that is missing.
    """
    capture = Path(capture)
    images = list_images(capture / "images")
    if len(images) < MIN_IMAGES:
        raise StepError(f"{capture / 'images'} holds {len(images)} image(s); at least {MIN_IMAGES} are needed, 20 work well")
    if len({path.stem for path in images}) < len(images):
        raise StepError(f"{capture / 'images'} holds images that differ only in their suffix; keep one of each")
    masks: list[Path] | None = [] if (capture / "masks").is_dir() else None
    sizes_px: list[tuple[int, int]] = []
    digests = set()
    for image in images:
        pixels = read_image(image)
        sizes_px.append((pixels.shape[1], pixels.shape[0]))
        digests.add(cv2.resize(pixels, (32, 32), interpolation=cv2.INTER_AREA).tobytes())
        if masks is None:
            continue
        mask = capture / "masks" / f"{image.stem}.png"
        if not mask.is_file():
            raise StepError(f"mask {mask} of image {image.name} does not exist; every image needs one")
        covered = read_mask(mask, sizes_px[-1]).mean()
        if covered in (0.0, 1.0):
            raise StepError(f"mask {mask} is {'empty' if covered == 0.0 else 'full'}; it must be 255 on the object and 0 elsewhere")
        masks.append(mask)
    if len(digests) == 1:
        raise StepError(f"all images in {capture / 'images'} are alike; the camera must move around the object")
    path = capture / "capture.json"
    record = read_json(path) if path.is_file() else {}
    film = [path.stem for path in images] == [f"{place:06d}" for place in range(len(record.get("source_frames", [])))]
    sources, cuts = _read_sources(record, images), tuple(record.get("cuts", ()))
    lenses = _read_lenses(capture / FILE, [path.name for path in images])
    return ImageSet(tuple(images), None if masks is None else tuple(masks), tuple(sizes_px), sources, film, cuts, lenses=lenses)


def _read_lenses(path: Path, names: list[str]) -> dict[str, pycolmap.Camera] | None:
    """The lenses of a capture that knows them, by the images' stems."""
    if not path.is_file():
        return None
    given = read_given_cameras(path)
    given.require(names)
    return {Path(name).stem: given.images[name].lens.to_colmap() for name in names}


def _read_sources(record: dict[str, Any], images: list[Path]) -> tuple[str, ...]:
    """The user's names of a capture's photos; empty where its record tells none, or it was changed since."""
    names = record.get("source_names", [])
    numbers = [int(path.stem) if path.stem.isdigit() else -1 for path in images]
    return tuple(names[number] for number in numbers) if names and all(0 <= number < len(names) for number in numbers) else ()


def mask_files(image_set: ImageSet) -> tuple[Path, ...]:
    """The mask files, in the order of the images. Raises StepError where there are none."""
    if image_set.masks is None:
        raise StepError(f"{image_set.images[0].parent.parent} has no masks; register its whole scene first, then segment it")
    return image_set.masks


def read_masks(image_set: ImageSet) -> dict[str, np.ndarray]:
    """The masks of all images as {image name: (height, width) bool}. Raises StepError where there are none."""
    parts = zip(image_set.names, mask_files(image_set), image_set.sizes_px, strict=True)
    return {name: read_mask(mask, size_px) for name, mask, size_px in parts}
