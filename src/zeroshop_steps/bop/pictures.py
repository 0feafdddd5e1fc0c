"""Draw detections and estimated poses over the images, and the worst estimates.

One picture per image: on the left the detected masks, on the right the outlines of the models in their estimated poses, with the axes
of their frames (x red, y green, z blue). worst.png has the estimates with the largest MSSD: the true outline in green, the estimated
one in red.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from zeroshop_steps.bop.formats.bop_scenes import Frame
from zeroshop_steps.bop.formats.detections import Detection, decode_mask, read_detections
from zeroshop_steps.bop.formats.estimates import Estimates, read_estimates
from zeroshop_steps.bop.formats.models import ObjectModel, list_objects, read_models
from zeroshop_steps.bop.formats.pose_checks import make_transform
from zeroshop_steps.bop.formats.targets import Frames, Target, read_target_frames, read_targets, size_finder
from zeroshop_steps.bop.scoring.depth_render import DepthRenderer
from zeroshop_steps.geometry.cameras.pinhole import NEAREST_MM
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.geometry.imaging.images import read_image, write_image
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_directory

IN_A_ROW = 5  # tiles
TILE_PX, CAPTION_PX = 320, 44
TILE_MARGIN, LEAST_MARGIN_PX = 1.3, 16  # side of a tile: 1.3 times the longer side of the masks, and so many pixels
TRUE_COLOR, ESTIMATED_COLOR = (40, 220, 40), (255, 40, 40)
AXIS_COLORS = ((255, 60, 60), (60, 220, 60), (80, 80, 255))  # x, y, z: red, green, blue, bright enough for dark photos
BLACK, WHITE = (0, 0, 0), (255, 255, 255)
MASK_TINT = 0.5  # share of the object's colour in a detected mask
FONT = cv2.FONT_HERSHEY_SIMPLEX
CAPTION_SCALE, CAPTION_LEFT_PX, CAPTION_BASELINES_PX = 0.42, 4, (17, 36)  # two lines fit a caption's height, 45 letters its width
LABEL_SCALE, LABEL_EDGE_PX = 0.45, 3  # white letters with a black edge, which show on any photo


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--scenes", type=Path, required=True, help="the split's folder, which holds 000001 and so on")
    parser.add_argument("--targets", type=Path, required=True, help="test_targets_bop19.json: the images and objects to draw")
    parser.add_argument("--models", type=Path, required=True, help="folder of the models whose poses were estimated")
    parser.add_argument("--detections", type=Path, help="BOP COCO result file")
    parser.add_argument("--estimates", type=Path, help="BOP result CSV")
    parser.add_argument("--errors", type=Path, help="errors of these estimates, written by score_poses; the worst are drawn")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")


def run(args: argparse.Namespace) -> None:
    """Draw one run."""
    if args.detections is None and args.estimates is None:
        raise StepError("there is nothing to draw: give --detections, --estimates or both")
    if args.errors and args.estimates is None:
        raise StepError("--errors needs the --estimates that it belongs to")
    targets = read_targets(args.targets)
    frames = read_target_frames(args.scenes, targets, args.targets, truth_needed=args.errors is not None)
    wanted = {target.obj_id for target in targets} & set(list_objects(args.models))
    models = read_models(args.models, wanted)
    renderers = {number: DepthRenderer(model.mesh) for number, model in models.items()}
    estimates = read_estimates(args.estimates) if args.estimates else None
    detections = read_detections(args.detections, size_finder(frames)) if args.detections else []
    with atomic_directory(args.out) as folder:
        for (scene_id, image_id), frame in frames.items():
            panels, here = [], [target for target in targets if (target.scene_id, target.im_id) == (scene_id, image_id)]
            photo = read_image(frame.photo_path())
            if args.detections:
                panels.append(draw_detections(photo, select_surest_detections(detections, here)))
            if estimates is not None:
                panels.append(draw_poses(photo, frame, select_surest_estimates(estimates, here, models), models, renderers))
            write_image(folder / f"{scene_id:06d}_{image_id:06d}.png", np.concatenate(panels, 1))
        if args.errors and estimates is not None:
            tiles = draw_worst(args.errors, estimates, frames, models, renderers)
            if tiles is not None:
                write_image(folder / "worst.png", tiles)


def select_surest_detections(detections: Sequence[Detection], targets: Sequence[Target]) -> list[Detection]:
    """The most confident detections with a mask, as many as each target has instances; the most confident last."""
    chosen = []
    for target in targets:
        key = target.scene_id, target.im_id, target.obj_id
        found = [one for one in detections if (one.scene_id, one.image_id, one.object_id) == key and one.mask is not None]
        chosen += sorted(found, key=lambda one: -one.score)[: target.inst_count]
    return sorted(chosen, key=lambda one: one.score)


def select_surest_estimates(
    estimates: Estimates, targets: Sequence[Target], models: dict[int, ObjectModel]
) -> list[tuple[int, float, np.ndarray]]:
    """(object, score, (4, 4) camera_from_model) of the most confident estimates, as many as each target has instances."""
    poses, chosen = make_transform(estimates.rotations, estimates.translations_mm), []
    for target in targets:
        of_image = (estimates.scene_ids == target.scene_id) & (estimates.image_ids == target.im_id)
        rows = np.flatnonzero(of_image & (estimates.object_ids == target.obj_id))
        best = rows[np.argsort(-estimates.scores[rows], kind="stable")][: target.inst_count]
        chosen += [(target.obj_id, float(estimates.scores[row]), poses[row]) for row in best if target.obj_id in models]
    return chosen


def draw_detections(photo: np.ndarray, detections: Sequence[Detection]) -> np.ndarray:
    """The photo with masks in the colours of their objects, the most confident on top."""
    image, labels = photo.copy(), []
    for one in detections:
        mask, color = decode_mask(one.require_mask()), choose_color(one.object_id)
        image[mask] = ((1 - MASK_TINT) * image[mask] + MASK_TINT * np.array(color)).astype(np.uint8)
        _draw_outline(image, mask, color)
        if not mask.any():
            continue
        rows, columns = np.nonzero(mask)
        labels.append((f"{one.object_id}: {one.score:.2f}", (int(columns.mean()), int(rows.mean()))))
    for text, place in labels:
        _draw_text(image, text, place)
    return image


def draw_poses(
    photo: np.ndarray, frame: Frame, poses: Sequence[tuple[int, float, np.ndarray]], models: dict[int, ObjectModel],
    renderers: dict[int, DepthRenderer],
) -> np.ndarray:  # fmt: skip
    """The photo with the outlines and the axes of models in their poses."""
    image = photo.copy()
    height, width = photo.shape[:2]
    for number, score, pose in poses:
        _draw_outline(
            image, renderers[number].render(pose, frame.intrinsics, width, height).image(width, height) > 0, choose_color(number), 2
        )
        ends = np.concatenate([np.zeros((1, 3)), np.eye(3)]) * 0.3 * models[number].diameter_mm
        projected = transform_points(ends, pose) @ frame.intrinsics.T
        if (projected[:, 2] <= NEAREST_MM).any():
            continue
        start, *tips = np.rint(projected[:, :2] / projected[:, 2:]).astype(int).tolist()
        for tip, color in zip(tips, AXIS_COLORS, strict=True):
            cv2.line(image, start, tip, color, 2, cv2.LINE_AA)
        _draw_text(image, f"{number}: {score:.2f}", start)
    return image


def draw_worst(
    errors: Path,
    estimates: Estimates,
    frames: Frames,
    models: dict[int, ObjectModel],
    renderers: dict[int, DepthRenderer],
    count: int = 10,
) -> np.ndarray | None:
    """Tiles of the estimates with the largest MSSD: the true outline green, the estimated one red, the errors below.

    None if no object was estimated.
    """
    table = pd.read_csv(errors)
    if "mssd" not in table:
        raise StepError(f"{errors} has no MSSD; score the estimates with --errors mssd and others")
    table = table[table.obj_id.isin(models)].sort_values("mssd", ascending=False, kind="stable")
    if table.empty:
        return None
    poses, tiles = make_transform(estimates.rotations, estimates.translations_mm), []
    for row in table.head(count).to_dict("records"):
        number, frame = row["obj_id"], frames[row["scene_id"], row["im_id"]]
        instance = frame.instances[row["instance"]]
        image = read_image(frame.photo_path())
        height, width = image.shape[:2]
        silhouettes = [
            renderers[number].render(pose, frame.intrinsics, width, height).image(width, height) > 0
            for pose in (instance.camera_from_model, poses[row["estimate"]])
        ]
        tile, scale = _cut_tile(image, silhouettes[0] | silhouettes[1])
        for silhouette, color in zip(silhouettes, (TRUE_COLOR, ESTIMATED_COLOR), strict=True):
            _draw_outline(tile, _cut_tile(silhouette.astype(np.uint8) * 255, silhouettes[0] | silhouettes[1])[0] > 127, color, 1)
        share = "" if instance.visible_share is None else f", {100 * instance.visible_share:.0f} % visible"
        lines = [f"scene {frame.scene_id}, image {frame.image_id}, object {number}{share}"]
        lines.append(", ".join(f"{kind.upper()} {row[kind]:.2f}" for kind in ("mssd", "mspd", "vsd") if kind in row))
        caption = np.full((CAPTION_PX, TILE_PX, 3), 255, np.uint8)
        for baseline_px, line in zip(CAPTION_BASELINES_PX, (lines[0], f"{lines[1]}, score {row['score']:.2f}"), strict=True):
            cv2.putText(caption, line, (CAPTION_LEFT_PX, baseline_px), FONT, CAPTION_SCALE, BLACK, 1, cv2.LINE_AA)
        tiles.append(np.concatenate([tile, caption]))
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % min(IN_A_ROW, len(tiles)))
    across = min(IN_A_ROW, len(tiles))
    return np.concatenate([np.concatenate(tiles[start : start + across], 1) for start in range(0, len(tiles), across)])


def choose_color(number: int) -> tuple[int, int, int]:
    """A bright colour for an object."""
    # Hues of consecutive objects are far apart, of OpenCV's 180.
    hue = np.array([[[(number * 67) % 180, 200, 255]]], np.uint8)
    red, green, blue = cv2.cvtColor(hue, cv2.COLOR_HSV2RGB)[0, 0].tolist()
    return red, green, blue


def _draw_outline(image: np.ndarray, mask: np.ndarray, color: tuple[int, int, int], thickness: int = 1) -> None:
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(image, contours, -1, color, thickness)


def _draw_text(image: np.ndarray, text: str, place: Sequence[int]) -> None:
    for color, thickness in ((BLACK, LABEL_EDGE_PX), (WHITE, 1)):
        cv2.putText(image, text, tuple(place), FONT, LABEL_SCALE, color, thickness, cv2.LINE_AA)


def _cut_tile(image: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, float]:
    """A square tile of the image around the mask, and its magnification; black beyond the image."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not len(rows):
        rows, columns = np.arange(mask.shape[0]), np.arange(mask.shape[1])
    side = int(TILE_MARGIN * max(rows[-1] - rows[0], columns[-1] - columns[0])) + LEAST_MARGIN_PX
    top, left = int(rows[0] + rows[-1] - side) // 2, int(columns[0] + columns[-1] - side) // 2
    cut = cv2.copyMakeBorder(image, side, side, side, side, cv2.BORDER_CONSTANT, value=BLACK)
    cut = cut[top + side : top + 2 * side, left + side : left + 2 * side]
    return cv2.resize(cut, (TILE_PX, TILE_PX), interpolation=cv2.INTER_LINEAR), TILE_PX / side
