"""Mask the object on the support plane that is nearest to the point that all cameras look at. No weights are needed.

All images together give an image of the bare ground. What differs from it in all views is carved out of the space above. Then
each image is cut along colours and edges, with the common hull keeping the cuts consistent, and masks that contradict the others
are left out. Where the object is small in the images, all of that is done again in windows around it.
"""

import argparse
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from zeroshop_steps.geometry.cameras import Camera, SparseModel
from zeroshop_steps.geometry.registered_views import View, read_views
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.networks.saliency_maps import WIDTH_PX as MAPS_WIDTH_PX
from zeroshop_steps.networks.saliency_maps import read_maps
from zeroshop_steps.register.ground_contrast import GroundContrast
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.runtime.thread_pool import map_in_threads
from zeroshop_steps.segment.flat_print import take_off_print
from zeroshop_steps.segment.flat_things import SheetGround, add_sheet, find_beside_flat
from zeroshop_steps.segment.ground import LIGHT_ODDS, MOST_ODDS, GroundPicture, build_ground_picture, equalize_exposure
from zeroshop_steps.segment.led_by_points import Found, find_with_points
from zeroshop_steps.segment.mask_quality import MasksRejected, check_enough_good, check_points_covered, compare_with_hull, describe_quality
from zeroshop_steps.segment.motion_check import check_not_moved
from zeroshop_steps.segment.object_selection import NothingFound, ObjectSelection, select_object
from zeroshop_steps.segment.own_outlines import find_whole
from zeroshop_steps.segment.plain_ground import PlainGround, find_risen_points, fit_plain_ground, join_odds
from zeroshop_steps.segment.plane_search import find_support_below, has_settled, propose_supports, settle_support
from zeroshop_steps.segment.point_silhouettes import find_point_silhouettes
from zeroshop_steps.segment.prior_maps import Masks, find_by_maps, find_without_ground, weigh_contrast
from zeroshop_steps.segment.record import add_common_arguments, show_rejected_masks, write_segmented
from zeroshop_steps.segment.refine import RefinedMasks, refine_masks
from zeroshop_steps.segment.risen_points import find_cluster
from zeroshop_steps.segment.tidy_mask import tidy_mask
from zeroshop_steps.segment.windows import CLOSER, Window, choose_windows, cut_map, cut_views, lay_back, take_whole

WIDTH_PX = 480  # images are cut at this width at most; time grows with its square
LEAST_OVERLAP = 0.5  # of masks from windows and those before: others show something else

METHOD = {"rank": 2, "in_scene": True, "runtime_min": 60}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_common_arguments(parser)
    parser.add_argument("--image-width-px", type=int, default=WIDTH_PX, help="images are cut at this width (default: %(default)s)")


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    start_s = time.monotonic()
    views, model = read_views(args.scene)
    images = [view.image_path for view in views]

    def find_on_ground(prior: list[np.ndarray] | None = None) -> Masks:
        return find_masks(views, model, args.image_width_px, args.seed, prior)

    with show_rejected_masks(images, args.rejected):
        # Where the object was registered alone, there are no points of the ground, but there are masks of each photo alone.
        alone = read_maps(args.scene, GroundContrast(), MAPS_WIDTH_PX)
        maps, prior = [alone[path.stem] for path in images] if alone else None, GroundContrast.name
        if maps is None and read_json(args.scene / "registration.json").get("still_background"):
            # Beyond the turntable, the photos see no ground that all agree on.
            maps, prior = _try_point_silhouettes(views, model), "sparse_points"
        masks, record = find_on_ground() if maps is None else find_by_maps(maps, views, find_on_ground)
    if maps is not None:
        record["prior"] = prior
    record |= {"method": "support_plane", "seconds": round(time.monotonic() - start_s, 2)}
    write_segmented(args.scene, args.out, views, masks, set(record["dropped"]), record)


