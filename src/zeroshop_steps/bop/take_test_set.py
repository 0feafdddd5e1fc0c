"""Take a test set of BOP as it is: from a local folder in BOP's layout, or from BOP's public hosting.

The scenes stay where they are; the folder that is written has links to them. A scene that lacks masks or visibilities, as those of some
datasets do, gets them from the true poses, the models and the measured depth, as BOP's own tools make them (visible: at most 15 mm
behind the measured surface; Hodan et al., BOP: Benchmark for 6D object pose estimation, ECCV 2018).
"""

import argparse
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from zeroshop_steps.bop.annotate import annotate
from zeroshop_steps.bop.formats.bop_scenes import Frame, Instance, list_scenes, write_scene
from zeroshop_steps.bop.formats.models import list_objects, read_models
from zeroshop_steps.bop.formats.targets import Frames, find_targets, read_target_frames, read_targets, write_targets
from zeroshop_steps.bop.scoring.depth_render import DepthRenderer
from zeroshop_steps.geometry.imaging.images import write_mask
from zeroshop_steps.runtime.downloads import download
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import atomic_directory, locked, read_json, write_json

HOST = "https://huggingface.co/datasets/bop-benchmark/{name}/resolve/main/{file}"
HOSTED_TESTS = {"ycbv": ("ycbv_test_bop19.zip", "ycbv_base.zip")}
"""The archives of the test images and of the targets, by dataset."""
DELTA_MM = 15.0
"""How far behind the measured surface an object still counts as visible, BOP's tolerance."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--dataset", required=True, help="BOP's short name, e.g. ycbv")
    parser.add_argument("--test", type=Path, help="folder of the scenes, or of the dataset that has one such folder (default: download)")
    parser.add_argument("--models", type=Path, required=True, help="folder of the true models; targets without a model are left out")
    parser.add_argument("--resources", type=Path, default=Path("resources"), help="folder for downloads (default: %(default)s)")
    parser.add_argument("--targets", type=Path, required=True, help="test_targets_bop19.json to write")
    parser.add_argument("--camera", type=Path, required=True, help="camera.json to write")
    parser.add_argument("--out", type=Path, required=True, help="folder of the scenes to write")


def run(args: argparse.Namespace) -> None:
    """Entry point of the command line."""
    split = find_split(args.test or download_test(args.dataset, args.resources))
    path = find_targets(split)
    known = set(list_objects(args.models))
    targets = read_targets(path, split)
    kept = [target for target in targets if target.obj_id in known]
    if not kept:
        raise StepError(f"{path} asks for the objects {sorted({target.obj_id for target in targets})}; {args.models} has {sorted(known)}")
    if len(kept) < len(targets):
        strange = sorted({target.obj_id for target in targets} - known)
        warn(f"{path}: {len(targets) - len(kept)} of {len(targets)} targets are left out; the dataset's objects lack {strange}")
    frames = read_target_frames(split, kept, path)
    with atomic_directory(args.out) as folder:
        for number, place in list_scenes(split).items():
            asked = [frame for (scene, _), frame in frames.items() if scene == number]
            if asked:
                link_scene(place, asked, folder / place.name, args.models)
    write_targets(args.targets, kept)
    write_json(args.camera, make_camera_record(frames, split))
    print(f"{args.out}: {len({target.scene_id for target in kept})} scenes, {len(frames)} images, {len(kept)} targets of {path}")


def find_split(folder: Path) -> Path:
    """The folder of the scenes: `folder`, or the one in it that holds scenes and is called test or val, such as test_primesense.

    Raises:
        StepError: the folder does not exist, or it has none or several of them.
    """
    if not folder.is_dir():
        raise StepError(f"test_folder {folder} does not exist; correct test_folder in the config (--test)")
    if any((place / "scene_camera.json").is_file() for place in folder.iterdir() if place.name.isdigit()):
        return folder
    splits = sorted(place for place in folder.iterdir() if place.name.startswith(("test", "val")) and place.is_dir())
    splits = [place for place in splits if any((scene / "scene_camera.json").is_file() for scene in place.iterdir())]
    if len(splits) != 1:
        found = f"it has {', '.join(place.name for place in splits)}: name one of them" if splits else "it has neither scenes nor test*"
        raise StepError(
            f"test_folder {folder} must hold scenes such as 000048 with scene_camera.json, or one folder test* of them; {found}"
        )
    return splits[0]


def download_test(dataset: str, resources: Path) -> Path:
    """The folder of a hosted dataset's test images under `resources`, downloaded and unpacked at first use.

    Raises:
        StepError: no download is known or it failed, or an archive has another content than expected.
    """
    if dataset not in HOSTED_TESTS:
        raise StepError(f"no download of test images is known for {dataset} (known: {', '.join(HOSTED_TESTS)}); name a local test_folder")
    folder = resources / "bop" / dataset / "test_set"
    without = f"name a local folder: datasets: {dataset}: test_folder in the config"
    archives = [download(HOST.format(name=dataset, file=file), resources / "downloads" / file, without) for file in HOSTED_TESTS[dataset]]
    with locked(folder.with_name("test_set.lock")):
        if not folder.is_dir():
            with atomic_directory(folder) as temporary:
                for archive in archives:
                    unpack(archive, temporary, dataset)
    return folder


def unpack(archive: Path, folder: Path, dataset: str) -> None:
    """Unpack an archive of BOP, whose files may lie below a folder with the dataset's name."""
    try:
        with zipfile.ZipFile(archive) as opened:
            for member in opened.infolist():
                member.filename = member.filename.removeprefix(f"{dataset}/")
                if member.filename:
                    opened.extract(member, folder)
    except (zipfile.BadZipFile, EOFError) as error:
        raise StepError(f"{archive} is not a whole zip archive ({error}); delete it and its .sha256 and fetch it again") from None


