"""The images and masks of a capture, checked before anything is computed. A whole scene has no masks yet."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from zeroshop_steps.geometry.images import list_images, read_image, read_mask
from zeroshop_steps.runtime.errors import StepError

MIN_IMAGES = 3  # with two views, nothing can be checked


@dataclass(frozen=True)
class ImageSet:
    """Images of equal size, each with a mask of the same stem, or none of them.

    Attributes:
        images: image files, sorted by name.
        masks: mask files, in the order of the images; None for a whole scene.
        size_px: (width, height) of all.
    """

    images: tuple[Path, ...]
    masks: tuple[Path, ...] | None
    size_px: tuple[int, int]

    @property
    def names(self) -> list[str]:
        """File names of the images."""
        return [path.name for path in self.images]


def read_image_set(capture: Path) -> ImageSet:
    """List and check `capture`/images and, where it exists, `capture`/masks.

    Raises:
        StepError: too few images, an unreadable or odd-sized one, a mask that is missing, empty, full or of another size.
    """
    capture = Path(capture)
    images = list_images(capture / "images")
    if len(images) < MIN_IMAGES:
        raise StepError(f"{capture / 'images'} holds {len(images)} image(s); at least {MIN_IMAGES} are needed, 20 work well")
    if len({path.stem for path in images}) < len(images):
        raise StepError(f"{capture / 'images'} holds images that differ only in their suffix; keep one of each")
    masks: list[Path] | None = [] if (capture / "masks").is_dir() else None
    size_px, digests = (0, 0), set()
    for image in images:
        pixels = read_image(image)
        size = (pixels.shape[1], pixels.shape[0])
        if image is images[0]:
            size_px = size
        if size != size_px:
            raise StepError(
                f"image {image} is {size[0]} x {size[1]} px, {images[0].name} is {size_px[0]} x {size_px[1]} px; all must be equal"
            )
        digests.add(cv2.resize(pixels, (32, 32), interpolation=cv2.INTER_AREA).tobytes())
        if masks is None:
            continue
        mask = capture / "masks" / f"{image.stem}.png"
        if not mask.is_file():
            raise StepError(f"mask {mask} of image {image.name} does not exist; every image needs one")
        covered = read_mask(mask, size_px).mean()
        if covered in (0.0, 1.0):
            raise StepError(f"mask {mask} is {'empty' if covered == 0.0 else 'full'}; it must be 255 on the object and 0 elsewhere")
        masks.append(mask)
    if len(digests) == 1:
        raise StepError(f"all images in {capture / 'images'} are alike; the camera must move around the object")
    return ImageSet(tuple(images), None if masks is None else tuple(masks), size_px)


def read_masks(image_set: ImageSet, names: list[str] | None = None) -> dict[str, np.ndarray]:
    """The masks as {image name: (height, width) bool}, of all images or of `names`.

    Raises:
        StepError: there are no masks.
    """
    if image_set.masks is None:
        raise StepError(f"{image_set.images[0].parent.parent} has no masks; register its whole scene first, then segment it")
    chosen = set(image_set.names if names is None else names)
    pairs = zip(image_set.images, image_set.masks, strict=True)
    return {image.name: read_mask(mask, image_set.size_px) for image, mask in pairs if image.name in chosen}
