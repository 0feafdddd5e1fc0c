"""The targets of a test, test_targets_bop19.json: which objects to find in which images.

Those of the BOP Challenge 2024, test_targets_bop24.json, may name images alone: then all objects in them are to be found of which the
truth says that at least a tenth is visible, as in the challenges before.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from zeroshop_steps.bop.formats.bop_scenes import Frame, list_scenes, read_scene
from zeroshop_steps.bop.formats.schema import read_validated
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import write_json

LEAST_VISIBLE_SHARE = 0.1
"""Of an object that is a target."""

Frames = dict[tuple[int, int], Frame]
"""Images by scene and image number."""


@dataclass(frozen=True)
class Target:
    """An object to find in an image, with its number of instances; fields are named as in the file."""

    scene_id: int
    im_id: int
    obj_id: int
    inst_count: int


def find_targets(split: Path) -> Path:
    """The targets of a split, such as test_primesense: its own, or those of all splits of its kind (test_targets_bop19.json).

    Raises:
        StepError: there are none.
    """
    kind = split.name.split("_")[0]
    stems = dict.fromkeys((split.name, kind))
    names = [f"{stem}_targets_{year}.json" for stem in stems for year in ("bop19", "bop24")] + [f"{kind}_targets.json"]
    there = sorted(split.parent.glob(f"{kind}_targets*.json"))
    for path in (*(split.parent / name for name in names), *(there if len(there) == 1 else [])):
        if path.is_file():
            return path
    found = f"it has {', '.join(path.name for path in there)}" if there else "it has none"
    raise StepError(f"{split.parent} must have the targets of {split.name}, {' or '.join(names)}; {found}")


def read_targets(path: Path, split: Path | None = None) -> list[Target]:
    """Read targets in the order of the file.

    Args:
        path: of the targets.
        split: folder of the scenes, whose truth says which objects are in images that the targets name alone.

    Raises:
        StepError: the form is wrong, an image asks for an object twice, or for no object and `split` is not given.
    """
    targets: list[Target] = []
    scenes: dict[int, Mapping[int, Frame]] = {}
    for entry in read_validated(path, "targets"):
        scene_id, image_id = entry["scene_id"], entry["im_id"]
        if "obj_id" in entry:
            targets.append(Target(scene_id, image_id, entry["obj_id"], entry["inst_count"]))
            continue
        folders = list_scenes(split) if split else {}
        if scene_id not in folders:
            raise StepError(f"{path}: scene {scene_id}, image {image_id} has no obj_id, and no truth says which objects are in it")
        frame = scenes.setdefault(scene_id, read_scene(folders[scene_id])).get(image_id)
        shares = [(one.object_id, one.visible_share) for one in frame.instances] if frame else []
        counts = Counter(number for number, share in shares if share is None or share >= LEAST_VISIBLE_SHARE)
        targets += [Target(scene_id, image_id, number, count) for number, count in sorted(counts.items())]
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
            raise StepError(
                f"{targets_path} asks for scene {target.scene_id}, which {split} does not have; it has"
                f" {sorted(folders)}. Take targets and images of the same dataset"
            )
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


def size_finder(frames: Frames) -> Callable[[int, int], tuple[int, int] | None]:
    """Gives the (width, height) of an image by its scene and number; of one that is not among the frames, and not used, that of another."""
    return lambda scene_id, image_id: frames.get((scene_id, image_id), next(iter(frames.values()))).size_px()