def find_masks(
    views: list[View], model: SparseModel, image_width_px: int, seed: int, prior: list[np.ndarray] | None = None
) -> tuple[list[np.ndarray], dict[str, Any]]:
    """Masks of all views, (H, W) bool of the images' sizes, and the record of their quality.

    The colour of a plain ground tells the object from it, but light that the ground throws back gives shaded sides of the object the same
    colour. So where it fails, the ground is told place by place, as a printed one.

    Args:
        views: the registered views.
        model: their sparse points, object and ground.
        image_width_px: images are cut at this width.
        seed: of RANSAC.
        prior: (h, w) log odds of the object in every view by what else is known, for example a network.

    Raises:
        StepError: no ground, nothing or too much on it, or too few good masks.
    """

    def find_on(
        support: SceneSupport, fitted: bool, by_color: bool = True, sheet: np.ndarray | None = None
    ) -> tuple[Found, list[np.ndarray] | None]:
        def find(odds: list[np.ndarray] | None) -> Found:
            windows = take_whole(views)
            return _find_in_windows(views, model, windows, image_width_px, support, fitted, odds, by_color=by_color, sheet=sheet)

        if prior is not None:
            return find(prior), prior
        found, weighed = find_with_points(views, model, find_cluster(model, support), find)
        return find_whole(views, found, weighed, find) if found.plain else (found, weighed)

    failure: StepError | None = None
    guessed = True
    for support, fitted in propose_supports(model, views, seed):
        try:
            found, weighed = find_on(support, fitted)
        except StepError as error:
            failure, guessed = failure or error, guessed and not fitted
            continue
        below = find_support_below(model, views, support, seed, found.masks) if fitted else None
        by_color, on_sheet = True, False
        if below is not None:
            print("the plane that holds the most points is a side of the object: trying the one below")
            try:
                found, weighed = find_on(below, True)
            except StepError as error:
                warn(f"the masks may lack what lies below the top of the object: {error}")
        elif found.plain and (beside := find_beside_flat(views, found, find_on)):
            found, weighed, by_color = beside
            on_sheet = True
        found = _look_closer(found, views, model, image_width_px, weighed, by_color)
        if found.plain and not on_sheet:
            return take_off_print(found, views, model, image_width_px)
        return found.masks, found.record
    assert failure is not None  # there is one support at least
    if prior is None and guessed and isinstance(failure, MasksRejected | NothingFound):
        return _find_by_points(views, model, failure)
    raise failure


def _try_point_silhouettes(views: list[View], model: SparseModel) -> list[np.ndarray] | None:
    """Maps of the thing that the cameras look at, by its sparse points; None where these do not tell it."""
    try:
        return find_point_silhouettes(views, model)
    except StepError as error:
        print(f"the thing's own points do not tell it: {error}")
        return None


def _find_by_points(views: list[View], model: SparseModel, failure: StepError) -> Masks:
    """Masks by the sparse points of the thing that the cameras look at, where no ground told them; raises that failure where they fail."""
    print(f"no ground that helps: {failure}")
    try:
        masks, record = find_without_ground(find_point_silhouettes(views, model), views)
    except StepError as error:
        print(f"the thing's own points do not tell it either: {error}")
        raise failure from None
    return masks, record | {"method": "support_plane", "by_points": True, "without_ground": str(failure)}


def _look_closer(
    found: Found, views: list[View], model: SparseModel, image_width_px: int, prior: list[np.ndarray] | None, by_color: bool
) -> Found:
    """The masks of an object that is small in the images, found again in windows around it, where those agree with what was found."""
    windows, closer = choose_windows(found.masks)
    if closer > CLOSER:
        return found
    # All lengths are shares of the cameras' distance: seen through windows, the cameras are as near as these are narrow.
    support = replace(found.support, distance=closer * found.support.distance, focus=found.middle)
    try:
        again = _find_in_windows(views, model, windows, image_width_px, support, True, prior, found.selection, by_color)
    except StepError as error:
        print(f"looking closer did not help: {error}")
        return found
    overlap = np.median([(one & other).sum() / max((one | other).sum(), 1) for one, other in zip(found.masks, again.masks, strict=True)])
    if overlap < LEAST_OVERLAP:
        print(f"looking closer did not help: the masks overlap with those before by {overlap:.2f} only")
        return found
    kept = {name: found.record[name] for name in ("things_on_the_ground", "plane_from", "plane_inliers")}
    return replace(again, record=again.record | kept | {"windows": round(closer, 3)})


def _find_in_windows(
    views: list[View],
    model: SparseModel,
    windows: list[Window],
    image_width_px: int,
    support: SceneSupport,
    fitted: bool,
    prior: list[np.ndarray] | None,
    before: ObjectSelection | None = None,
    by_color: bool = True,
    sheet: np.ndarray | None = None,
) -> Found:
    """Masks by what windows of the images show. Arguments as in `find_masks` and `_Scene`; raises StepError as `find_masks` does.

    `by_color`: whether the colour of a plain ground counts; `sheet`: the (N, N) bool cells of its picture that a plain sheet covers.
    """
    cameras, images = cut_views(views, windows, image_width_px)
    images = equalize_exposure(support, cameras, images)
    ground = build_ground_picture(support, cameras, images)
    risen = find_risen_points(model.points, support)
    table = fit_plain_ground(ground, risen) if by_color else None
    plain = table if table is None or sheet is None else add_sheet(table, ground, sheet, risen)
    priors = [np.zeros((camera.height_px, camera.width_px), np.float32) for camera in cameras]
    if prior is not None:
        priors = [cut_map(*parts) for parts in zip(prior, windows, views, cameras, strict=True)]
    scene = _Scene(views, model, windows, image_width_px, cameras, images, support, fitted, ground, plain, before)
    try:
        return _find_on_scene(scene, weigh_contrast(images, cameras) if plain and prior is None else priors, by_color)
    except StepError as error:
        if plain is None:
            raise
        failure = error
    print(f"the colour of the ground does not tell the object from it: {failure}")
    try:
        found = _find_on_scene(scene, priors, by_color=False)
    except StepError:
        raise failure from None
    return replace(found, record=found.record | {"without_ground_color": str(failure)})


