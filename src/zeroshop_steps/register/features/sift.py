"""SIFT features and their verified matches between image pairs, in a COLMAP database.

Affine shape estimation is what carries over the wide baselines of ten views a ring: without it, half a ring can end
up a metre off with a reprojection error of 0.2 px.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.register.scene.image_set import ImageSet, read_masks
from zeroshop_steps.register.scene.lenses import import_images, import_with_cameras

FINEST_OCTAVE = -1  # starts at twice the image's resolution
RIM_SHARE = 1 / 500  # of the longer side: width of the rim of a mask that gives no features


@dataclass(frozen=True)
class SiftOptions:
    """What to extract and how to match.

    Attributes:
        max_features: features an image, the largest scales first.
        first_octave: 0 starts at the image's own resolution, -1 at twice that (four times the work).
        enough_features: extraction is repeated at octave -1 when the median image has fewer features (and less than half the most).
        focal_px: known focal length; None reads EXIF, else estimates.
        max_side_px: larger images are reduced to it for the features alone.
        many_max_features, many_max_side_px: instead of these, where there are more than `all_pairs` images: they overlap more, so
            that fewer features of each do (60 images of 1920 x 1440 px: 153 s instead of 224 s, centres within 0.09 mm in both).
        all_pairs, all_photo_pairs: up to so many frames of a film, or photos, all pairs are matched. Photos overlap less: of a head in 57
            photos, what is most alike left the focal length 2.6 % off, all pairs 0.02 %.
        neighbours: of more images, each is matched with so many that are most like it.
        threads: worker threads of the extraction.
        seed: of RANSAC.
    """

    max_features: int = 4000
    first_octave: int = 0
    enough_features: int = 1500
    focal_px: float | None = None
    max_side_px: int = 1600
    many_max_features: int = 3000
    many_max_side_px: int = 1280
    all_pairs: int = 30
    all_photo_pairs: int = 60
    neighbours: int = 14
    threads: int = 2
    seed: int = 0


def extract_features(
    database: Path,
    image_set: ImageSet,
    options: SiftOptions,
    mask_folder: Path | None = None,
    known_cameras: dict[str, pycolmap.Camera] | None = None,
) -> tuple[float, int]:
    """Write a camera for each lens and the features of all images into a new database.

    Args:
        database: file to create.
        image_set: what to read.
        options: see `SiftOptions`.
        mask_folder: where to put feature masks; features then come from the object alone. None uses whole images.
        known_cameras: {image stem: camera} to write instead of unknown lenses; shared where they are all equal.

    Returns:
        The median number of features an image, and the first octave that they were taken from.
    """
    reader = pycolmap.ImageReaderOptions()
    if mask_folder is not None:
        reader.mask_path = _write_feature_masks(mask_folder, image_set)
    folder = image_set.images[0].parent
    median, octave = 0.0, options.first_octave
    for octave in sorted({options.first_octave, FINEST_OCTAVE}, reverse=True):
        Path(database).unlink(missing_ok=True)
        # Images get their numbers here, in order of name; extraction alone numbers them in the order its threads finish.
        if known_cameras is None:
            import_images(database, image_set, options.focal_px)
        else:
            import_with_cameras(database, image_set, known_cameras)
        extraction = make_extraction_options(options, octave)
        pycolmap.extract_features(database, folder, image_set.names, pycolmap.CameraMode.AUTO, reader, extraction)
        with pycolmap.Database.open(database) as opened:
            median = float(np.median([opened.num_keypoints_for_image(image.image_id) for image in opened.read_all_images()]))
        if median >= min(options.enough_features, options.max_features // 2):
            break
    return median, octave


def make_extraction_options(options: SiftOptions, first_octave: int) -> pycolmap.FeatureExtractionOptions:
    """Options of the extraction: SIFT with affine shapes."""
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.num_threads = options.threads
    extraction.max_image_size = options.max_side_px
    extraction.sift.estimate_affine_shape = True
    extraction.sift.max_num_features = options.max_features
    extraction.sift.first_octave = first_octave
    return extraction


def fit_to_count(options: SiftOptions, count: int) -> SiftOptions:
    """The options for so many images."""
    if count <= options.all_pairs:
        return options
    features, side_px = min(options.max_features, options.many_max_features), min(options.max_side_px, options.many_max_side_px)
    return replace(options, max_features=features, max_side_px=side_px)


def refine(options: SiftOptions, octave: int, count: int) -> SiftOptions | None:
    """The options that find more features, though slower, where those that fit to so many images found too few; None if there are none.

    Args:
        octave: the first one that features were taken from.
    """
    used = replace(fit_to_count(options, count), first_octave=octave)
    finer = replace(options, first_octave=FINEST_OCTAVE)
    return None if used == finer else finer


def find_focal_source(database: Path) -> str:
    """Where the focal length comes from with which the mapper starts: `exif`, or `estimated`, a guess from the images' size."""
    with pycolmap.Database.open(database) as opened:
        return "exif" if all(camera.has_prior_focal_length for camera in opened.read_all_cameras()) else "estimated"


def _write_feature_masks(folder: Path, image_set: ImageSet) -> Path:
    """Masks under the names that COLMAP looks for, less a rim: features on the silhouette slide along the object."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, mask in read_masks(image_set).items():
        rim_px = max(1, round(max(mask.shape) * RIM_SHARE))
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * rim_px + 1, 2 * rim_px + 1))
        write_image(folder / f"{name}.png", cv2.erode(mask.astype(np.uint8) * 255, kernel, borderValue=255))
    return folder
