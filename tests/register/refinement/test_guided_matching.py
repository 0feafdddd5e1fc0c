"""Corners are found where the visual hull leads to, and bring cameras back that outlines alone leave a little off."""

from dataclasses import replace

import cv2
import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from helpers.carton_scene import finely_printed, photographed_carton
from zeroshop_steps.evaluate.camera_error import compare_cameras
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model, to_rigid
from zeroshop_steps.geometry.imaging.images import read_image, read_mask, write_image
from zeroshop_steps.register.refinement.guided_matching import adjust_by_guided_tracks, match_along_hull
from zeroshop_steps.register.scene.image_set import read_image_set
from zeroshop_steps.register.silhouettes.bundle_adjustment import SilhouetteAdjustment
from zeroshop_steps.register.silhouettes.model_adjustment import read_tracks
from zeroshop_steps.register.silhouettes.state import NO_TRACKS


@pytest.fixture(scope="module")
def carton(tmp_path_factory):
    """The folder of a printed carton's photos, and its true cameras."""
    folder = photographed_carton(tmp_path_factory.mktemp("carton"), finely_printed).cameras
    return folder, read_sparse_model(folder / "sparse").cameras


def shaken(cameras, degrees):
    """The cameras turned about the object at random."""
    rng = np.random.default_rng(4)
    poses = [camera.camera_from_world.copy() for camera in cameras]
    for pose in poses:
        pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(np.radians(rng.normal(scale=degrees, size=3))).as_matrix()
    return [replace(camera, camera_from_world=pose) for camera, pose in zip(cameras, poses, strict=True)]


def make_model(cameras):
    """A COLMAP model of cameras alone, as outlines give it."""
    model = pycolmap.Reconstruction()
    first = cameras[0]
    params = [first.intrinsics[0, 0], *first.intrinsics[:2, 2]]
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(model="SIMPLE_PINHOLE", width=first.width_px, height=first.height_px, params=params, camera_id=1)
    )
    for number, camera in enumerate(cameras, 1):
        image = pycolmap.Image(name=camera.name, camera_id=1, image_id=number)
        model.add_image_with_trivial_frame(image, to_rigid(camera.camera_from_world))
    return model


def read_cameras(model, cameras):
    """The cameras of a model, as pinhole cameras."""
    placed = {image.name: image for image in model.images.values()}
    poses = [np.vstack([placed[camera.name].cam_from_world().matrix(), [0, 0, 0, 1]]) for camera in cameras]
    return [replace(camera, camera_from_world=pose) for camera, pose in zip(cameras, poses, strict=True)]


def read_pictures(folder, cameras):
    """Grey photos, in the order of the cameras, and masks by image name."""
    greys = [cv2.cvtColor(read_image(folder / "images" / camera.name), cv2.COLOR_RGB2GRAY) for camera in cameras]
    return greys, {camera.name: read_mask(folder / "masks" / camera.name) for camera in cameras}


def test_corners_are_found_where_true_cameras_see_them(carton):
    folder, cameras = carton
    greys, masks = read_pictures(folder, cameras)
    tracks = match_along_hull(shaken(cameras, 0.7), masks, greys, 12)
    assert tracks.count > 200 and (np.bincount(tracks.point) >= 2).all() and len(set(tracks.view.tolist())) == len(cameras)
    assert SilhouetteAdjustment(cameras, masks, tracks).measure_error_px() < 0.6  # 0.2 of 320 px: points where true rays nearly meet


def test_pictures_bring_cameras_back_that_outlines_leave_off(carton):
    folder, cameras = carton
    wrong = shaken(cameras, 0.7)
    _, masks = read_pictures(folder, cameras)
    by_outlines = SilhouetteAdjustment(wrong, masks, NO_TRACKS)
    by_outlines.adjust()
    outlined = by_outlines.adjusted_cameras()
    model, figures = adjust_by_guided_tracks(make_model(outlined), read_image_set(folder))
    before_mm, after_mm = (compare_cameras(found, cameras).centre_mm.mean() for found in (outlined, read_cameras(model, cameras)))
    assert after_mm < 0.7 * before_mm
    assert figures["tracks"] >= model.num_points3D() > 200
    assert max(point.error for point in model.points3D.values()) < 4.0
    assert any(point.color.any() for point in model.points3D.values())
    ids, tracks = read_tracks(model, read_cameras(model, cameras))
    assert len(ids) == tracks.count and len(tracks.view) == sum(
        len(image.get_observation_point2D_idxs()) for image in model.images.values()
    )


def test_an_object_without_print_stays_as_outlines_placed_it(carton, tmp_path):
    folder, cameras = carton
    capture = tmp_path / "capture"
    for camera in cameras:
        grey = np.full((camera.height_px, camera.width_px, 3), 200, np.uint8)
        grey[:20, :20] = 10 * int(camera.name[:6])  # beside the object: photos that are all alike are refused
        write_image(capture / "images" / camera.name, grey)
    (capture / "masks").symlink_to(folder / "masks")
    given = make_model(cameras)
    model, figures = adjust_by_guided_tracks(given, read_image_set(capture))
    assert model is given and figures == {"tracks": 0, "observations": 0}