def link_scene(place: Path, frames: Sequence[Frame], out: Path, models_folder: Path) -> None:
    """Link a scene to `out`; where annotations of its target images are missing, a scene of these images with all of them."""
    if all(_is_annotated(frame, index) for frame in frames for index in range(len(frame.instances))) or not frames[0].image_path("depth"):
        out.symlink_to(place.resolve(), target_is_directory=True)
        return
    out.mkdir()
    for kind in ("rgb", "gray", "depth"):
        if (place / kind).is_dir():
            (out / kind).symlink_to((place / kind).resolve(), target_is_directory=True)
    models = read_models(
        models_folder, {instance.object_id for frame in frames for instance in frame.instances} & set(list_objects(models_folder))
    )
    renderers = {number: DepthRenderer(model.mesh) for number, model in models.items()}
    write_scene(out, [_annotate_frame(frame, renderers, out) for frame in frames])


def _is_annotated(frame: Frame, index: int) -> bool:
    masks = all(frame.image_path(kind, index) for kind in ("mask", "mask_visib"))
    return masks and frame.instances[index].visible_share is not None


def _annotate_frame(frame: Frame, renderers: dict[int, DepthRenderer], out: Path) -> Frame:
    """The frame with the annotations of all its instances that have a model; given visible masks are kept."""
    measured_mm = frame.depth_mm()
    instances: list[Instance] = []
    for index, instance in enumerate(frame.instances):
        if instance.object_id not in renderers:
            continue
        pose = instance.camera_from_model
        found = annotate(renderers[instance.object_id], pose, frame.intrinsics, measured_mm, measured_mm, DELTA_MM)
        visible = frame.mask(index) if frame.image_path("mask_visib", index) else found.visible
        share = float(min(1.0, visible.sum() / max(found.info["px_count_all"], 1)))
        info = found.info | {"px_count_visib": int(visible.sum()), "visib_fract": share} | instance.info
        for kind, mask in (("mask", found.silhouette | visible), ("mask_visib", visible)):
            write_mask(out / kind / f"{frame.image_id:06d}_{len(instances):06d}.png", mask)
        instances.append(replace(instance, visible_share=info["visib_fract"], info=info))
    return replace(frame, instances=tuple(instances), folder=out)


def make_camera_record(frames: Frames, split: Path) -> dict:
    """The content of camera.json: of the first image, or where there are no images, of the camera file beside the split that fits it."""
    frame = next(iter(frames.values()))
    k = frame.intrinsics
    record = {"cx": k[0, 2], "cy": k[1, 2], "depth_scale": frame.depth_scale, "fx": k[0, 0], "fy": k[1, 1]}
    size = frame.size_px()
    if size:
        return record | {"height": size[1], "width": size[0]}
    fitting = [camera for path in sorted(split.parent.glob("camera*.json")) if np.isclose((camera := read_json(path))["fx"], k[0, 0], 0.01)]
    return record | ({name: fitting[0][name] for name in ("height", "width")} if fitting else {})
