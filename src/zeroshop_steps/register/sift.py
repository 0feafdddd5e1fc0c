"""SIFT features and their verified matches between image pairs, in a COLMAP database.

Affine shape estimation is what carries over the wide baselines of ten views a ring: without it, half a ring can end
up a metre off with a reprojection error of 0.2 px.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from zeroshop_steps.geometry.images import read_image, write_image
from zeroshop_steps.geometry.view_similarity import count_common_features, describe_view
from zeroshop_steps.register.database import create_database
from zeroshop_steps.register.image_set import ImageSet, read_masks
from zeroshop_steps.register.lenses import import_images
from zeroshop_steps.register.pair_selection import choose_alike_pairs

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


def match_features(database: Path, options: SiftOptions, pairs: list[tuple[str, str]] | None = None) -> None:
    """Match image pairs and keep what one epipolar geometry (or homography) explains.

    Args:
        database: with the features of all images.
        options: see `SiftOptions`.
        pairs: names of the images of each pair; None for all pairs.
    """
    verification = make_verification_options(options.seed)
    if pairs is None:
        pycolmap.match_exhaustive(database, make_matching_options(), verification_options=verification)
        return
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = write_pairs(database, pairs)
    pycolmap.match_image_pairs(database, make_matching_options(), pairing, verification)


def write_pairs(database: Path, pairs: list[tuple[str, str]]) -> Path:
    """Write names of the images of each pair beside a database, as COLMAP reads them; returns the file."""
    path = Path(database).with_name("pairs.txt")
    path.write_text("".join(f"{first} {second}\n" for first, second in pairs))
    return path


def choose_name_pairs(image_set: ImageSet, options: SiftOptions, object_only: bool = False) -> list[tuple[str, str]] | None:
    """The pairs of images to match, by their names, found from few features of small copies; None for all pairs."""
    if len(image_set.images) <= (options.all_pairs if image_set.film else options.all_photo_pairs):
        return None
    masks = read_masks(image_set) if object_only else {}
    descriptors = [describe_view(read_image(path), masks.get(path.name)) for path in image_set.images]
    chosen = choose_alike_pairs(count_common_features(descriptors), options.neighbours)
    return [(image_set.names[one], image_set.names[other]) for one, other in chosen]


def make_extraction_options(options: SiftOptions, first_octave: int) -> pycolmap.FeatureExtractionOptions:
    """Options of the extraction: SIFT with affine shapes."""
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.num_threads = options.threads
    extraction.max_image_size = options.max_side_px
    extraction.sift.estimate_affine_shape = True
    extraction.sift.max_num_features = options.max_features
    extraction.sift.first_octave = first_octave
    return extraction


def make_matching_options() -> pycolmap.FeatureMatchingOptions:
    """Options of the descriptor matching: on one thread, whatever else runs on more.

    pycolmap 4.2.1 holds a BLAS that is not safe to call from two threads at once, and its matcher's threads do: in about
    one run of forty over ten images on two threads, pairs lost some or all of their matches, and nothing said so. In 400
    runs on one thread none did. Over 20 images one thread takes 5.5 s, two take 2.9 s.
    """
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = 1
    return matching


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


def make_verification_options(seed: int) -> pycolmap.TwoViewGeometryOptions:
    """Options of the geometric verification, with a fixed seed."""
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    return verification


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


def _write_feature_masks(folder: Path, image_set: ImageSet) -> Path:
    """Masks under the names that COLMAP looks for, less a rim: features on the silhouette slide along the object."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, mask in read_masks(image_set).items():
        rim_px = max(1, round(max(mask.shape) * RIM_SHARE))
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * rim_px + 1, 2 * rim_px + 1))
        write_image(folder / f"{name}.png", cv2.erode(mask.astype(np.uint8) * 255, kernel, borderValue=255))
    return folder
