"""A small BOP dataset with colours: a carton and a can between strange blocks on a table, two images of 320 x 240 px, depth in whole mm."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import trimesh

from zeroshop_steps.bop.formats.bop_scenes import Frame, Instance, write_scene
from zeroshop_steps.bop.formats.models import model_path
from zeroshop_steps.bop.formats.targets import Target, write_targets
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.viewpoints import look_at
from zeroshop_steps.geometry.imaging.images import write_image, write_mask
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.runtime.cli import stage_main

WIDTH_PX, HEIGHT_PX, FOCAL_PX = 320, 240, 420.0
CARTON, CAN = 3, 8


def painted(solid: trimesh.Trimesh, colors: list[tuple[int, int, int]]) -> Mesh:
    """A solid whose faces are painted in turn by the direction that they look in."""
    _, side = np.unique(np.round(solid.face_normals).astype(int), axis=0, return_inverse=True)
    faces = np.arange(3 * len(solid.faces)).reshape(-1, 3)
    u = (np.repeat(side.reshape(-1), 3) % len(colors) + 0.5) / len(colors)
    texture = np.repeat(np.array([colors], np.uint8), 4, axis=1)
    return Mesh(np.asarray(solid.vertices)[solid.faces.reshape(-1)], faces, None, np.stack([u, np.full(len(u), 0.5)], 1), texture)


def carton() -> Mesh:
    return painted(trimesh.creation.box((90, 60, 140)), [(200, 30, 30), (240, 240, 230), (30, 60, 190)])


def can() -> Mesh:
    return painted(trimesh.creation.cylinder(35, 100, sections=64), [(40, 150, 60), (230, 200, 40)])


def write_painted_dataset(folder: Path) -> SimpleNamespace:
    """Write models/, templates/, test/000001 and test_targets_bop19.json."""
    meshes, listed = {CARTON: carton(), CAN: can()}, {}
    for number, mesh in meshes.items():
        path = model_path(folder / "models", number)
        write_ply(path, mesh.with_normals(), path.with_suffix(".png").name)
        write_image(path.with_suffix(".png"), mesh.texture)
        corners = trimesh.Trimesh(mesh.vertices, process=False).convex_hull.vertices
        listed[number] = {"diameter": float(np.linalg.norm(corners[:, None] - corners[None], axis=2).max())}
    (folder / "models" / "models_info.json").write_text(json.dumps(listed))
    table = painted(trimesh.creation.box((1500, 1500, 2)), [(150, 145, 140)])
    block = painted(trimesh.creation.box((50, 50, 70)), [(120, 120, 125), (150, 60, 150)])
    # In the table's frame, z up: the can stands behind the carton's corner in one image.
    things = [(None, table, (0, 0, -1), 0), (None, block, (110, 60, 35), 20), (None, block, (-120, -70, 35), 50)]
    things += [(CARTON, meshes[CARTON], (-10, 0, 70), 25), (CAN, meshes[CAN], (40, -90, 50), 0)]
    renderers = [MeshRenderer(mesh) for _, mesh, _, _ in things]
    scene, frames, targets = folder / "test" / "000001", [], []
    intrinsics = np.array([[FOCAL_PX, 0, WIDTH_PX / 2], [0, FOCAL_PX, HEIGHT_PX / 2], [0, 0, 1]])
    for image, eye in enumerate([(250.0, -480.0, 420.0), (560.0, 120.0, 350.0)]):
        camera_from_table = look_at(np.array(eye), np.array([0.0, -20.0, 40.0]))
        depth, color = np.full((HEIGHT_PX, WIDTH_PX), np.inf), np.zeros((HEIGHT_PX, WIDTH_PX, 3), np.uint8)
        owner, poses = np.full(depth.shape, -1), []
        for index, ((_, _, place, turn_deg), renderer) in enumerate(zip(things, renderers, strict=True)):
            table_from_thing = trimesh.transformations.rotation_matrix(np.radians(turn_deg), [0, 0, 1])
            table_from_thing[:3, 3] = place
            poses.append(camera_from_table @ table_from_thing)
            camera = Camera("", WIDTH_PX, HEIGHT_PX, intrinsics, poses[-1])
            hits = renderer.cast_rays(camera)
            front = hits.mask & (hits.depth < depth)
            depth[front], owner[front] = hits.depth[front], index
            color[front] = renderer.render_masked_color(camera)[0][front]
        write_image(scene / "rgb" / f"{image:06d}.png", (color * 0.8).astype(np.uint8))
        write_image(scene / "depth" / f"{image:06d}.png", np.rint(np.where(np.isfinite(depth), depth, 0)).astype(np.uint16))
        instances = []
        for index, (number, _, _, _) in enumerate(things):
            if number is not None:
                write_mask(scene / "mask" / f"{image:06d}_{len(instances):06d}.png", owner == index)
                write_mask(scene / "mask_visib" / f"{image:06d}_{len(instances):06d}.png", owner == index)
                instances.append(Instance(number, poses[index], 0.9, {"visib_fract": 0.9}))
                targets.append(Target(1, image, number, 1))
        shift = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
        frames.append(Frame(1, image, intrinsics - shift, 1.0, None, tuple(instances), scene))
    write_scene(scene, frames)
    write_targets(folder / "test_targets_bop19.json", targets)
    words = ["--method", "templates", "--models", folder / "models", "--side-px", 112, "--out", folder / "templates"]
    assert stage_main("zeroshop_steps.detect", list(map(str, words))) == 0
    return SimpleNamespace(folder=folder, scenes=folder / "test", scene=scene, frames=frames)


def detect(dataset: SimpleNamespace, method: str, *options: str) -> int:
    """Run a detector on the whole dataset; its exit status. Writes detections.json."""
    words = ["--method", method, "--models", dataset.folder / "models", "--templates", dataset.folder / "templates"]
    words += ["--scenes", dataset.scenes, "--out", dataset.folder / "detections.json", *options]
    return stage_main("zeroshop_steps.detect", list(map(str, words)))
