"""A small BOP dataset: three boxes and a can on a wall's foot, two images of 96 x 72 px, exact depth."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from zeroshop_steps.bop.annotate import annotate
from zeroshop_steps.bop.formats.bop_scenes import Frame, Instance, write_scene
from zeroshop_steps.bop.formats.estimates import Estimates
from zeroshop_steps.bop.formats.models import model_path, read_models
from zeroshop_steps.bop.formats.targets import Target, read_target_frames, read_targets, write_targets
from zeroshop_steps.bop.scoring.depth_render import DepthRenderer
from zeroshop_steps.geometry.imaging.images import write_image, write_mask
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply

WIDTH_PX, HEIGHT_PX = 96, 72
INTRINSICS = np.array([[120.0, 0.0, 47.2], [0.0, 120.0, 35.6], [0.0, 0.0, 1.0]])
BOX, CAN = 1, 2


def write_models(folder: Path) -> None:
    """A box without symmetry and a can that turns about z."""
    box = trimesh.creation.box((90, 60, 40)).subdivide()
    box.vertices[box.vertices[:, 0] > 40, 2] *= 0.6  # a wedge: no half turn maps it onto itself
    can = trimesh.creation.cylinder(30, 80, sections=360)
    can.vertices[can.vertices[:, 2] > 0] *= (0.8, 0.8, 1)
    listed = {}
    for number, shape in ((BOX, box), (CAN, can)):
        mesh = Mesh(np.asarray(shape.vertices), np.asarray(shape.faces))
        write_ply(model_path(folder, number), mesh)
        extent = np.linalg.norm(mesh.vertices[:, None] - mesh.vertices[None], axis=2).max()
        listed[str(number)] = {"diameter": float(extent)}
    listed[str(CAN)]["symmetries_continuous"] = [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]
    (folder / "models_info.json").write_text(json.dumps(listed))


def make_dataset(folder: Path) -> SimpleNamespace:
    """Write models/, test/000001 and test_targets_bop19.json; the second image holds the can twice and asks for one."""
    write_models(folder / "models")
    models = read_models(folder / "models", [BOX, CAN])
    renderers = {number: DepthRenderer(model.mesh) for number, model in models.items()}
    rng = np.random.default_rng(0)
    frames, targets = [], []
    for image, objects in enumerate(([BOX, CAN], [CAN, BOX, CAN])):
        poses = np.tile(np.eye(4), (len(objects), 1, 1))
        poses[:, :3, :3] = Rotation.from_quat(rng.normal(size=(len(objects), 4))).as_matrix()
        poses[:, :3, 3] = [(-55 + 60 * index, 8 * index, 420 + 30 * index) for index in range(len(objects))]
        seen = [
            renderers[n].render(p, INTRINSICS, WIDTH_PX, HEIGHT_PX).image(WIDTH_PX, HEIGHT_PX) for n, p in zip(objects, poses, strict=True)
        ]
        depth = np.min([np.where(one > 0, one, 650.0) for one in seen], axis=0)
        scene = folder / "test" / "000001"
        write_image(scene / "depth" / f"{image:06d}.png", np.rint(depth * 10).astype(np.uint16))
        write_image(scene / "rgb" / f"{image:06d}.png", np.zeros((HEIGHT_PX, WIDTH_PX, 3), np.uint8))
        instances = []
        for index, (number, pose) in enumerate(zip(objects, poses, strict=True)):
            found = annotate(renderers[number], pose, INTRINSICS, depth, depth)
            write_mask(scene / "mask" / f"{image:06d}_{index:06d}.png", found.silhouette)
            write_mask(scene / "mask_visib" / f"{image:06d}_{index:06d}.png", found.visible)
            instances.append(Instance(number, pose, found.info["visib_fract"], found.info))
        frames.append(Frame(1, image, INTRINSICS, 0.1, None, tuple(instances), scene))
        targets += [Target(1, image, number, 1) for number in (BOX, CAN)]
    write_scene(scene, frames)
    write_targets(folder / "test_targets_bop19.json", targets)
    return dataset_in(folder)


def dataset_in(folder: Path) -> SimpleNamespace:
    """The paths of a dataset, and its content read."""
    targets_path = folder / "test_targets_bop19.json"
    targets = read_targets(targets_path)
    frames = read_target_frames(folder / "test", targets, targets_path)
    return SimpleNamespace(folder=folder, targets_path=targets_path, scenes=folder / "test", targets=targets, frames=frames)


def true_estimates(dataset: SimpleNamespace) -> Estimates:
    """Perfect estimates of everything in the images."""
    rows = [(frame, instance) for frame in dataset.frames.values() for instance in frame.instances]
    poses = np.stack([instance.camera_from_model for _, instance in rows])
    return Estimates(
        np.array([frame.scene_id for frame, _ in rows]),
        np.array([frame.image_id for frame, _ in rows]),
        np.array([instance.object_id for _, instance in rows]),
        np.array([instance.visible_share for _, instance in rows]),
        poses[:, :3, :3],
        poses[:, :3, 3],
        np.full(len(rows), 0.5),
    )
