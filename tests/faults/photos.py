"""Faults of a user's own photos."""

import os
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from helpers.faults import Fault, step
from zeroshop_steps.geometry.imaging.images import write_image

WIDTH_PX, HEIGHT_PX = 160, 120


def take_photos(folder: Path, width_px: int = WIDTH_PX, height_px: int = HEIGHT_PX, count: int = 8) -> Path:
    """A folder of photos that differ."""
    for index in range(count):
        blocks = np.random.default_rng(index).integers(0, 255, (12, 16, 3), dtype=np.uint8)
        write_image(folder / "photos" / f"{index}.jpg", cv2.resize(blocks, (width_px, height_px), interpolation=cv2.INTER_NEAREST))
    return folder / "photos"


def capture_with(spoil: Callable[[Path], object]) -> Callable[[Path], int]:
    """Import photos of which `spoil` spoils some."""

    def run(folder: Path) -> int:
        photos = take_photos(folder)
        (photos / "0.jpg").unlink()  # too few are left, unless the spoilt one can be used
        spoil(photos)
        return step("capture", "photos", images=photos, out=folder / "capture")

    return run


def register_small(folder: Path, width_px: int, height_px: int) -> int:
    """Register a capture of small photos that was made by other means."""
    take_photos(folder, width_px, height_px).rename(folder / "images")
    return step("register", "colmap", capture=folder, scene="video", out=folder / "cameras")


def register_gif(folder: Path) -> int:
    """Register a capture with a GIF under the name of a JPEG."""
    save_as("x.jpg", "GIF")(take_photos(folder))
    (folder / "photos").rename(folder / "images")
    return step("register", "colmap", capture=folder, scene="video", out=folder / "cameras")


def link_in_a_circle(photos: Path) -> None:
    """A link to a link to itself."""
    (photos / "a.jpg").symlink_to(photos / "b.jpg")
    (photos / "b.jpg").symlink_to(photos / "a.jpg")


def save_as(name: str, image_format: str) -> Callable[[Path], None]:
    """A picture of another format under a photo's name."""
    return lambda photos: Image.new("RGB", (WIDTH_PX, HEIGHT_PX), "red").save(photos / name, image_format)


def fill(name: str, content: bytes) -> Callable[[Path], int]:
    """Other content in a photo's file."""
    return lambda photos: (photos / name).write_bytes(content)


def write_huge_header(photos: Path) -> None:
    """A PNG that says it has 2^34 pixels."""
    path = photos / "huge.png"
    write_image(path, np.zeros((HEIGHT_PX, WIDTH_PX, 3), np.uint8))
    content = bytearray(path.read_bytes())
    content[16:24] = (1 << 17).to_bytes(4, "big") * 2
    content[29:33] = zlib.crc32(bytes(content[12:29])).to_bytes(4, "big")
    path.write_bytes(bytes(content))


def name_in_latin_1(photos: Path) -> None:
    """A name that is no UTF-8, as an old camera or archive gives it."""
    os.rename(photos / "1.jpg", os.fsencode(photos) + b"/Gr\xfc\xdfe.jpg")


FAULTS = [
    Fault(
        "a photo of floats",
        capture_with(lambda photos: Image.fromarray(np.ones((HEIGHT_PX, WIDTH_PX), np.float32)).save(photos / "x.tif")),
        (r"x\.tif has floating-point pixels", "export it again as JPEG or PNG"),
    ),
    Fault("a name in Latin-1", capture_with(name_in_latin_1), (r"Gr\\xfc\\xdfe\.jpg is not UTF-8", "rename it")),
    *(
        Fault(
            f"photos of {width} x {height} px",
            lambda folder, width=width, height=height: register_small(folder, width, height),
            (rf"0\.jpg is {width} x {height} px", "at least 32 px", "take the photo as the camera stored it"),
        )
        for width, height in ((8, 6), (14, 14), (20, 15), (31, 80))
    ),
    Fault("a folder named .jpg", capture_with(lambda photos: (photos / "x.jpg").mkdir()), (r"x\.jpg is a folder", "remove it")),
    Fault("a pipe named .jpg", capture_with(lambda photos: os.mkfifo(photos / "x.jpg")), (r"x\.jpg is no file", "remove it")),
    Fault("a loop of links", capture_with(link_in_a_circle), (r"a\.jpg is a link that leads nowhere", "remove it")),
    Fault("a GIF named .jpg in a capture", register_gif, (r"x\.jpg is named \.jpg, but holds GIF", "export it as JPEG")),
    Fault("2^34 pixels", capture_with(write_huge_header), (r"huge\.png has 131072 x 131072 px", "more than 250 megapixels", "reduce it")),
    Fault("an empty file", capture_with(fill("3.jpg", b"")), (r"3\.jpg", "empty, damaged", "export it again")),
    Fault("half a header", capture_with(fill("3.jpg", b"\xff\xd8\xff\xe0")), (r"3\.jpg", "export it again")),
    Fault("text named .jpg", capture_with(fill("3.jpg", b"a photo")), (r"3\.jpg", "export it again")),
]
