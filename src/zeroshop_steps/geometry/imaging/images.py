"""Read, write and sample images and masks, with errors that name the file and the remedy."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from zeroshop_steps.geometry.imaging.image_files import check_photo_file, list_folder
from zeroshop_steps.runtime.errors import StepError, is_out_of_memory, remedy_for
from zeroshop_steps.runtime.files import atomic_write

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
BLUR_PX = 1.5  # of photos whose colours are compared: what differs within a pixel or two is noise and print, and cameras are not exact
EXPOSURE_RANGE = (0.5, 2.0)  # between photos: one stop down or up; more is another light or a wrong place
REMAP_COLUMNS = 16384
"""Points are sampled in rows of so many: OpenCV's remap takes images of fewer than 32768 rows and columns."""


def list_images(folder: Path) -> list[Path]:
    """The images of a folder, sorted by name.

    Raises:
        StepError: the folder is missing or holds none, or one of them can be no photo (image_files.py).
    """
    folder = Path(folder)
    paths = [path for path in list_folder(folder) if path.suffix.lower() in IMAGE_SUFFIXES]
    if not paths:
        raise StepError(f"{folder} holds no images; expected files ending in {', '.join(IMAGE_SUFFIXES)}")
    for path in paths:
        check_photo_file(path)
    return paths


def read_image(path: Path) -> np.ndarray:
    """Read an image as (height, width, 3) uint8 RGB, sRGB-encoded.

    EXIF rotation is ignored, because cameras are fitted to the stored pixels.
    """
    return cv2.cvtColor(decode_image(path, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION), cv2.COLOR_BGR2RGB)


def read_mask(path: Path, size_px: tuple[int, int] | None = None) -> np.ndarray:
    """Read a mask as (height, width) bool: True on the object (values of 128 and more).

    Args:
        path: 8-bit image.
        size_px: (width, height) that the mask must have; not checked when None.
    """
    mask = decode_image(path, cv2.IMREAD_GRAYSCALE) >= 128
    if size_px is not None and mask.shape != (size_px[1], size_px[0]):
        raise StepError(
            f"mask {path} is {mask.shape[1]} x {mask.shape[0]} px, its image is {size_px[0]} x {size_px[1]} px; they must be equal"
        )
    return mask


def read_confidence(path: Path, size_px: tuple[int, int]) -> np.ndarray:
    """Read how sure a mask of size (width, height) is: (height, width) float32, 0 to 1."""
    confidence = decode_image(path, cv2.IMREAD_GRAYSCALE)
    if confidence.shape != (size_px[1], size_px[0]):
        found = f"{confidence.shape[1]} x {confidence.shape[0]} px"
        raise StepError(f"{path} is {found}, its image is {size_px[0]} x {size_px[1]} px; delete it, or segment again")
    return confidence.astype(np.float32) / 255.0


DEPTH_STEP_MM = 0.1
"""Of depth images: finer than any camera measures, and up to 6.5 m, farther than anybody holds an object."""


def read_depth_mm(path: Path) -> np.ndarray:
    """Read a 16-bit depth image in 0.1 mm steps as (height, width) float32 mm; 0 where nothing was hit."""
    return decode_image(path, cv2.IMREAD_UNCHANGED).astype(np.float32) * 0.1


def write_image(path: Path, image: np.ndarray) -> None:
    """Write (height, width, 3) uint8 RGB or (height, width) uint8 / uint16, atomically."""
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    # Encoded in memory: OpenCV's own files do not say that the disk is full.
    done, content = cv2.imencode(Path(path).suffix, image)
    if not done:
        raise StepError(f"{path}: an image of {image.shape[1]} x {image.shape[0]} px cannot be encoded as {Path(path).suffix}")
    with atomic_write(path) as temporary:
        temporary.write_bytes(content.tobytes())


def write_mask(path: Path, mask: np.ndarray) -> None:
    """Write a (height, width) bool mask as 8-bit PNG, 0 or 255."""
    write_image(path, mask.astype(np.uint8) * 255)


