"""The targets of a test, test_targets_bop19.json: which objects to find in which images."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from zeroshop_steps.bop.scene import Frame, list_scenes, read_scene
from zeroshop_steps.bop.schema import read_validated
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import write_json

Frames = dict[tuple[int, int], Frame]
"""Images by scene and image number."""


@dataclass(frozen=True)
class Target:
    """An object to find in an image, with its number of instances; fields are named as in the file."""

    scene_id: int
    im_id: int
    obj_id: int
    inst_count: int


def read_targets(path: Path) -> list[Target]:
    """Read targets in the order of the file. Raises StepError if the form is wrong or an image asks for an object twice."""
    targets = [Target(*(entry[key] for key in ("scene_id", "im_id", "obj_id", "inst_count"))) for entry in read_validated(path, "targets")]
    seen = set()
    for target in targets:
        key = target.scene_id, target.im_id, target.obj_id
        if key in seen:
            raise StepError(f"{path}: scene {key[0]}, image {key[1]} asks for object {key[2]} twice; give one entry with inst_count")
        seen.add(key)
    return targets


def write_targets(path: Path, targets: list[Target]) -> None:
    """Write targets as JSON."""
    write_json(path, [asdict(target) for target in targets])


def read_target_frames(split: Path, targets: list[Target], targets_path: Path, truth_needed: bool = True) -> Frames:
    """Read the images that targets name.

    Args:
        split: folder of the scenes.
        targets: as read.
        targets_path: of the targets, for messages.
        truth_needed: if False, scenes may lack scene_gt.json.

    Raises:
        StepError: a target's scene, image or instances are missing.
    """
    folders = list_scenes(split)
    scenes: dict[int, Mapping[int, Frame]] = {}
    frames: Frames = {}
    for target in targets:
        if target.scene_id not in folders:
            raise StepError(f"{targets_path} asks for scene {target.scene_id}, which {split} does not have; it has {sorted(folders)}")
        if target.scene_id not in scenes:
            scenes[target.scene_id] = read_scene(folders[target.scene_id], truth_needed)
        frame = scenes[target.scene_id].get(target.im_id)
        if frame is None:
            raise StepError(
                f"{targets_path} asks for image {target.im_id} of scene {target.scene_id}, which"
                f" {folders[target.scene_id]} does not have; take targets and images of the same dataset"
            )
        there = sum(instance.object_id == target.obj_id for instance in frame.instances)
        if there < target.inst_count and (truth_needed or frame.instances):
            raise StepError(
                f"{targets_path} asks for {target.inst_count} of object {target.obj_id} in {frame.name}, but scene_gt.json has {there}"
            )
        frames[target.scene_id, target.im_id] = frame
    return frames
