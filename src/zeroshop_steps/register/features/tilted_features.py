"""More features for views at a flat angle: SIFT on a copy of the image that is stretched across the flattened direction.

A support plane seen under 8 degrees is compressed seven times along the view, which no affine adaptation of single
features undoes: neighbouring views 36 degrees apart then share a few dozen matches. Simulating the tilt before
detection does undo it (ASIFT: Morel and Yu, SIAM J. Imaging Sciences 2009), with one tilt: a camera that is held upright
sees a plane compressed vertically, one that is held on its side horizontally. The shapes of the features tell which. Only views
that match badly and are flattened pay for it.
"""

from pathlib import Path

import cv2
import numpy as np
import pycolmap

from zeroshop_steps.geometry.imaging.images import read_image, write_image
from zeroshop_steps.register.features.sift import SiftOptions, make_extraction_options
from zeroshop_steps.register.scene.database import create_database, delete_pair, read_matches, replace_features
from zeroshop_steps.register.scene.image_set import ImageSet

LEAST_FORESHORTENING = 0.3
"""Median logarithm of the ratio of a feature's extents: 0.9 in views under 8 degrees, 0.2 under 40 degrees, 0 +- 0.25 in photos of a table
from above."""
VERTICAL = 1  # the axis y, along which a camera that is held upright sees the ground flattened
COPY_WIDTH = 0.5  # features must be as large across as along the view, where stretching cannot bring back detail


def find_weak_images(database: Path, min_matches: int, min_share: float) -> list[str]:
    """Names of the images with few verified matches, all pairs together.

    Args:
        database: with verified matches.
        min_matches: fewer than these are few.
        min_share: so are fewer than this share of what a well-matched image (upper quartile) of the same set has.
    """
    with pycolmap.Database.open(database) as opened:
        names = {image.image_id: image.name for image in opened.read_all_images()}
        totals = dict.fromkeys(names, 0)
        for pair, matches in read_matches(opened):
            for image_id in pair:
                totals[image_id] += len(matches)
    few = max(min_matches, min_share * float(np.percentile(list(totals.values()), 75)))
    return sorted(name for image_id, name in names.items() if totals[image_id] < few)


def find_foreshortened(database: Path, names: list[str]) -> dict[str, int]:
    """Of the images `names`, those whose features are flattened along one axis of the image, and that axis: 0 for x, 1 for y."""
    axes = {}
    with pycolmap.Database.open(database) as opened:
        for name in names:
            shapes = opened.read_keypoints(opened.read_image_with_name(name).image_id)[:, 2:]
            if shapes.shape[1] < 4 or not len(shapes):
                continue
            extents = np.linalg.norm(shapes.reshape(-1, 2, 2), axis=2)  # of the ellipse of each feature, along x and y
            flattening = float(np.median(np.log(np.maximum(extents[:, 0], 1e-6) / np.maximum(extents[:, 1], 1e-6))))
            if abs(flattening) > LEAST_FORESHORTENING:
                axes[name] = int(flattening > 0)
    return axes


def add_tilted_features(
    database: Path,
    image_set: ImageSet,
    axes: dict[str, int],
    tilt: float,
    options: SiftOptions,
    among: list[tuple[str, str]] | None = None,
) -> list[tuple[str, str]]:
    """Add features of stretched copies to some images, whose matches are deleted; returns the pairs of names to match anew.

    Args:
        database: with features and matches of all images; changed in place.
        image_set: the images.
        axes: the axis along which to stretch, 0 for x and 1 for y, by the name of the image.
        tilt: ratio of the copies' magnification along that axis to that along the other.
        options: as for the first extraction.
        among: the pairs of names that may be matched; None for all.
    """
    names = sorted(axes)
    folder = Path(database).parent / "stretched"
    sizes = dict(zip(image_set.names, image_set.sizes_px, strict=True))
    copies = {}
    for path in image_set.images:
        if path.name in axes:
            image = read_image(path)
            copies[path.name] = _scale_copy(sizes[path.name], axes[path.name], tilt, options.max_side_px)
            shrunk = cv2.resize(image, tuple(np.minimum(copies[path.name], sizes[path.name]).tolist()), interpolation=cv2.INTER_AREA)
            write_image(folder / f"{path.name}.png", cv2.resize(shrunk, copies[path.name], interpolation=cv2.INTER_CUBIC))
    stretched_database = Path(database).with_name("stretched.db")
    stretched_names = [f"{name}.png" for name in names]
    create_database(stretched_database, len(stretched_names))
    pycolmap.import_images(stretched_database, folder, pycolmap.CameraMode.PER_IMAGE, stretched_names)
    extraction = make_extraction_options(options, first_octave=0)
    extraction.max_image_size = max(map(max, copies.values()))
    pycolmap.extract_features(stretched_database, folder, stretched_names, pycolmap.CameraMode.PER_IMAGE, extraction_options=extraction)
    with pycolmap.Database.open(database) as opened, pycolmap.Database.open(stretched_database) as stretched:
        images = {image.name: image.image_id for image in opened.read_all_images()}
        features = {}
        for name in names:
            source_id = stretched.read_image_with_name(f"{name}.png").image_id
            keypoints = stretched.read_keypoints(source_id)
            scale = np.array(copies[name]) / sizes[name]
            keypoints[:, :2] /= scale
            keypoints[:, 2:] /= scale[[0, 0, 1, 1]]  # rows of the affine shape [a11, a12; a21, a22]
            image_id = images[name]
            descriptors = opened.read_descriptors(image_id)
            both = np.concatenate([descriptors.data, stretched.read_descriptors(source_id).data])
            keypoints = np.concatenate([opened.read_keypoints(image_id), keypoints])
            features[image_id] = keypoints, pycolmap.FeatureDescriptors(descriptors.type, both)
        replace_features(opened, features)
        pairs = sorted({(min(name, other), max(name, other)) for name in names for other in images if other != name})
        if among is not None:
            pairs = sorted(set(pairs) & {(min(pair), max(pair)) for pair in among})
        for first, second in pairs:
            delete_pair(opened, images[first], images[second])
    return pairs


def _scale_copy(size_px: tuple[int, int], axis: int, tilt: float, max_side_px: int) -> tuple[int, int]:
    """(width, height) of the copy of an image, reduced to `max_side_px`, that is stretched along an axis."""
    reduced = min(1.0, max_side_px / max(size_px))
    factors = (reduced * COPY_WIDTH * tilt, reduced * COPY_WIDTH) if axis == 0 else (reduced * COPY_WIDTH, reduced * COPY_WIDTH * tilt)
    return round(size_px[0] * factors[0]), round(size_px[1] * factors[1])
