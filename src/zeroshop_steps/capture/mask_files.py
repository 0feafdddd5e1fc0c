"""Read a mask of the user whatever its values: a cut-out, a palette, two levels of any brightness, or a soft edge between them."""

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image

from zeroshop_steps.capture.photo_files import TRANSPOSED, UPRIGHT, PhotoPixels, open_picture, read_cut_out, turn_upright
from zeroshop_steps.runtime.errors import StepError

BLACK, WHITE = 64, 191  # the usual two levels, of 255, and what compression makes of them; half way between, they are parted
MIDDLE = 127.5  # parts black and white
FEW_LEVELS, OBJECT_SHARE = 32, 0.1
"""A mask of so few levels has one for each object, or softened edges: a level counts if it has such a share of what is not background."""
LOSSLESS = ("PNG", "TIFF", "BMP", "GIF")  # as Pillow calls them; others have levels that only compression made
PHOTO_COLORS, MOST_PIXELS, DARK = FEW_LEVELS // 2, 0.8, 16
"""A photo has more colours, of 16 levels a channel, in this share of what has not its usual colour; and a background that was painted
black is so dark, compressed."""
PARTED = 0.9  # share of the variance that two levels explain where they are not black and white: most photos have 0.4 to 0.9
ASPECT_PX = 1.5  # by which the sides of a mask of another size may differ from its photo's aspect: both are rounded


@dataclass(frozen=True)
class UserMask:
    """A mask as it is used.

    Attributes:
        path: the user's file.
        pixels: (height, width) bool, of the photo's size as it is used, upright.
        kind: how it differed from 255 on the object and 0 elsewhere, in words; empty where it did not.
    """

    path: Path
    pixels: np.ndarray
    kind: str = ""


def are_drawn_upright(masks: Mapping[Path, Path]) -> bool:
    """Whether masks, by their photos, are drawn on photos as they are shown: by those whose photo was turned to its side, which shows."""
    for photo, mask in masks.items():
        with contextlib.suppress(StepError), open_picture(photo) as image, _open_mask(mask) as drawn:
            turned = image.getexif().get(ExifTags.Base.Orientation) in TRANSPOSED and ExifTags.Base.Orientation not in drawn.getexif()
            if turned and _agree(drawn.size, image.size[::-1]) and not _agree(drawn.size, image.size):
                return True
    return False


def read_user_mask(path: Path, photo_path: Path, photo: PhotoPixels, upright: bool = False) -> UserMask:
    """The mask of a photo; drawn on the photo as it is stored or as it is shown, of its size or of another one of its aspect.

    Args:
        path, photo_path, photo: the mask's file, the photo's, and what is in that.
        upright: whether a mask that fits both ways is drawn on the photo as it is shown.

    Raises:
        StepError: it cannot be read, has the wrong size, or shows nothing or neither of two levels.
    """
    with _open_mask(path) as image:
        mask, kind = _find_object(image, path, photo_path)
        paged = f"the first of {pages} pictures in a file" if (pages := getattr(image, "n_frames", 1)) > 1 else ""
        own_orientation = int(image.getexif().get(ExifTags.Base.Orientation, UPRIGHT))
    mask, scaled = _fit(mask, own_orientation, path, photo_path, photo, upright)
    return UserMask(path, mask, ", ".join(filter(None, (kind, scaled, paged))))


def _open_mask(path: Path) -> contextlib.AbstractContextManager[Image.Image]:
    """Open a picture, or the (H, W) array of a file by NumPy as one."""
    if path.suffix.lower() != ".npy":
        return open_picture(path)
    try:
        array = np.load(path, allow_pickle=False)
        array = array[..., 0] if array.ndim == 3 and array.shape[2] == 1 else array
        if array.ndim != 2 or array.dtype not in (bool, np.uint8):
            raise ValueError(f"its shape is {array.shape}, its type {array.dtype}")
    except (OSError, ValueError, EOFError) as error:
        raise StepError(f"mask {path} cannot be used ({error}); save a (height, width) array of bool or uint8, or a PNG") from None
    return Image.fromarray(array)


