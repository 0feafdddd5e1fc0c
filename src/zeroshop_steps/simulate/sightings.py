"""What the robot makes of several things on a table (4.4.3): the share of objects that it segments, and of these with a right pose.

Every object in an image is asked for in turn. It counts as segmented where the mask overlaps the true visible one by half or more, and
its pose as right where no point of the model is off by more than a tenth of its diameter (MSSD). Writes scenes.csv, a row an object,
and a picture a scene: true masks in green, the robot's meshes in their estimated poses in red.
"""

import argparse
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.bop.formats.bop_scenes import Frame, list_scenes, read_scene
from zeroshop_steps.bop.formats.models import ObjectModel, list_objects, read_models
from zeroshop_steps.geometry.imaging.contact_sheets import GREEN, RED
from zeroshop_steps.geometry.imaging.images import compute_overlap, write_image
from zeroshop_steps.pose.confidence import SAME_DIAMETERS
from zeroshop_steps.runtime.failures import read_failure
from zeroshop_steps.runtime.files import atomic_directory, read_json
from zeroshop_steps.runtime.progress import track
from zeroshop_steps.runtime.tables import write_table
from zeroshop_steps.simulate.camera import in_memory
from zeroshop_steps.simulate.failure_pictures import draw_outline, silhouette
from zeroshop_steps.simulate.perception import Perception
from zeroshop_steps.simulate.scenes import read_layouts
from zeroshop_steps.simulate.true_object import SEGMENTED_IOU, pose_error_mm

READS_FAILURES = True
COLUMNS = ("kind", "scene", "object_id", "visible_share", "segmented", "iou", "pose_right", "pose_error_mm", "pose_error_diameters")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--scenes", type=Path, required=True, help="folder of scenes, made by --method scenes")
    parser.add_argument("--truth", type=Path, required=True, help="folder of the true models")
    parser.add_argument("--models", type=Path, required=True, help="folder of the models that the robot knows, in BOP's layout")
    parser.add_argument("--templates", type=Path, required=True, help="their 42 views")
    parser.add_argument("--aligned", type=Path, nargs="*", default=[], help="aligned.json of the robot's meshes; none for true ones")
    parser.add_argument("--out", type=Path, required=True, help="folder to write: scenes.csv and a picture a scene")


def run(args: argparse.Namespace) -> None:
    """Write what the robot makes of the scenes."""
    records = [read_json(path) for path in args.aligned if not read_failure(path)]
    examiner = Examiner(
        Perception(args.models, args.templates),
        read_models(args.truth, list_objects(args.truth)),
        {record["model_info"]["obj_id"]: np.array(record["truth_from_mesh"], float) for record in records},
    )
    rows = []
    with atomic_directory(args.out) as folder:
        scenes, layouts = list_scenes(args.scenes), read_layouts(args.scenes)
        for scene_id, scene in track(scenes.items(), "scenes", len(scenes)):
            found, picture = examiner.examine(read_scene(scene)[0])
            rows += [{"kind": layouts[scene_id], "scene": scene_id, **row} for row in found]
            write_image(folder / f"{scene_id:06d}.png", picture)
        write_table(folder / "scenes.csv", rows, COLUMNS)
    right = sum(row["pose_right"] for row in rows)
    print(f"{args.out}: {sum(row['segmented'] for row in rows)} of {len(rows)} segmented, {right} poses right", file=sys.stderr)


@dataclass(frozen=True)
class Examiner:
    """A robot's perception and the truth.

    Attributes:
        perception: with the robot's meshes.
        truth: the true models, by number.
        truth_from_mesh: (4, 4) of the robot's meshes, by number; missing ones are the identity.
    """

    perception: Perception
    truth: Mapping[int, ObjectModel]
    truth_from_mesh: Mapping[int, np.ndarray]

    def examine(self, frame: Frame) -> tuple[list[dict[str, Any]], np.ndarray]:
        """A row an object of the image, and the picture, (height, width, 3) uint8."""
        seen = in_memory(frame)
        found, picture, rows = self.perception.detect(seen), seen.photo.copy(), []
        for index, instance in enumerate(frame.instances):
            number, visible = instance.object_id, frame.mask(index)
            draw_outline(picture, visible, GREEN)
            row: dict[str, Any] = {"object_id": number, "visible_share": round(instance.visible_share or 0.0, 4)}
            row |= {"segmented": 0, "pose_right": 0}
            sighting = self.perception.find(seen, number, found) if number in self.perception.models else None
            if sighting:
                iou = compute_overlap(visible, sighting.mask)
                row |= {"iou": round(iou, 4), "segmented": int(iou >= SEGMENTED_IOU)}
            if sighting and sighting.camera_from_model is not None:
                model, transform = self.truth[number], self.truth_from_mesh.get(number, np.eye(4))
                error_mm = pose_error_mm(
                    sighting.camera_from_model, transform, instance.camera_from_model, model.mesh.vertices, model.symmetries
                )
                share = error_mm / model.diameter_mm
                row |= {"pose_error_mm": round(error_mm, 3), "pose_error_diameters": round(share, 4)}
                row["pose_right"] = int(share <= SAME_DIAMETERS)
                mesh = self.perception.models[number].mesh
                draw_outline(picture, silhouette(mesh, sighting.camera_from_model, seen.intrinsics, picture.shape), RED)
            rows.append(row)
        return rows, picture
