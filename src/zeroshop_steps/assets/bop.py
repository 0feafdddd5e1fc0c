"""Photos, masks and poses of one object, or of several in the same photos, as a scene in BOP's layout, in millimetres.

`rgb/`, `mask_visib/` (the masks of the photos), `mask/` (silhouettes of the meshes), `scene_camera.json`, `scene_gt.json` and
`scene_gt_info.json`, in a folder `obj_000001_up`, as BOP's static onboarding sequences (2024) are named, or `000001` with several
objects. These have the numbers 1, 2 and so on in the order in which they are named. Models are the meshes; the frame is theirs.
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zeroshop_steps.assets.object_frame import read_object_from_registration
from zeroshop_steps.bop.annotate import annotate
from zeroshop_steps.bop.formats.bop_scenes import HALF_PX, Frame, Instance, write_scene
from zeroshop_steps.bop.scoring.depth_render import DepthRenderer
from zeroshop_steps.geometry.cameras.registered_views import View, read_views
from zeroshop_steps.geometry.cameras.transforms import transform_camera
from zeroshop_steps.geometry.imaging.images import write_mask
from zeroshop_steps.geometry.meshes.metric_mesh import add_unknown_scale_argument, read_metric_mesh
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.meshes.units import M_PER_MM
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_directory, link_or_copy

ALONE, SEVERAL = "obj_000001_up", "000001"


@dataclass(frozen=True)
class _Object:
    """A mesh, in mm, and the photos that show it, by name; `frame_from_registration` is (4, 4), to its frame in mm."""

    renderer: DepthRenderer
    frame_from_registration: np.ndarray
    views: dict[str, View]

    def instance(self, view: View, number: int) -> tuple[Instance, np.ndarray, np.ndarray]:
        """Its entry of a photo, and (H, W) bool: its silhouette, and its mask."""
        camera, mask = transform_camera(view.camera, self.frame_from_registration), view.mask()
        unknown = np.zeros(mask.shape, np.float32)
        found = annotate(self.renderer, camera.camera_from_world, camera.intrinsics - HALF_PX, unknown, unknown).seen_as(mask)
        return Instance(number, camera.camera_from_world, found.info["visib_fract"], found.info), found.silhouette, mask


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--mesh", type=Path, nargs="+", required=True, help="finished meshes in mm with their JSON beside them")
    parser.add_argument("--cameras", type=Path, nargs="+", required=True, help="of each, the registration's cameras, images and masks")
    add_unknown_scale_argument(parser)
    parser.add_argument("--out", type=Path, required=True, help=f"folder to write: {ALONE}/ or {SEVERAL}/")


def run(args: argparse.Namespace) -> None:
    """Write one folder."""
    if len(args.mesh) != len(args.cameras):
        raise StepError(f"--mesh names {len(args.mesh)} meshes, --cameras {len(args.cameras)} folders; name one for each mesh")
    objects = [_read(*parts, args.unknown_scale) for parts in zip(args.mesh, args.cameras, strict=True)]
    photos: dict[str, View] = {}
    for one in objects:
        photos = one.views | photos
    scene = args.out / (ALONE if len(objects) == 1 else SEVERAL)
    with atomic_directory(args.out) as folder:
        frames = [_write_frame(folder / scene.name, number, photos[name], objects) for number, name in enumerate(sorted(photos))]
        write_scene(folder / scene.name, frames)
    print(f"bop: {len(frames)} photos of {len(objects)} object(s) in {scene}", file=sys.stderr)


def _read(mesh: Path, cameras: Path, unknown_scale: str) -> _Object:
    similarity = read_object_from_registration(mesh, unknown_scale)
    similarity[:3] /= M_PER_MM
    metric = read_metric_mesh(mesh, unknown_scale).mesh
    views = {view.camera.name: view for view in read_views(cameras)[0] if view.mask_path is not None}
    if not views:
        raise StepError(f"{cameras} has no masks; expected the cameras folder of a segmented capture")
    return _Object(DepthRenderer(Mesh(metric.vertices / M_PER_MM, metric.faces)), similarity, views)


def _write_frame(folder: Path, number: int, photo: View, objects: list[_Object]) -> Frame:
    """Write a photo and its masks. Returns its entry, with the objects that have a mask in it."""
    stem = f"{number:06d}"
    instances: list[Instance] = []
    for object_id, one in enumerate(objects, 1):
        if (view := one.views.get(photo.camera.name)) is not None:
            instance, silhouette, visible = one.instance(view, object_id)
            for kind, mask in (("mask", silhouette), ("mask_visib", visible)):
                write_mask(folder / kind / f"{stem}_{len(instances):06d}.png", mask)
            instances.append(instance)
    (folder / "rgb").mkdir(exist_ok=True)
    link_or_copy(photo.image_path, folder / "rgb" / f"{stem}{photo.image_path.suffix}")
    return Frame(1, number, photo.camera.intrinsics - HALF_PX, None, None, tuple(instances), folder)
