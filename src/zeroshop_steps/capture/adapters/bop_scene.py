"""A scene in BOP's layout, also of its onboarding sequences: the object's poses in the images are the cameras around it, in millimetres.

Without poses of an object, the cameras of the scene itself are taken (cam_R_w2c), if it has them.
"""

from collections import Counter
from pathlib import Path

from zeroshop_steps.bop.formats.bop_scenes import HALF_PX, read_scene
from zeroshop_steps.bop.formats.bop_scenes import Frame as BopFrame
from zeroshop_steps.capture.adapters.form import Adapter, GivenFrame, ImportedCapture, ImportOptions, choose_unit, read_size_px
from zeroshop_steps.capture.cameras_json import Lens
from zeroshop_steps.runtime.errors import StepError


def recognizes(folder: Path) -> bool:
    """Whether a folder is a scene."""
    return (folder / "scene_camera.json").is_file()


def read(folder: Path, options: ImportOptions) -> ImportedCapture:
    """All images that show the object; without poses of objects, all images."""
    folder = folder.resolve()
    frames = read_scene(folder, truth_needed=False)
    counts = Counter(instance.object_id for frame in frames.values() for instance in frame.instances)
    object_id = _choose_object(folder, counts, options.object_id)
    found = []
    for _, frame in sorted(frames.items()):
        image = frame.image_path("rgb") or frame.image_path("gray")
        chosen = [number for number, instance in enumerate(frame.instances) if instance.object_id == object_id]
        if image is None or (counts and not chosen):
            continue
        pose = frame.instances[chosen[0]].camera_from_model if counts else frame.camera_from_world
        mask = frame.image_path("mask_visib", chosen[0]) or frame.image_path("mask", chosen[0]) if counts else None
        lens = Lens.pinhole(frame.intrinsics + HALF_PX, read_size_px(image))
        found.append(GivenFrame(image, lens, pose, mask, _find_depth(frame), frame.depth_scale or 1.0))
    if not found:
        raise StepError(f"{folder} has no image of the object {object_id} in rgb/ or gray/; expected 000000.png or .jpg and so on")
    what = f", object {object_id}" if counts else ""
    return ImportedCapture(found, f"BOP scene {folder.name}{what}", choose_unit(options, "mm"))


def _find_depth(frame: BopFrame) -> Path | None:
    return frame.image_path("depth") if frame.depth_scale is not None else None


def _choose_object(folder: Path, counts: Counter[int], wanted: int | None) -> int | None:
    if not counts:
        return None
    known = ", ".join(f"{number} ({count} images)" for number, count in sorted(counts.items()))
    if wanted is None and len(counts) > 1:
        raise StepError(f"{folder} shows several objects: {known}; choose one with zeroshop import --object")
    if wanted is not None and wanted not in counts:
        raise StepError(f"{folder} does not show the object {wanted}; it shows {known}")
    return wanted if wanted is not None else next(iter(counts))


ADAPTER = Adapter("a BOP scene", "scene_camera.json with rgb/ or gray/, and scene_gt.json", recognizes, read, 1)