def _find_object(image: Image.Image, path: Path, photo_path: Path) -> tuple[np.ndarray, str]:
    """(H, W) bool as stored, and the kind of mask in words."""
    if (opaque := read_cut_out(image)) is not None:
        return opaque, "" if path == photo_path else "cut-outs, all but the object transparent"
    if path == photo_path:
        shown = "nothing" if not image.has_transparency_data or np.asarray(image.convert("RGBA").getchannel("A")).any() else "all"
        raise StepError(
            f"photo {path} is given as its own mask, but {shown} in it is transparent; remove its background alone, or take it out"
        )
    if image.mode == "P":
        levels = np.array(image.getpalette("RGB"), np.int32).reshape(-1, 3)
        indices = np.asarray(image)
        used = np.unique(indices)
        colors = levels[np.minimum(used, len(levels) - 1)]
        if (np.ptp(colors, axis=1) > 0).any() or len(np.unique(colors[:, 0])) < len(used):
            black = used[~colors.any(1)]  # programs that choose a palette for each picture may put it anywhere
            background = int(black[0]) if len(black) == 1 else 0
            return indices != background, f"palettes, index {background} the background{_tell_labels(used[used != background])}"
        return _part(levels[np.minimum(indices, len(levels) - 1), 0], path, lossless=True)
    pixels = np.asarray(image.convert("RGB") if image.mode in ("CMYK", "YCbCr", "LAB", "HSV") else image)
    if pixels.ndim == 3:
        # A colour is bright in one channel; that of an alpha channel, which says nothing here, does not count.
        colors = pixels[..., : 1 if pixels.shape[2] == 2 else 3]
        pixels = colors.max(2)
        if _is_photo(colors):
            if np.median(np.concatenate([pixels[[0, -1]].ravel(), pixels[:, [0, -1]].ravel()])) > DARK:
                raise StepError(f"mask {path} has the colours of a photo; make it white on the object, black elsewhere: is it the photo?")
            return pixels > (0 if image.format in LOSSLESS else DARK), "photos of the object on black"
        if 2 * int(pixels.min()) >= int(pixels.max()) > 0 and (marked := _part_by_place(colors)) is not None:
            return marked, "colours of equal brightness, the one at the border the background"
    return _part(pixels, path, image.format in LOSSLESS)


def _is_photo(colors: np.ndarray) -> bool:
    """Whether an (H, W, C) picture has many colours besides its usual one."""
    codes = (colors.astype(np.int32) >> 4 << 4 * np.arange(colors.shape[2])).sum(2)
    counts = np.sort(np.unique(codes, return_counts=True)[1])[-2::-1]
    return bool(np.ptp(colors, axis=2).any()) and np.searchsorted(np.cumsum(counts), MOST_PIXELS * counts.sum()) >= PHOTO_COLORS


def _part_by_place(colors: np.ndarray) -> np.ndarray | None:
    """(H, W) bool: what has not the usual colour of the border, in an (H, W, C) picture of few colours; None in another picture."""
    codes = (colors.astype(np.int32) << 8 * np.arange(colors.shape[2])).sum(2)
    found, counts = np.unique(np.concatenate([codes[[0, -1]].ravel(), codes[:, [0, -1]].ravel()]), return_counts=True)
    marked: np.ndarray = codes != found[counts.argmax()]
    grey = (colors == colors[..., :1]).all()
    return marked if not grey and marked.any() and len(np.unique(codes[marked])) < FEW_LEVELS else None


def _part(levels: np.ndarray, path: Path, lossless: bool) -> tuple[np.ndarray, str]:
    """The brighter of the two levels of an (H, W) picture, and which ones they are."""
    values, counts = np.unique(levels, return_counts=True)
    low, high = float(values[0]), float(values[-1])
    if low == high:
        return np.full(levels.shape, high > 0), ""
    objects = values[1:][counts[1:] > OBJECT_SHARE * counts[1:].sum()] if lossless and len(values) <= FEW_LEVELS else values[2:2]
    if len(values) == 2:
        limit = (low + high) / 2
    elif len(objects):
        limit = _halve(low, float(objects[0]))
    else:
        limit = _find_limit(levels.astype(np.float64), path)
    marked: np.ndarray = levels > limit
    if levels.dtype == bool or limit == MIDDLE:
        return marked, ""
    if len(values) == 2:
        return marked, f"level {high:g} on the object"
    return marked, f"levels above {limit:g} on the object{_tell_labels(objects)}" if len(objects) else "grey, parted half way between two"


