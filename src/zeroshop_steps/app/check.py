"""Judge photos or a film before anything long runs.

Can they be read, are they sharp, light and different enough, do they share enough? Do they show the object from all around, whole, and at
rest?
"""

import contextlib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from zeroshop_steps.app.moved_things import MOST_STEPS, PIECES, SIDE_PX, Piece, follow_points, judge_motion
from zeroshop_steps.app.project_folders import find_weights_home
from zeroshop_steps.capture.bridging import EPIPOLAR_PX, SHARED_FEATURES, Features, count_shared, find_features, match_clearly
from zeroshop_steps.capture.frame_quality import (
    collect_image_warnings,
    look_alike,
    make_thumbnail,
    measure_edge_blur_px,
    measure_level,
    measure_sharpness,
)
from zeroshop_steps.capture.mask_names import split_masks
from zeroshop_steps.capture.photo_files import is_cut_out, list_photos, open_picture, read_cut_out, read_photo
from zeroshop_steps.capture.photos import MIN_IMAGES, MOST_IMAGES
from zeroshop_steps.capture.video import choose_frames, read_frames, read_numbers, scan_video
from zeroshop_steps.geometry.cameras.registered_views import space_evenly
from zeroshop_steps.geometry.imaging.image_overlap import count_common_features, describe_view
from zeroshop_steps.geometry.imaging.images import measure_border_share
from zeroshop_steps.networks.saliency.salient_networks import DEFAULT, NETWORKS
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.progress import track

LEAST_MATCHES = 25  # that fit one essential matrix, of two pictures that are tied
TIED_SHARE = 0.8  # of the pictures must be tied to each other: those all around a plain table are not, and then nothing is said
ENOUGH_IMAGES = 20  # different ones; with fewer, a warning asks for more
PARTNERS = 3  # photos that each is compared with, those most like it
LONELY_SHARE = 0.25
"""Of the photos may share too little with any other: up to 0.16 where cameras came out right (bananas on a carpet, a kitchen table,
rendered captures), 0.4 and 0.65 where they came out folded and bent (20 and 30 frames on a white and a wooden table)."""
ONE_SIDE_DEG = 120.0  # by which the camera turns, and below which a back is not seen
VIEWS = 8  # pictures by which the turn is measured, and in which the object is looked for
VIEW_PX, MAP_PX = (640, 480), (320, 240)  # (width, height) of their copies, and of the maps of the object
CUT_BORDER, CUT_SHARE = 0.04, 0.8
"""Of the border is covered by an object that is cut off, in this share of the pictures. A stick that carries a skull covers 0.03; of 18
captures, none has it in more than 0.7 of its pictures, as networks take other things and the table for the object here and there."""
CHECKED_SIDE_PX = 1920  # longer photos are reduced to it: enough to see blur


