"""COLMAP's database of features and matches, made only where there is room for it, and its pairs of images."""

from pathlib import Path

import numpy as np
import pycolmap

from zeroshop_steps.runtime.compute.machine import require_memory, require_room

LEAST_TIES = 30
"""Matches of a pair that tie two images, or tell anything of them: pairs that show nothing in common have up to 20 by chance."""
IMAGE_BYTES = 2_000_000
"""Of an image in the database: its features, and its share of the matches. 60 photos with 4000 features each took 47 MB."""
MEMORY_BYTES = 1_500_000_000
"""Of address space, for COLMAP's threads and two images with their scale spaces."""


def create_database(path: Path, images: int) -> None:
    """Create an empty database for so many images.

    COLMAP ends the whole process where one of its threads finds the disk or the memory full.

    Raises:
        StepError: there is no room for it.
    """
    require_room(path.parent, images * IMAGE_BYTES, f"the features of {images} images")
    require_memory(MEMORY_BYTES, f"the features of {images} images")
    pycolmap.Database.open(path).close()


def read_places(opened: pycolmap.Database) -> dict[int, np.ndarray]:
    """{image id: (K, 2) float64 places of its keypoints} of all images."""
    ids = [image.image_id for image in opened.read_all_images()]
    return {image_id: opened.read_keypoints(image_id)[:, :2].astype(np.float64).reshape(-1, 2) for image_id in ids}


def read_matches(opened: pycolmap.Database, verified: bool = True) -> list[tuple[tuple[int, int], np.ndarray]]:
    """The ids of two images, the first smaller, and the (M, 2) numbers of the keypoints that match, verified or not, of all pairs."""
    ids, found = opened.read_two_view_geometries() if verified else opened.read_all_matches()
    matches = [one.inlier_matches for one in found] if verified else found
    return [(pycolmap.pair_id_to_image_pair(pair_id), one) for pair_id, one in zip(ids, matches, strict=True)]


def has_wide_lens(database: Path) -> bool:
    """Whether a lens of a database is a fisheye, as `wide_lens.set_lenses` makes those that the matches show to be wide."""
    with pycolmap.Database.open(database) as opened:
        return any(camera.model.name.endswith("FISHEYE") for camera in opened.read_all_cameras())


def delete_pair(opened: pycolmap.Database, first: int, second: int) -> None:
    """Delete all matches, and what was verified of them, of two images by their ids."""
    opened.delete_matches(first, second)
    opened.delete_two_view_geometry(first, second)


def replace_features(opened: pycolmap.Database, features: dict[int, tuple[np.ndarray, pycolmap.FeatureDescriptors]]) -> None:
    """Replace keypoints and descriptors of some images, by their ids."""
    descriptors = {image.image_id: opened.read_descriptors(image.image_id) for image in opened.read_all_images()}
    for image_id, (keypoints, described) in features.items():
        opened.update_keypoints(image_id, keypoints)
        descriptors[image_id] = described
    opened.clear_descriptors()  # those of single images cannot be replaced
    for image_id, data in sorted(descriptors.items()):
        opened.write_descriptors(image_id, data)
