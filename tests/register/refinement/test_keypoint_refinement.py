"""Observations are aligned by the pictures, and cameras follow them."""

import cv2
import numpy as np
import pycolmap
import pytest

from helpers.carton_scene import SIZE_MM, finely_printed, photographed_carton
from zeroshop_steps.evaluate.camera_error import compare_cameras
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.register.refinement.keypoint_refinement import LEAST_ALIGNED, align_patch, choose_tracks, refine_keypoints

NOISE_PX = 0.7


@pytest.fixture(scope="module")
def carton(tmp_path_factory):
    """The carton's photos, with finer print, by true cameras; points on its sides and top, and their normals."""
    folder = photographed_carton(tmp_path_factory.mktemp("carton"), finely_printed).cameras
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.42, 0.42, (300, 3)) * SIZE_MM
    normals = np.zeros((300, 3))
    axis = rng.integers(0, 3, 300)
    side = np.where(axis == 2, 1.0, rng.choice([-1.0, 1.0], 300))
    points[np.arange(300), axis] = side * SIZE_MM[axis] / 2
    normals[np.arange(300), axis] = side
    return folder, points, normals


def noisy_model(carton, folder):
    """A model of features that were found half a pixel off or so, its cameras adjusted to them."""
    cameras_folder, points, normals = carton
    cameras = read_sparse_model(cameras_folder / "sparse").cameras
    rng = np.random.default_rng(5)
    seen = np.array([((camera.centre_in_world - points) * normals).sum(1) > 40.0 for camera in cameras])
    pixels = np.array([camera.project(points)[0] for camera in cameras])
    noisy = pixels + rng.normal(0, NOISE_PX, pixels.shape)
    model = pycolmap.Reconstruction()
    first = cameras[0]
    lens = pycolmap.Camera(model="SIMPLE_PINHOLE", width=first.width_px, height=first.height_px, params=[420.0, 160.0, 120.0], camera_id=1)
    model.add_camera_with_trivial_rig(lens)
    for index, camera in enumerate(cameras):
        image = pycolmap.Image(name=camera.name, keypoints=noisy[index], camera_id=1, image_id=index + 1)
        pose = camera.camera_from_world
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:3, :3]), pose[:3, 3]))
    for number in np.flatnonzero(seen.sum(0) >= 2):
        track = pycolmap.Track()
        for index in np.flatnonzero(seen[:, number]):
            track.add_element(int(index) + 1, int(number))
        model.add_point3D(points[number], track, np.zeros(3, np.uint8))
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    pycolmap.bundle_adjustment(model, options)
    model.update_point_3d_errors()
    return model, {camera.name: cameras_folder / "images" / camera.name for camera in cameras}, cameras


def found_cameras(model, folder):
    folder.mkdir()
    model.write_binary(str(folder))
    return read_sparse_model(folder).cameras


@pytest.fixture(scope="module")
def found(carton, tmp_path_factory):
    return noisy_model(carton, tmp_path_factory.mktemp("model"))


def test_sharpened_cameras_are_several_times_as_exact(found, tmp_path):
    model, images, truth = found
    poses = {image.name: image.cam_from_world().matrix().copy() for image in model.images.values()}
    sharpened, figures = refine_keypoints(model, images)
    before = compare_cameras(found_cameras(model, tmp_path / "before"), truth)
    after = compare_cameras(found_cameras(sharpened, tmp_path / "after"), truth)
    assert after.centre_mm.mean() < before.centre_mm.mean() / 3 and after.rotation_deg.mean() < before.rotation_deg.mean() / 3
    assert figures["points"] > 150 and figures["error_px"] < 0.25 < figures["error_before_px"]
    assert sharpened.num_points3D() == model.num_points3D(), "what cannot be aligned stays"
    assert all(np.array_equal(poses[image.name], image.cam_from_world().matrix()) for image in model.images.values())


def test_a_second_run_gives_the_same_bytes(found, tmp_path):
    model, images, _ = found
    files = []
    for name in ("one", "other"):
        found_cameras(refine_keypoints(model, images)[0], tmp_path / name)
        files.append([(tmp_path / name / part).read_bytes() for part in ("cameras.bin", "images.bin", "points3D.bin")])
    assert files[0] == files[1]


def test_pictures_without_print_leave_the_model_as_it_was(found, tmp_path):
    model, images, _ = found
    for name in images:
        write_image(tmp_path / name, np.full((240, 320, 3), 128, np.uint8))
    same, figures = refine_keypoints(model, {name: tmp_path / name for name in images})
    assert figures == {"points": 0} and same.num_points3D() == model.num_points3D() > LEAST_ALIGNED
    assert all(np.array_equal(same.points3D[number].xyz, point.xyz) for number, point in model.points3D.items())


def test_each_image_gets_its_share_of_the_longest_tracks(found):
    model = found[0]
    chosen = choose_tracks(model, 20)
    lengths = {number: point.track.length() for number, point in model.points3D.items()}
    counts = dict.fromkeys(model.reg_image_ids(), 0)
    for number in chosen:
        for element in model.points3D[number].track.elements:
            counts[element.image_id] += 1
    assert min(counts.values()) >= 20 and len(chosen) < len(lengths)
    assert [lengths[number] for number in chosen] == sorted((lengths[number] for number in chosen), reverse=True)


@pytest.mark.parametrize(("moved_px", "found_it"), [((1.3, -0.8), True), ((0.0, 0.0), True), ((5.0, 0.0), False)])
def test_a_patch_is_found_where_it_was_moved_to(moved_px, found_it):
    rng = np.random.default_rng(2)
    around = cv2.GaussianBlur(rng.uniform(0, 255, (33, 33)).astype(np.float32), (0, 0), 2.0)
    corner = np.float32([[1, 0, 6 + moved_px[0]], [0, 1, 6 + moved_px[1]]])
    template = cv2.warpAffine(around, corner, (21, 21), flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP)
    shift = align_patch(0.7 * template + 20.0, around)  # other light
    assert (shift is not None) == found_it
    if found_it:
        assert np.allclose(shift, moved_px, atol=0.1)


def test_a_patch_of_something_else_is_not_aligned():
    rng = np.random.default_rng(4)
    template, around = (cv2.GaussianBlur(rng.uniform(0, 255, (side, side)).astype(np.float32), (0, 0), 2.0) for side in (21, 33))
    assert align_patch(template, around) is None
