"""Which images were taken with one lens at one setting, so that they share a camera model.

Images share a lens where they have one size and, as far as EXIF says, were taken by one camera at one focal length. A photo that was
held upright has another size than one that was not, so it gets a lens of its own: nothing tells which way its sensor was turned.

EXIF states the focal length on 35 mm film, which is that of the whole picture. Photos that were cropped keep it.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from PIL import Image
from PIL.ExifTags import IFD, Base

from zeroshop_steps.register.scene.database import create_database
from zeroshop_steps.register.scene.image_set import ImageSet

FILM_SIDES_MM = (36.0, 24.0)
SAME = 1.02  # up to this factor, ratios of the sides of two pictures are one shape, and focal lengths one setting of a zoom
FARTHEST, RADII = 3.0, 600  # of the pinhole picture, in half diagonals, up to which the distortion is followed, and in how many steps


def group_by_lens(image_set: ImageSet) -> list[list[str]]:
    """Names of the images of each lens, in the order of the images' names."""
    keys = [(size, *_read_camera(path)) for path, size in zip(image_set.images, image_set.sizes_px, strict=True)]
    groups: list[tuple[tuple, list[str]]] = []
    for name, key in zip(image_set.names, keys, strict=True):
        names = next((names for other, names in groups if _is_one_lens(key, other)), None)
        if names is None:
            groups.append((key, [name]))
        else:
            names.append(name)
    return [names for _, names in groups]


def import_images(database: Path, image_set: ImageSet, focal_px: float | None = None, distorted: bool = True) -> None:
    """Write a camera for each lens, and all images, into a new database; the mapper finds the lenses' parameters.

    It starts from lenses that came with the capture, where there are any, whatever else is known.

    Args:
        database: file to create.
        image_set: what to import.
        focal_px: known focal length, in pixels of the largest images; None reads EXIF, else estimates it from the longer side.
        distorted: whether lenses may be distorted; points of an object in the middle of the images do not tell.
    """
    if image_set.lenses is not None:
        return import_with_cameras(database, image_set, image_set.lenses)
    sizes = dict(zip(image_set.names, image_set.sizes_px, strict=True))
    paths = dict(zip(image_set.names, image_set.images, strict=True))
    longest_px = max(map(max, image_set.sizes_px))
    create_database(database, len(image_set.images))
    for names in group_by_lens(image_set):
        reader = pycolmap.ImageReaderOptions()
        reader.camera_model = "SIMPLE_RADIAL" if distorted else "SIMPLE_PINHOLE"
        width, height = sizes[names[0]]
        if focal_px is not None:
            lens_focal_px: float | None = focal_px * max(width, height) / longest_px
        else:
            lens_focal_px = read_cropped_focal_px(paths[names[0]], (width, height))
        if lens_focal_px is not None:
            reader.camera_params = f"{lens_focal_px},{width / 2},{height / 2}" + (",0" if distorted else "")
        pycolmap.import_images(database, image_set.images[0].parent, pycolmap.CameraMode.SINGLE, names, reader)


def folds(lens: pycolmap.Camera) -> bool:
    """Whether the distortion of a lens folds the picture: from some radius on, what is farther out comes out nearer to the middle.

    No lens of a camera does. Where few points in the middle of the pictures say what the distortion is, it can come out so, together with
    a focal length that is far off.
    """
    middle = np.array([lens.principal_point_x, lens.principal_point_y])
    corner = np.maximum(middle, [lens.width, lens.height] - middle)
    steps = np.linspace(0.0, FARTHEST, RADII)[:, None] * corner / lens.mean_focal_length()
    pixels = lens.img_from_cam(np.column_stack([steps, np.ones(RADII)]))
    radii = np.linalg.norm(pixels - middle, axis=1)
    turns = np.flatnonzero(np.diff(radii) <= 0)
    return len(turns) > 0 and bool(radii[turns[0]] < np.linalg.norm(corner))


def read_cropped_focal_px(path: Path, size_px: tuple[int, int]) -> float | None:
    """The focal length in pixels of a photo that was cropped, by its EXIF; None where it is whole, or EXIF does not tell.

    A crop is taken to reach across the whole picture one way. The picture's size is in EXIF where editors left it; a square photo without
    it is a crop of 3:2. The focal length is that on film of the same diagonal, as COLMAP reads those of whole photos.

    Args:
        path: the photo.
        size_px: its (width, height).
    """
    details = _read_exif(path)[1]
    focal_mm = _read_number(details, Base.FocalLengthIn35mmFilm)
    whole = sorted(_read_number(details, tag) for tag in (Base.ExifImageWidth, Base.ExifImageHeight))
    short, long = sorted(size_px)
    if focal_mm <= 0:
        return None
    if whole[0] > 0 and max(whole[1] / whole[0] * short / long, whole[0] / whole[1] * long / short) > SAME:
        scale = max(short / whole[0], long / whole[1])
        diagonal_px = math.hypot(*whole) * scale
    elif long <= SAME * short:
        diagonal_px = short * math.hypot(*FILM_SIDES_MM) / min(FILM_SIDES_MM)
    else:
        return None
    return focal_mm * diagonal_px / math.hypot(*FILM_SIDES_MM)


def _read_camera(path: Path) -> tuple[str, str, float]:
    """Make and model of the camera, and its focal length in mm (0 if unknown), of the 35 mm film if that is known."""
    exif, details = _read_exif(path)
    focal_mm = _read_number(details, Base.FocalLengthIn35mmFilm) or _read_number(details, Base.FocalLength)
    return str(exif.get(Base.Make, "")), str(exif.get(Base.Model, "")), focal_mm


def _read_exif(path: Path) -> tuple[Image.Exif, dict[int, Any]]:
    """A photo's EXIF tags, and those about how it was taken."""
    with Image.open(path) as image:
        exif = image.getexif()
        return exif, exif.get_ifd(IFD.Exif)


def _read_number(details: dict[int, Any], tag: int) -> float:
    """A tag's number; 0 where there is none."""
    try:
        return float(details.get(tag) or 0.0)
    except (TypeError, ValueError, ZeroDivisionError):
        return 0.0


def _is_one_lens(one: tuple, other: tuple) -> bool:
    near = one[-1] == other[-1] or (min(one[-1], other[-1]) > 0 and max(one[-1], other[-1]) < SAME * min(one[-1], other[-1]))
    return bool(one[:-1] == other[:-1] and near)


def import_with_cameras(database: Path, image_set: ImageSet, known_cameras: dict[str, pycolmap.Camera]) -> None:
    """Write {image stem: camera} and the images into a new database; one camera where all are equal."""
    distinct = {(camera.width, camera.height, *camera.params) for camera in known_cameras.values()}
    mode = pycolmap.CameraMode.PER_IMAGE if len(distinct) > 1 else pycolmap.CameraMode.SINGLE
    create_database(database, len(image_set.images))
    pycolmap.import_images(database, image_set.images[0].parent, mode, image_set.names)
    with pycolmap.Database.open(database) as opened:
        for image in opened.read_all_images():
            camera = known_cameras[Path(image.name).stem]
            fields = {"model": camera.model, "width": camera.width, "height": camera.height, "params": camera.params}
            opened.update_camera(pycolmap.Camera({**fields, "camera_id": image.camera_id, "has_prior_focal_length": True}))