def _tell_labels(labels: np.ndarray) -> str:
    """That several labels count as one object, in words; empty of a single one."""
    named = ", ".join(map(str, labels[:FEW_LEVELS])) + " and more" * (len(labels) > FEW_LEVELS)
    return f", labels {named} together as one object" if len(labels) > 1 else ""


def _find_limit(levels: np.ndarray, path: Path) -> float:
    """The level half way between the two that part a picture best (Ridler and Calvard, 1978)."""
    from skimage.filters import threshold_isodata

    above = levels > threshold_isodata(levels)
    dark, bright = float(levels[~above].mean()), float(levels[above].mean())
    share = float(above.mean())
    if _halve(dark, bright) != MIDDLE and share * (1 - share) * (bright - dark) ** 2 < PARTED * levels.var():
        raise StepError(
            f"mask {path} has levels from {levels.min():g} to {levels.max():g} and is neither black nor white: it must have two levels,"
            " the brighter one on the object; is it the photo itself?"
        )
    return _halve(dark, bright)


def _halve(dark: float, bright: float) -> float:
    """The level that parts two: the usual one where they are black and white."""
    return MIDDLE if dark < BLACK and WHITE < bright <= 255 else (dark + bright) / 2


def _fit(mask: np.ndarray, own_orientation: int, path: Path, photo_path: Path, photo: PhotoPixels, upright: bool) -> tuple[np.ndarray, str]:
    """A mask as stored, upright and of its photo's size as it is used, and whether it was scaled, in words."""
    stored_px, drawn_px = photo.stored_px, mask.shape[::-1]
    shown_px = stored_px[::-1] if photo.orientation in TRANSPOSED else stored_px
    shown, turned = None, ""
    as_stored = drawn_px == stored_px or (drawn_px != shown_px and _agree(drawn_px, stored_px))
    as_shown = drawn_px == shown_px or (drawn_px != stored_px and _agree(drawn_px, shown_px))
    if own_orientation != UPRIGHT:
        own = turn_upright(mask, own_orientation)
        shown = own if _agree(own.shape[::-1], shown_px) else None
    elif as_shown and (upright or not as_stored):
        shown = mask
    elif as_stored:
        shown = turn_upright(mask, photo.orientation)
        if as_shown and photo.orientation != UPRIGHT:
            turned = f"drawn on the photos before they are turned (EXIF orientation {photo.orientation})"
    if shown is None:
        hint = " (one of the two is stored turned: export both again)" if _agree(drawn_px, stored_px[::-1]) else ""
        raise StepError(
            f"mask {path} is {drawn_px[0]} x {drawn_px[1]} px, its image {photo_path.name} is {stored_px[0]} x {stored_px[1]} px;"
            f" they must be equal, or have one aspect{hint}"
        )
    if sorted(drawn_px) != sorted(stored_px):
        turned = ", ".join(filter(None, (turned, f"scaled from {drawn_px[0]} x {drawn_px[1]} px to the photo's size")))
    if shown.shape[::-1] == photo.size_px:
        return shown, turned
    how = Image.Resampling.BOX if shown.shape[1] > photo.size_px[0] else Image.Resampling.BILINEAR
    return np.asarray(Image.fromarray(shown.astype(np.uint8) * 255).resize(photo.size_px, how)) > MIDDLE, turned


def _agree(one_px: tuple[int, ...], other_px: tuple[int, ...]) -> bool:
    """Whether two sizes have one aspect."""
    return abs(one_px[0] * other_px[1] - one_px[1] * other_px[0]) <= ASPECT_PX * max(*one_px, *other_px)
