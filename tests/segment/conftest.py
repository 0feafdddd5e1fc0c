"""A small virtual scene that the segmentation tests share: a printed carton on a textured surface, with exact masks."""

import functools

import numpy as np
import pytest

from zeroshop_steps.geometry.cameras.pinhole import SparseModel, read_sparse_model
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.imaging.images import read_depth_mm
from zeroshop_steps.synthetic.demo_objects import write_demo_object
from zeroshop_steps.synthetic.raycast import capture
from zeroshop_steps.synthetic.rendering import lighting
from zeroshop_steps.synthetic.scenes import scene_meshes

WIDTH, HEIGHT = 240, 180
TEXELS = 1024  # of the surface, along each side


@pytest.fixture(scope="session")
def carton_scene(tmp_path_factory) -> tuple[list[View], SparseModel]:
    """Twenty views with true cameras and masks, and sparse points sampled from their true depths, on the object and around it."""
    folder = tmp_path_factory.mktemp("segment")
    write_demo_object("gelatin_carton", folder / "model")
    with pytest.MonkeyPatch.context() as patch:
        # Fewer texels and samples of light, which take most of the time and do not matter in images this small.
        patch.setattr(lighting, "SURFACE_CELLS", 24)
        patch.setattr(scene_meshes, "make_rich_texture", functools.partial(scene_meshes.make_rich_texture, texels=TEXELS))
        capture(folder / "model" / "model.ply", "su_h", WIDTH, HEIGHT, 0, folder / "capture")
    cameras = read_sparse_model(folder / "capture" / "truth").cameras
    views = [View(camera, folder / "capture/images" / camera.name, folder / "capture/masks" / camera.name) for camera in cameras]
    rng = np.random.default_rng(0)
    points = []
    for camera in cameras:
        depth = read_depth_mm(folder / "capture/depth" / camera.name)
        y, x = np.nonzero(depth)
        pick = rng.choice(len(y), 80, replace=False)
        y, x = y[pick], x[pick]
        rays = np.stack([x + 0.5, y + 0.5, np.ones(len(x))], 1) @ np.linalg.inv(camera.intrinsics).T
        world_from_camera = np.linalg.inv(camera.camera_from_world)
        points.append(rays * depth[y, x][:, None] @ world_from_camera[:3, :3].T + world_from_camera[:3, 3])
    points = np.concatenate(points)
    return views, SparseModel(tuple(cameras), points, np.zeros((len(points), 3), np.uint8), np.full(len(points), 3))