def check_capture(source: Path) -> tuple[list[str], list[str]]:
    """What prevents a mesh, and what makes it worse, in words; both empty for a good capture.

    Args:
        source: a video, or a folder of photos.

    Raises:
        StepError: the video cannot be read.
    """
    names: list[str] = []
    unusable: list[str] = []
    sharpness, levels, blurs_px = [], [], []
    distinct: list[np.ndarray] = []
    features: list[Features] = []
    descriptors: list[np.ndarray] = []
    views: list[np.ndarray] = []
    try:
        count, pictures, pieces = _open_folder(source) if source.is_dir() else _open_film(source)
        every = math.ceil(count / MOST_IMAGES)
        shown = set(space_evenly(count, VIEWS))
        for number, (name, image) in enumerate(pictures):
            if image is None:
                unusable.append(name)
                continue
            names.append(name)
            sharpness.append(measure_sharpness(image))
            levels.append(measure_level(image))
            blurs_px.append(measure_edge_blur_px(image))
            thumbnail = make_thumbnail(image)
            if not any(look_alike(thumbnail, other) for other in distinct):
                distinct.append(thumbnail)
            if source.is_dir() and number % every == 0:
                descriptors.append(describe_view(image))
                features.append(find_features(image))
            if number in shown:
                features += [] if source.is_dir() else [find_features(image)]
                views.append(cv2.resize(image, VIEW_PX, interpolation=cv2.INTER_AREA))
    except StepError as error:
        if not source.is_dir():
            raise
        return [str(error)], []
    warnings = [f"left out, cannot be read: {', '.join(unusable)}; export them as JPEG"] if unusable else []
    if not names:
        return warnings or ["no picture can be read"], []
    warnings += collect_image_warnings(names, sharpness, levels, blurs_px)
    if len(distinct) < MIN_IMAGES:
        found = f"only {len(distinct)} pictures differ from each other"
        return [f"{found}, {MIN_IMAGES} are needed: move around the object"], warnings
    if len(distinct) < ENOUGH_IMAGES:
        warnings.append(f"{len(distinct)} different pictures; {ENOUGH_IMAGES} to 30 from all around, in two rings, make a better mesh")
    warnings += _warn_of_lonely(features, descriptors) if source.is_dir() else []
    warnings += _warn_of_one_side(features)
    if len(names) > MOST_IMAGES and source.is_dir():
        warnings.append(f"{len(names)} pictures; the {MOST_IMAGES} most useful ones are taken (photos.most_images)")
    problems, more = judge_motion(pieces)
    return problems + _find_cut_off(views, _read_cut_outs(source)), warnings + more


def _warn_of_one_side(features: list[Features]) -> list[str]:
    """A warning where the camera turned but little around the object."""
    turn_deg = measure_turn_deg([features[number] for number in space_evenly(len(features), VIEWS)])
    if turn_deg is None or turn_deg >= ONE_SIDE_DEG:
        return []
    return [
        f"one side alone is seen: the camera turned by only about {turn_deg:.0f} degrees, and the mesh will lack the other sides; go all"
        " around the object, once from the side and once from above"
    ]


def _read_cut_outs(folder: Path) -> list[np.ndarray]:
    """(H, W) masks of a few photos of a folder, where the background of all was removed."""
    found: list[np.ndarray | None] = []
    if folder.is_dir() and is_cut_out(folder):
        paths = list_photos(folder)[0]
        for number in space_evenly(len(paths), VIEWS):
            with contextlib.suppress(StepError), open_picture(paths[number]) as image:
                found.append(read_cut_out(image))
    return [mask for mask in found if mask is not None]


def _find_cut_off(views: list[np.ndarray], masks: list[np.ndarray]) -> list[str]:
    """A problem where an object is cut off in nearly all pictures: by their masks, or else by the network, where its weights are there."""
    weights = find_weights_home() / NETWORKS[DEFAULT].path
    if not masks and weights.is_file():
        masks = [found > 0.5 for found in SalientObjectNetwork(weights).predict_all(views, [MAP_PX] * len(views))]
    if not masks:
        return []
    cut = [measure_border_share(mask) > CUT_BORDER for mask in masks]
    if sum(cut) < CUT_SHARE * len(cut):
        return []
    return [
        f"the object is cut off at the border in {sum(cut)} of {len(cut)} pictures: step back, until all of it is in every picture, with"
        " some room around it"
    ]


def _warn_of_lonely(features: list[Features], descriptors: list[np.ndarray]) -> list[str]:
    """A warning where many photos share too little with any other. Of a film, frames in between are taken instead."""
    if len(features) < MIN_IMAGES:
        return []
    common = count_common_features(descriptors)
    partners = np.argsort(-common, axis=1)[:, :PARTNERS]
    best = [max(count_shared(features[one], features[other]) for other in others) for one, others in enumerate(partners)]
    lonely = sum(shared < SHARED_FEATURES for shared in best)
    if lonely <= LONELY_SHARE * len(best):
        return []
    return [
        f"{lonely} of {len(best)} photos share so little with any other that their cameras may be wrong: put a newspaper or other print"
        " below the object, take photos in between, every 10 to 15 degrees, or film it: of a film, more views are taken where needed"
    ]


