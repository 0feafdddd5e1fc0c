"""Features on the object in all passes, what matches within a pass and across passes, and the points that each pass sees.

The ground stays behind when the object is turned, so features come from inside the masks alone. Each pass triangulates its own with its
own cameras; a match across two passes then pairs a point of the one with a point of the other.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap

from zeroshop_steps.geometry.imaging.image_overlap import count_common_features, describe_view
from zeroshop_steps.geometry.imaging.images import read_image, write_image
from zeroshop_steps.join.pass_images import Pass
from zeroshop_steps.register.features import sift
from zeroshop_steps.register.mapping.mapper import make_mapping_options
from zeroshop_steps.register.matching.verified_matches import match_features
from zeroshop_steps.register.scene.image_set import ImageSet, read_masks

ALL_PAIRS = 24
"""Up to so many images in each pass, every pair is matched; of more, each image with those of each pass that are most like it, so many."""


@dataclass(frozen=True)
class PointPairs:
    """Points of two passes that matches say are one.

    Attributes:
        target, source: (N, 3) each in the frame of its own pass.
        target_ids, source_ids: (N,) their numbers in the models of the passes.
        images: number of pairs of images that they come from.
    """

    target: np.ndarray
    source: np.ndarray
    target_ids: np.ndarray
    source_ids: np.ndarray
    images: int


def match_object(image_set: ImageSet, passes: list[Pass], scratch: Path, options: sift.SiftOptions) -> Path:
    """A database of the object's features in all images, matched within passes and across them; returns its file."""
    database = scratch / "object.db"
    sift.extract_features(database, _hide_ground(image_set, scratch / "object"), options, scratch / "masks", read_cameras(passes))
    match_features(database, options, choose_pairs(image_set, passes))
    return database


def read_cameras(passes: list[Pass]) -> dict[str, pycolmap.Camera]:
    """{image stem: camera} of all passes."""
    return {Path(image.name).stem: one.model.cameras[image.camera_id] for one in passes for image in one.model.images.values()}


def _hide_ground(image_set: ImageSet, folder: Path) -> ImageSet:
    """Copies of the images in which all but the object has one colour: features of the ground take most of the time, and are not used."""
    folder.mkdir()
    masks = read_masks(image_set)
    copies = []
    for path in image_set.images:
        image, mask = read_image(path), masks[path.name]
        image[~mask] = np.median(image[mask], axis=0) if mask.any() else 0
        copies.append(folder / path.name)
        write_image(copies[-1], image)
    return replace(image_set, images=tuple(copies))


def choose_pairs(image_set: ImageSet, passes: list[Pass]) -> list[tuple[str, str]] | None:
    """Names of the images of each pair to match; None for all pairs."""
    if all(len(one.images) <= ALL_PAIRS for one in passes):
        return None
    masks = read_masks(image_set)
    common = count_common_features([describe_view(read_image(path), masks[path.name]) for path in image_set.images])
    pairs = choose_in_passes(common, [len(one.images) for one in passes], ALL_PAIRS)
    return [(image_set.names[one], image_set.names[other]) for one, other in pairs]


def choose_in_passes(alike: np.ndarray, counts: list[int], most: int) -> list[tuple[int, int]]:
    """Pairs (i, j), i < j, of each image with those of each pass that are most like it.

    Args:
        alike: (N, N) how like the images are, pass by pass; -inf where two are not to be paired.
        counts: of the images of each pass.
        most: partners of an image in a pass.
    """
    pairs = set()
    for index in range(len(alike)):
        for group in np.split(np.arange(len(alike)), np.cumsum(counts)[:-1]):
            others = group[(group != index) & np.isfinite(alike[index, group])]
            for other in others[np.argsort(-alike[index, others], kind="stable")[:most]]:
                pairs.add((min(index, int(other)), max(index, int(other))))
    return sorted(pairs)


def make_bare_model(database: Path, poses: dict[str, pycolmap.Rigid3d]) -> pycolmap.Reconstruction:
    """A model without points of the database's images that have a pose, {image name: camera_from_world}."""
    model = pycolmap.Reconstruction()
    with pycolmap.Database.open(database) as opened:
        images = sorted((image for image in opened.read_all_images() if image.name in poses), key=lambda image: image.name)
        for camera_id in sorted({image.camera_id for image in images}):
            model.add_camera_with_trivial_rig(opened.read_camera(camera_id))
    for image in images:
        placed = pycolmap.Image(name=image.name, camera_id=image.camera_id, image_id=image.image_id)
        model.add_image_with_trivial_frame(placed, poses[image.name])
    return model


def triangulate_pass(database: Path, one: Pass, image_set: ImageSet, seed: int) -> pycolmap.Reconstruction:
    """The points of the object that one pass sees, with its cameras held fixed."""
    poses = {image.name: image.cam_from_world() for image in one.model.images.values() if image.has_pose}
    output = database.parent / f"triangulated_{one.number}"
    output.mkdir()
    mapper = make_mapping_options(len(poses), seed)
    return pycolmap.triangulate_points(make_bare_model(database, poses), database, image_set.images[0].parent, output, options=mapper)


def pair_points(database: Path, target: pycolmap.Reconstruction, source: pycolmap.Reconstruction) -> PointPairs:
    """The points of two passes whose features match across them, each pair of points once."""
    pairs: set[tuple[int, int]] = set()
    images = 0
    with pycolmap.Database.open(database) as opened:
        for one in sorted(target.reg_image_ids()):
            for other in sorted(source.reg_image_ids()):
                matches = opened.read_two_view_geometry(one, other).inlier_matches
                found = set()
                for first, second in matches:
                    here, there = target.images[one].points2D[first], source.images[other].points2D[second]
                    if here.has_point3D() and there.has_point3D():
                        found.add((here.point3D_id, there.point3D_id))
                pairs |= found
                images += bool(found)
    ids = np.array(sorted(pairs), int).reshape(-1, 2)
    return PointPairs(
        np.array([target.points3D[one].xyz for one in ids[:, 0]]).reshape(-1, 3),
        np.array([source.points3D[other].xyz for other in ids[:, 1]]).reshape(-1, 3),
        ids[:, 0],
        ids[:, 1],
        images,
    )
