"""Faults of masks and films of the user that other tools took in silence."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from faults.photos import HEIGHT_PX, WIDTH_PX, take_photos
from helpers.faults import Fault, step
from zeroshop_steps.geometry.imaging.images import read_image, write_image

ROWS, COLUMNS = np.mgrid[:HEIGHT_PX, :WIDTH_PX]
DISK = (COLUMNS - WIDTH_PX / 2) ** 2 + (ROWS - HEIGHT_PX / 2) ** 2 < 40**2


def masks_as(name: str, make: Callable[[Path], np.ndarray]) -> Callable[[Path], int]:
    """Import photos with masks of such names and such pixels; `make` gets the photo."""

    def run(folder: Path) -> int:
        photos = take_photos(folder)
        for photo in photos.iterdir():
            write_image(folder / "masks" / name.format(stem=photo.stem), make(photo))
        return step("capture", "photos", images=photos, masks=folder / "masks", out=folder / "capture")

    return run


def no_own_masks(folder: Path) -> int:
    """Photos as their own masks, of which none is transparent."""
    photos = take_photos(folder)
    return step("capture", "photos", images=photos, masks=photos, out=folder / "capture")


def one_without(folder: Path) -> int:
    """A mask that is missing among eight that have COLMAP's names."""
    photos = take_photos(folder)
    for number in range(7):
        write_image(folder / f"masks/{number}.jpg.png", DISK.astype(np.uint8) * 255)
    return step("capture", "photos", images=photos, masks=folder / "masks", out=folder / "capture")


def one_inverted(folder: Path) -> int:
    """A mask of the background among seven of the object."""
    return masks_as("{stem}.png", lambda photo: (DISK if photo.stem != "3" else ~DISK).astype(np.uint8) * 255)(folder)


def masks_of_lfs(folder: Path) -> int:
    """Masks of a repository that was cloned without its large files."""
    photos = take_photos(folder)
    (folder / "masks").mkdir()
    for photo in photos.iterdir():
        (folder / f"masks/{photo.stem}.png").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n")
    return step("capture", "photos", images=photos, masks=folder / "masks", out=folder / "capture")


def arrays_as_masks(folder: Path) -> int:
    """Masks as archives of NumPy's arrays, and a folder of more."""
    photos = take_photos(folder)
    (folder / "masks/more").mkdir(parents=True)
    np.savez(folder / "masks/0.npz", DISK)
    return step("capture", "photos", images=photos, masks=folder / "masks", out=folder / "capture")


def inverted_palette(folder: Path) -> int:
    """Palettes whose index 0 is the object."""
    photos = take_photos(folder)
    (folder / "masks").mkdir()
    for photo in photos.iterdir():
        image = Image.fromarray((~DISK).astype(np.uint8), "P")
        image.putpalette([0, 0, 0, 128, 0, 0])
        image.save(folder / f"masks/{photo.stem}.png")
    return step("capture", "photos", images=photos, masks=folder / "masks", out=folder / "capture")


POLARITY = ("seem inverted", r"white \(255\) on the object and black \(0\) elsewhere", "invert them")
FAULTS = [
    Fault("inverted masks", masks_as("{stem}.png", lambda photo: (~DISK).astype(np.uint8) * 255), ("masks", *POLARITY)),
    Fault("masks that Git LFS has not fetched", masks_of_lfs, (r"3\.png is a pointer of Git LFS", "git lfs pull")),
    Fault("inverted palettes", inverted_palette, ("8 of 8 photos", *POLARITY)),
    Fault(
        "masks of other names",
        masks_as("segment_a{stem}b{stem}.png", lambda photo: DISK.astype(np.uint8) * 255),
        (
            r"no mask in .*masks is named like a photo: it holds segment_a0b0\.png",
            r"expected for 0\.jpg one of 0\.png, 0\.jpg\.png, 0_mask\.png",
        ),
    ),
    Fault(
        "photos as masks",
        masks_as("{stem}.png", read_image),
        (r"mask .*0\.png has the colours of a photo", "white on the object", "is it the photo"),
    ),
    Fault(
        "no photo is cut out", no_own_masks, (r"0\.jpg is given as its own mask", "nothing in it is transparent", "remove its background")
    ),
    Fault("one inverted mask", one_inverted, (r"mask .*3\.png marks the border nearly all around", "invert it", "7 of them usable")),
    Fault(
        "arrays as masks",
        arrays_as_masks,
        ("holds no pictures, which masks are", r"it holds 0\.npz, more/;", r"expected for 0\.jpg one of 0\.png"),
    ),
    Fault("one mask is missing", one_without, (r"7\.jpg has no mask", r"named for it as 0\.jpg\.png is for 0\.jpg", "draw one")),
    Fault(
        "a mask of half the width",
        masks_as("{stem}.png", lambda photo: DISK[:, ::2].astype(np.uint8) * 255),
        (r"mask .*0\.png is 80 x 120 px", r"0\.jpg is 160 x 120 px", "must be equal, or have one aspect"),
    ),
]
