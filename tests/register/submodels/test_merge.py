"""Groups of cameras of one object: its outlines say how they lie to each other, unless it looks the same from all sides."""

import cv2
import numpy as np
import pycolmap
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from helpers.camera_ring import ring_camera
from zeroshop_steps.geometry.cameras.pinhole import fit_similarity
from zeroshop_steps.geometry.cameras.transforms import transform_camera
from zeroshop_steps.register.submodels.merge import ROUGH_MISS_PX, merge_models
from zeroshop_steps.register.submodels.outline_alignment import CameraGroup, find_hypotheses

VIEWS, WIDTH_PX, HEIGHT_PX = 16, 640, 480
HALF = range(VIEWS // 2)


def see(shape):
    """Cameras around a shape, and its outlines, which hide nothing: it is drawn face by face."""
    cameras = [ring_camera(index, VIEWS, 300.0, (15.0, 45.0), (0.0, 0.0, 0.0), 840.0, (WIDTH_PX, HEIGHT_PX)) for index in range(VIEWS)]
    masks = {}
    for camera in cameras:
        corners = np.rint(camera.project(shape.vertices)[0] - 0.5).astype(np.int32)
        drawn = np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8)
        for face in shape.faces:
            cv2.fillConvexPoly(drawn, cv2.convexHull(corners[face]), 1)
        masks[camera.name] = drawn > 0
    return cameras, masks


def moved_half(cameras):
    """The second half of the cameras in a frame of its own, and the similarity that leads back."""
    own_from_world = np.eye(4)
    own_from_world[:3, :3] = 0.7 * Rotation.from_euler("xyz", [20, -30, 75], degrees=True).as_matrix()
    own_from_world[:3, 3] = [30.0, -80.0, 200.0]
    return [transform_camera(camera, own_from_world) for camera in cameras[VIEWS // 2 :]], np.linalg.inv(own_from_world)


@pytest.fixture(scope="module")
def bottle():
    """A box with a handle on one side and a neck on another."""
    parts = [trimesh.creation.box((70, 40, 90)), trimesh.creation.box((20, 14, 50)), trimesh.creation.box((18, 18, 30))]
    parts[1].apply_translation((42, 5, 10))
    parts[2].apply_translation((-15, -6, 55))
    return see(trimesh.util.concatenate(parts))


def find(cameras, masks):
    own, back = moved_half(cameras)
    return find_hypotheses(CameraGroup([cameras[index] for index in HALF], masks), CameraGroup(own, masks)), own, back


def test_two_halves_find_each_other(bottle):
    hypotheses, own, back = find(*bottle)
    centres = np.array([camera.centre_in_world for camera in own])
    found = centres @ hypotheses[0].target_from_source[:3, :3].T + hypotheses[0].target_from_source[:3, 3]
    errors = np.linalg.norm(found - (centres @ back[:3, :3].T + back[:3, 3]), axis=1)
    assert errors.mean() < 10.0, errors  # of 300 away; adjusting all cameras together does the rest
    assert hypotheses[0].miss_px < ROUGH_MISS_PX
    assert all(other.miss_px > 2 * hypotheses[0].miss_px for other in hypotheses[1:]), "each way is named once"


def test_what_looks_alike_from_all_sides_stays_open():
    hypotheses, _, _ = find(*see(trimesh.creation.cylinder(30, 80, sections=64)))
    assert hypotheses == []


def test_merged_models_are_the_whole_again(tmp_path):
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_frames_per_rig, options.num_points3D = 1, 10, 60
    pycolmap.set_random_seed(1)
    whole = pycolmap.synthesize_dataset(options)
    halves = [pycolmap.Reconstruction(whole) for _ in range(2)]
    ids = sorted(whole.reg_image_ids())
    for half, rest in zip(halves, (ids[5:], ids[:5]), strict=True):
        for image_id in rest:
            half.deregister_frame(half.images[image_id].frame_id)
    turn = Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_quat()
    halves[1].transform(pycolmap.Sim3d(2.0, pycolmap.Rotation3d(turn), np.array([1.0, -2.0, 3.0])))
    source, target = (np.array([model.images[image_id].projection_center() for image_id in ids[5:]]) for model in (halves[1], whole))
    merged, added = merge_models(*halves, fit_similarity(source, target))
    assert added == {whole.images[image_id].name for image_id in ids[5:]} and merged.num_reg_images() == 10
    for image_id in ids:
        np.testing.assert_allclose(
            merged.images[image_id].cam_from_world().matrix(), whole.images[image_id].cam_from_world().matrix(), atol=1e-6
        )
    merged.update_point_3d_errors()
    assert merged.num_points3D() >= whole.num_points3D() and merged.compute_mean_reprojection_error() < 1e-3