def write_depth_mm(path: Path, depth_mm: np.ndarray) -> None:
    """Write (height, width) depth in mm as 16-bit PNG in 0.1 mm steps; 0 where nothing was hit."""
    steps = np.rint(depth_mm * 10.0)
    if steps.max(initial=0) > 65535:
        raise StepError(f"{path}: a depth of {steps.max() / 10:.0f} mm is too far for 16 bits of 0.1 mm, which end at 6553 mm")
    write_image(path, np.clip(steps, 0, None).astype(np.uint16))


def require_one_size(sizes_px: Sequence[tuple[int, int]], what: str, reason: str) -> tuple[int, int]:
    """The (width, height) of all images.

    Args:
        sizes_px: of each image.
        what: whose sizes these are, and reason: why they must be equal, with the remedy; for the message.

    Raises:
        StepError: they differ.
    """
    if len(set(sizes_px)) > 1:
        shown = ", ".join(f"{width} x {height}" for width, height in sorted(set(sizes_px)))
        raise StepError(f"{what} several sizes ({shown} px), and {reason}")
    return sizes_px[0]


def measure_border_share(mask: np.ndarray) -> float:
    """Share of the image's circumference that an (H, W) bool mask touches."""
    return int(mask[0].sum() + mask[-1].sum() + mask[:, 0].sum() + mask[:, -1].sum()) / (2 * sum(mask.shape))


def to_rgb(image: Image.Image) -> np.ndarray:
    """(height, width, 3) uint8 RGB of a picture; Pillow alone would cut grey of 16 bits off at 255."""
    if image.mode.startswith("I"):
        grey = np.asarray(image).astype(np.float32) / 257
        return np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
    return np.asarray(image.convert("RGB"))


def compute_overlap(one: np.ndarray, other: np.ndarray) -> float:
    """Intersection over union of two bool arrays of one shape, such as masks."""
    return float((one & other).sum() / max((one | other).sum(), 1))


def spread_colors(image: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(height, width, C) image in which every pixel that is not (height, width) `known` has the colour of the nearest known one."""
    _, labels = cv2.distanceTransformWithLabels((~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    colors = np.zeros((int(labels.max()) + 1, image.shape[2]), image.dtype)
    colors[labels[known]] = image[known]
    return colors[labels]


def sample_bilinear(image: np.ndarray, positions: np.ndarray, border_mode: int) -> np.ndarray:
    """Sample an (H, W) or (H, W, C) image at (N, 2) positions; (N,) or (N, C) float32.

    Args:
        image: of any type.
        positions: x and y with pixel centres at whole numbers; finite.
        border_mode: OpenCV's, for positions off the image; a constant border is 0.
    """
    rows = max(1, -(-len(positions) // REMAP_COLUMNS))
    padded = np.zeros((2, rows * REMAP_COLUMNS), np.float32)
    padded[:, : len(positions)] = positions.T
    map_x, map_y = padded.reshape(2, rows, REMAP_COLUMNS)
    sampled = cv2.remap(image.astype(np.float32), map_x, map_y, cv2.INTER_LINEAR, borderMode=border_mode, borderValue=0)
    return sampled.reshape(rows * REMAP_COLUMNS, *image.shape[2:])[: len(positions)]


def decode_image(path: Path, flags: int) -> np.ndarray:
    """Read an image file with OpenCV's flags. Raises StepError where it is missing, empty, damaged, too large or may not be read."""
    path = Path(path)
    try:
        if not path.is_file():
            raise StepError(f"image {path} does not exist; check the path, or run the step that writes it")
        content = np.frombuffer(path.read_bytes(), np.uint8)
        image = cv2.imdecode(content, flags) if len(content) else None
    except OSError as error:
        raise StepError(f"image {path} cannot be read: {error.strerror}. {remedy_for(error)}") from error
    except cv2.error as error:
        if is_out_of_memory(error):
            raise
        raise StepError(f"image {path} is larger than OpenCV reads (2^30 pixels, 2^20 on a side); export it smaller") from None
    if image is None:
        raise StepError(
            f"image {path} cannot be read: it is empty, damaged or of a format that is not read; export it again as PNG or JPEG"
        )
    return image