@dataclass(frozen=True)
class _Scene:
    """What masks are found from.

    Attributes:
        views, model, image_width_px: as in `find_masks`.
        windows: of the views' images.
        cameras, images: of these windows, of the width at which images are cut; (H, W, 3) float32 RGB, equally exposed.
        support: the plane.
        fitted: whether points gave it.
        ground: what all views see of it.
        plain: its colour, if it has but one.
        before: what the whole images showed, if these windows are closer: other things may lie outside of them.
    """

    views: list[View]
    model: SparseModel
    windows: list[Window]
    image_width_px: int
    cameras: list[Camera]
    images: list[np.ndarray]
    support: SceneSupport
    fitted: bool
    ground: GroundPicture
    plain: PlainGround | SheetGround | None
    before: ObjectSelection | None


def _find_on_scene(scene: _Scene, priors: list[np.ndarray], by_color: bool = True) -> Found:
    """Masks of all views and the record of their quality; `by_color` uses the colour of a plain ground."""
    support, cameras = scene.support, scene.cameras
    selection, refined, own = _find_on_plane(scene, support, scene.ground, scene.plain if by_color else None, priors)
    settled = None if scene.fitted else settle_support(support, cameras, scene.images, refined.masks, selection.grid, refined.occupied)
    if settled and not has_settled(support, settled):
        support, ground = settled, build_ground_picture(settled, cameras, scene.images)
        plain = fit_plain_ground(ground, find_risen_points(scene.model.points, support)) if by_color else None
        selection, refined, own = _find_on_plane(scene, support, ground, plain, priors)
    tidied = [tidy_mask(mask, hull) for mask, hull in zip(refined.masks, refined.hulls, strict=True)]
    names = [camera.name for camera in cameras]
    qualities = compare_with_hull([mask > 0.5 for mask in tidied], refined.hulls)
    check_enough_good(qualities, names, tidied)
    check_points_covered(own, cameras, tidied)
    record = {
        "method": "support_plane",
        **describe_quality(qualities, names),
        "things_on_the_ground": selection.cluster_count,
        "plane_from": "points" if scene.fitted else "views" if settled else "object",
        "plane_inliers": support.inliers,
        "plane": {"normal": support.normal.tolist(), "offset": support.offset},
        "image_width_px": scene.image_width_px,
    }
    masks = map_in_threads(lay_back, tidied, scene.windows, scene.views)
    middle = selection.grid.centres(np.argwhere(refined.occupied)).mean(0)
    return Found(masks, record, support, scene.plain is not None, middle, selection)


def _find_on_plane(
    scene: _Scene, support: SceneSupport, ground: GroundPicture, plain: PlainGround | SheetGround | None, priors: list[np.ndarray]
) -> tuple[ObjectSelection, RefinedMasks, np.ndarray]:
    """Select the object that stands on a plane, and find its masks and the (P, 3) sparse points that show it whatever its colours are."""
    cameras, images = scene.cameras, scene.images
    risen = find_risen_points(scene.model.points, support) if plain or scene.plain else None
    by_place = map_in_threads(lambda camera, image: ground.evidence(camera, image, LIGHT_ODDS), cameras, images)
    by_table = [
        plain.evidence(camera, image) if plain else np.zeros(image.shape[:2], np.float32)
        for camera, image in zip(cameras, images, strict=True)
    ]
    evidence = [
        np.clip(join_odds(odds, table) + prior, -MOST_ODDS, MOST_ODDS)
        for odds, table, prior in zip(by_place, by_table, priors, strict=True)
    ]
    check_not_moved(support, cameras, evidence, scene.model, risen if plain else None)
    selection = select_object(support, cameras, evidence, risen if plain else None, images)
    if scene.before:
        selection = selection.with_others_of(scene.before)
    own = selection.own_points(risen) if risen is not None else np.zeros((0, 3))
    return selection, refine_masks(support, selection, cameras, images, by_place, by_table, priors, own if plain else own[:0]), own
