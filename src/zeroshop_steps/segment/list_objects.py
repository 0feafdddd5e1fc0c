"""List the objects that stand in a registered scene, the likeliest to be meant first, so that each can get masks and a mesh of its own.

Writes objects.json: the `number` of each, from 1, its `center` (x, y, z) in the scene's world, by which its masks find it again, its `size`
along the axes of the support plane and its normal in the same unit, and the share of it outside the median photo (`cut_off`). And
objects.png, three photos with these numbers.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.registered_views import read_views, space_evenly
from zeroshop_steps.geometry.imaging.contact_sheets import arrange_in_rows
from zeroshop_steps.geometry.imaging.images import read_image, write_image
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_directory, read_json, write_json
from zeroshop_steps.segment.finder import WIDTH_PX, find_all_on
from zeroshop_steps.segment.objects import NothingFound, SceneObjects
from zeroshop_steps.segment.photometry.exposure import estimate_exposure
from zeroshop_steps.segment.scene import MaskScene, read_mask_scene
from zeroshop_steps.segment.support import propose_supports
from zeroshop_steps.segment.support_voxels import render_silhouettes

TABLE, PICTURE = "objects.json", "objects.png"
SHOWN, SHOWN_WIDTH_PX = 3, 960  # photos in the picture
COLORS = ((230, 25, 75), (60, 180, 75), (0, 130, 200), (245, 130, 48), (145, 30, 180), (70, 240, 240), (240, 50, 230), (255, 225, 25))


@dataclass(frozen=True)
class ListedObject:
    """An object of a scene; its center is (3,) in the world, its size along the axes of the support."""

    number: int
    center: np.ndarray
    size: np.ndarray
    cut_off: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line."""
    parser.add_argument("--scene", type=Path, required=True, help="registered scene: images/ and sparse/")
    parser.add_argument("--image-width-px", type=int, default=WIDTH_PX, help="images are cut at this width (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="seed of RANSAC (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help=f"folder to write: {TABLE} and {PICTURE}")


def run(args: argparse.Namespace) -> None:
    """Write the list."""
    views, model = read_views(args.scene)
    scene = read_mask_scene(views, model, estimate_exposure(args.scene, views), None, args.image_width_px, seed=args.seed)
    failure: NothingFound | None = None
    for candidate in propose_supports(model, views, scene.planes):
        try:
            _, found, _ = find_all_on(scene, candidate)
            break
        except NothingFound as error:
            failure = failure or error
    else:
        assert failure is not None
        raise failure
    listed = describe_objects(scene, found)
    with atomic_directory(args.out) as folder:
        write_json(folder / TABLE, {"objects": [describe(one) for one in listed]})
        write_image(folder / PICTURE, draw_objects(scene, found))


def describe_objects(scene: MaskScene, found: SceneObjects) -> list[ListedObject]:
    """What is known of each object."""
    listed = []
    for number in range(1, found.count + 1):
        index = np.argwhere(found.labels == number)
        centres = found.grid.centres(index)
        outside = [1 - camera.find_pixels(centres)[3].mean() for camera in scene.cameras]
        size = found.grid.side * (np.ptp(index, axis=0) + 1)
        listed.append(
            ListedObject(number, centres[np.linalg.norm(centres - centres.mean(0), axis=1).argmin()], size, float(np.median(outside)))
        )
    return listed


def describe(listed: ListedObject) -> dict[str, Any]:
    """As written to objects.json."""
    return {
        "number": listed.number,
        "center": np.round(listed.center, 6).tolist(),
        "size": np.round(listed.size, 6).tolist(),
        "cut_off": round(listed.cut_off, 3),
    }


def read_center(path: Path, number: int) -> np.ndarray:
    """(3,) where an object of a list is. Raises StepError where it has no such object."""
    listed = {one["number"]: one["center"] for one in read_json(path)["objects"]}
    if number not in listed:
        raise StepError(f"{path} lists no object {number}; it has {', '.join(map(str, listed))}")
    return np.array(listed[number])


def draw_objects(scene: MaskScene, found: SceneObjects) -> np.ndarray:
    """(H, W, 3) uint8: some photos with the outlines and the numbers of all objects."""
    chosen = space_evenly(len(scene.cameras), SHOWN)
    outlines = [
        render_silhouettes(found.grid, found.labels == number, [scene.cameras[view] for view in chosen])
        for number in range(1, found.count + 1)
    ]
    tiles = []
    for place, view in enumerate(chosen):
        photo = read_image(scene.views[view].image_path)
        scale = SHOWN_WIDTH_PX / photo.shape[1]
        tile = cv2.resize(photo, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        tiles.append(_outline(tile, [shown[place] for shown in outlines]))
    return arrange_in_rows(tiles)[:, : SHOWN_WIDTH_PX * len(tiles)]


def _outline(tile: np.ndarray, silhouettes: Sequence[np.ndarray]) -> np.ndarray:
    for number, shown in enumerate(silhouettes, 1):
        mask = cv2.resize(np.asarray(shown, np.uint8), tile.shape[1::-1], interpolation=cv2.INTER_NEAREST)
        color = COLORS[(number - 1) % len(COLORS)]
        cv2.drawContours(tile, cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0], -1, color, 2)
        rows, columns = np.nonzero(mask)
        if len(rows):
            place = int(columns.mean()) - 10, int(rows.mean()) + 10
            cv2.putText(tile, str(number), place, cv2.FONT_HERSHEY_SIMPLEX, 1.2, (255, 255, 255), 6, cv2.LINE_AA)
            cv2.putText(tile, str(number), place, cv2.FONT_HERSHEY_SIMPLEX, 1.2, color, 2, cv2.LINE_AA)
    return tile
