"""The carton as a fixture."""

import numpy as np
import pytest
import trimesh
from carton_scene import SIZE_MM, Carton, add_points, camera_at, printed, table_points

from zeroshop_steps.cameras import write_cameras
from zeroshop_steps.files import write_json
from zeroshop_steps.finish.render import MeshRenderer
from zeroshop_steps.finish.unwrap import unwrap_mesh
from zeroshop_steps.images import write_image, write_mask
from zeroshop_steps.meshes import Mesh, write_ply


@pytest.fixture(scope="session")
def carton(tmp_path_factory: pytest.TempPathFactory) -> Carton:
    folder = tmp_path_factory.mktemp("carton")
    box = trimesh.creation.box(SIZE_MM).subdivide().subdivide().subdivide().subdivide()
    mesh, _ = unwrap_mesh(Mesh(np.array(box.vertices), np.array(box.faces, np.int64)), 512)
    mesh = Mesh(mesh.vertices, mesh.faces, mesh.normals, mesh.uv, printed(mesh, 512))
    cameras = [camera_at(f"{k:06d}.png", 36.0 * k, 35.0 if k % 2 else 5.0) for k in range(10)]
    held_out = [camera_at(f"{k:06d}.png", 20.0 + 170.0 * k, 20.0) for k in range(2)]
    renderer = MeshRenderer(mesh)
    for set_folder, views, sparse in ((folder / "cameras", cameras, "sparse"), (folder / "capture" / "held_out", held_out, "truth")):
        for camera in views:
            write_image(set_folder / "images" / camera.name, renderer.color(camera, (90, 160, 90), 3))
            write_mask(set_folder / "masks" / camera.name, renderer.masked_color(camera, 3)[1])
        write_cameras(set_folder / sparse, views)
    write_cameras(folder / "capture" / "truth", cameras)
    add_points(folder / "cameras" / "sparse", table_points(np.random.default_rng(1), 400))
    write_json(folder / "capture" / "capture.json", {"scene": "su_h", "known_height_m": SIZE_MM[2] / 1000})
    write_image(folder / "model" / "model.png", mesh.texture)
    write_ply(folder / "model" / "model.ply", mesh, "model.png")
    write_json(folder / "model" / "model_info.json", {"diameter": float(np.linalg.norm(SIZE_MM))})
    return Carton(folder / "cameras", folder / "capture", folder / "model" / "model.ply", mesh)