def _open_folder(folder: Path) -> tuple[int, Iterator[tuple[str, np.ndarray | None]], Iterator[Piece]]:
    """How many pictures a folder holds; their names and pixels, one at a time, reduced, None for one that cannot be read; and points that
    are followed through them, as they may be frames of a film."""
    found, odd = list_photos(folder)
    paths = split_masks(found)[0]

    def read() -> Iterator[tuple[str, np.ndarray | None]]:
        for path in track(paths, "checking the photos", len(paths)):
            try:
                yield path.name, read_photo(path, CHECKED_SIDE_PX).pixels
            except StepError:
                yield path.name, None
        yield from ((path.name, None) for path in odd)

    return len(paths), read(), follow_points(_read_small(paths), space_evenly(len(paths), PIECES))


def _open_film(video: Path) -> tuple[int, Iterator[tuple[str, np.ndarray | None]], Iterator[Piece]]:
    """How many frames of a film are judged, their names and pixels, and points that are followed through pieces of it."""
    scan = scan_video(video)
    chosen = choose_frames(scan, 20)
    starts = space_evenly(max(1, len(scan.changes) - MOST_STEPS), PIECES)
    frames = ((f"frame {number}", frame) for number, frame in read_numbers(video, chosen))
    return len(chosen), frames, follow_points(read_frames(video), starts)


def _read_small(paths: list[Path]) -> Iterator[np.ndarray]:
    for path in paths:
        with contextlib.suppress(StepError):
            yield read_photo(path, SIDE_PX).pixels


def measure_turn_deg(pictures: Sequence[Features]) -> float | None:
    """How far the camera turned about the axis that it was held upright by, in degrees; None where the pictures do not tell.

    Rotations come from essential matrices (Nister, 2004) along the spanning tree of the most matches. The x axes of cameras that are held
    upright lie in a plane; the largest gap between their directions is what was not seen. A camera that is rolled seems to have turned
    further. Against bundle adjustment: 2 to 12 degrees off for 6 real captures, 52 too few for one (73 of 125).
    """
    count = len(pictures)
    matches, rotations = np.zeros((count, count)), {}
    for one in range(count):
        for other in range(one + 1, count):
            inliers, rotation = _relate(pictures[one], pictures[other])
            if inliers >= LEAST_MATCHES:
                matches[one, other], rotations[one, other], rotations[other, one] = inliers, rotation, rotation.T
    tree = minimum_spanning_tree(np.where(matches > 0, 1.0 / np.maximum(matches, 1.0), 0.0))
    trees = [breadth_first_order(tree, root, directed=False) for root in range(count)]
    order, parents = max(trees, key=lambda found: len(found[0]))
    if len(order) < TIED_SHARE * count:
        return None
    turned = {int(order[0]): np.eye(3)}
    for node in map(int, order[1:]):
        parent = int(parents[node])
        turned[node] = rotations[parent, node] @ turned[parent]
    axes = np.array([rotation[0] for rotation in turned.values()])
    _, vectors = np.linalg.eigh(axes.T @ axes)
    directions = np.sort(np.degrees(np.arctan2(axes @ vectors[:, 1], axes @ vectors[:, 2])))
    return float(360.0 - np.diff(directions, append=directions[0] + 360.0).max())


def _relate(one: Features, other: Features) -> tuple[int, np.ndarray]:
    """How many matches fit one essential matrix, and the (3, 3) other_from_one rotation."""
    first, second = match_clearly(one, other)
    if len(first) < LEAST_MATCHES:
        return 0, np.eye(3)
    # The focal length is taken for the longer side, which few cameras miss by a quarter.
    rays, other_rays = (
        (places.astype(np.float64) - np.array(picture.size_px) / 2) / max(picture.size_px)
        for places, picture in ((first, one), (second, other))
    )
    limit = EPIPOLAR_PX / max(one.size_px)
    essential, inliers = cv2.findEssentialMat(rays, other_rays, np.eye(3), cv2.RANSAC, 0.999, limit)
    if essential is None or essential.shape != (3, 3):
        return 0, np.eye(3)
    found = int(inliers.sum())
    return found, np.asarray(cv2.recoverPose(essential, rays, other_rays, np.eye(3), mask=inliers)[1])
