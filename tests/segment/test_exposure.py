"""Photos of unequal exposure and white balance become equal; equal ones stay the same bytes."""

import shutil

import numpy as np
import pycolmap
import pytest

from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.cameras.sparse_files import write_reconstruction
from zeroshop_steps.geometry.imaging.images import list_images, read_depth_mm, read_image, write_image
from zeroshop_steps.geometry.imaging.srgb import linear_to_srgb, srgb_to_linear
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.files import read_json, write_json
from zeroshop_steps.segment.photometry.color_gains import GAIN_RANGE, estimate_gains
from zeroshop_steps.segment.photometry.exposure import apply_gain
from zeroshop_steps.segment.photometry.shared_colors import SharedColors

PHOTOS, POINTS = 12, 400


def observe(exposures, rng, noise=0.05, outliers=0.0, gloss=0.0):
    """What photos with (V, 3) logarithmic exposures show of points that five photos in a row share, all around."""
    color = rng.uniform(0.03, 0.6, (POINTS, 3))
    first = rng.integers(0, PHOTOS, POINTS)
    photo = (first[:, None] + np.arange(5)).ravel() % PHOTOS
    point = np.repeat(np.arange(POINTS), 5)
    light = color[point] * np.exp(noise * rng.standard_normal((len(point), 3)))
    light += gloss * (photo % 2)[:, None]
    wrong = rng.uniform(size=len(point)) < outliers
    light[wrong] += rng.uniform(0.2, 1.0, (wrong.sum(), 1))
    light *= np.exp(exposures[photo])
    return SharedColors(photo, point, point % 8, np.minimum(light, 1.0), light.max(1) > 0.96)


def error_of(exposures, **how):
    """The largest error of the logarithmic gains of photos with these exposures, and whether there is something to correct."""
    gains = estimate_gains(observe(exposures, np.random.default_rng(1), **how), PHOTOS)
    error = gains.log_gains + exposures
    return float(np.abs(error - np.median(error, 0)).max()), gains.significant


def drifting(seed=0):
    """(V, 3) logarithmic exposures of automatic exposure and white balance."""
    rng = np.random.default_rng(seed)
    return 0.2 * rng.standard_normal((PHOTOS, 1)) + 0.05 * rng.standard_normal((PHOTOS, 3))


def test_known_gains_are_found():
    error, significant = error_of(drifting())
    assert error < 0.02 and significant


def test_highlights_and_wrong_points_are_no_exposure():
    error, significant = error_of(drifting(), outliers=0.2)
    assert error < 0.03 and significant


def test_equal_photos_have_nothing_to_correct():
    for how in ({}, {"outliers": 0.2}, {"noise": 0.3}, {"gloss": 0.005}):
        assert not error_of(np.zeros((PHOTOS, 3)), **how)[1], how


def test_the_median_photo_keeps_its_colours():
    exposures = drifting()
    exposures[3] = 0.9
    gains = estimate_gains(observe(exposures, np.random.default_rng(1)), PHOTOS)
    assert np.abs(np.median(gains.log_gains, 0)).max() < 1e-12


def test_gains_are_bounded():
    exposures = np.zeros((PHOTOS, 3))
    exposures[3] = -2.0
    gains = estimate_gains(observe(exposures, np.random.default_rng(1)), PHOTOS)
    assert np.exp(gains.log_gains).max() <= GAIN_RANGE[1] * (1 + 1e-9)


def test_a_photo_that_shares_nothing_stays_as_it_is():
    seen = observe(drifting(), np.random.default_rng(1))
    keep = seen.photo != 3
    alone = SharedColors(*(values[keep] for values in (seen.photo, seen.point, seen.part, seen.light, seen.clipped)))
    gains = estimate_gains(alone, PHOTOS)
    assert np.abs(gains.log_gains[3] - gains.log_gains.mean(0)).max() < 0.1


def test_what_only_one_part_of_the_scene_shows_is_no_exposure():
    """A side of the object that lies in shadow as one photo sees it: its points differ alike, all others do not."""
    seen = observe(np.zeros((PHOTOS, 3)), np.random.default_rng(1))
    shaded = (seen.photo == 3) & (seen.part < 4)
    light = np.where(shaded[:, None], 0.8 * seen.light, seen.light)
    assert not estimate_gains(SharedColors(seen.photo, seen.point, seen.part, light, seen.clipped), PHOTOS).significant


def test_without_shared_points_nothing_is_corrected():
    nothing = SharedColors(np.arange(3), np.arange(3), np.arange(3), np.full((3, 3), 0.5), np.zeros(3, bool))
    gains = estimate_gains(nothing, 3)
    assert not gains.significant and not gains.log_gains.any()


def test_a_gain_multiplies_linear_light():
    image = np.random.default_rng(0).integers(0, 256, (8, 9, 3), dtype=np.uint8)
    gain = np.array([0.7, 1.0, 1.4])
    expected = linear_to_srgb(np.minimum(srgb_to_linear(image / 255.0) * gain, 1.0)) * 255
    assert np.abs(apply_gain(image, gain) - expected).max() <= 0.5 + 1e-9
    assert np.array_equal(apply_gain(image, np.ones(3)), image)


@pytest.fixture
def cameras(carton_scene, tmp_path):
    """A cameras folder whose sparse points have tracks, as a registration writes them."""
    views, model = carton_scene
    return write_scene(tmp_path / "scene", views, model.points)


def write_scene(folder, views: list[View], points: np.ndarray):
    """Images, masks and a model in which each view sees the points that nothing hides from it."""
    for part in ("images", "masks"):
        (folder / part).mkdir(parents=True)
    model = pycolmap.Reconstruction()
    tracks = [pycolmap.Track() for _ in points]
    for number, view in enumerate(views, 1):
        shutil.copy(view.image_path, folder / "images")
        shutil.copy(view.mask_path, folder / "masks")
        camera, size = view.camera, (view.camera.width_px, view.camera.height_px)
        pinhole = pycolmap.Camera(model="PINHOLE", width=size[0], height=size[1], params=camera.pinhole_params, camera_id=number)
        model.add_camera_with_trivial_rig(pinhole)
        pixels, depth = camera.project(points)
        inside = np.flatnonzero((depth > 0) & ((pixels > 2) & (pixels < np.array(size) - 2)).all(1))
        x, y = pixels[inside].astype(int).T
        hit = read_depth_mm(view.image_path.parents[1] / "depth" / camera.name)[y, x]
        inside = inside[np.abs(hit - depth[inside]) < 0.01 * depth[inside]]
        image = pycolmap.Image(name=camera.name, keypoints=pixels[inside], camera_id=number, image_id=number)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(camera.camera_from_world[:3]))
        for place, point in enumerate(inside):
            tracks[point].add_element(number, place)
    for number, (point, track) in enumerate(zip(points, tracks, strict=True), 1):
        model.add_point3D_with_id(number, pycolmap.Point3D(xyz=point, track=track))
        for element in track.elements:
            model.images[element.image_id].set_point3D_for_point2D(element.point2D_idx, number)
    write_reconstruction(model, folder / "sparse")
    write_json(folder / "registration.json", {"status": "ok", "images": len(views), "registered": len(views)})
    return folder


def segment(scene):
    words = ["--method", "user_masks", "--scene", scene, "--rejected", scene.parent / "masks.png", "--out", scene.parent / "cameras"]
    assert stage_main("zeroshop_steps.segment", list(map(str, words))) == 0
    return scene.parent / "cameras"


def test_equal_photos_stay_the_same_bytes(cameras):
    out = segment(cameras)
    record = read_json(out / "exposure.json")
    assert record["corrected"] is False and len(record["photos"]) == 20
    for path in list_images(out / "images"):
        assert path.read_bytes() == (cameras / "images" / path.name).read_bytes()


def test_drifting_photos_become_equal_and_the_scene_keeps_its_own(cameras, carton_scene, capsys):
    exposures = 0.15 * np.random.default_rng(0).standard_normal((20, 3))
    exposures[4] += 0.8
    for view, exposure in zip(carton_scene[0], exposures, strict=True):
        write_image(cameras / "images" / view.camera.name, apply_gain(view.image(), np.exp(exposure)))
    before = {path.name: path.read_bytes() for path in list_images(cameras / "images")}
    out = segment(cameras)
    assert read_json(out / "exposure.json")["corrected"] is True
    assert "far from that of the other photos in 000004.png" in capsys.readouterr().err
    left = []
    for view in carton_scene[0]:
        plain = (view.image().min(2) > 60) & (view.image().max(2) < 130)  # lost nothing to clipping, and little to rounding
        ours, own = (srgb_to_linear(image[plain] / 255.0) for image in (read_image(out / "images" / view.camera.name), view.image()))
        left.append(np.log(ours.mean(0) / own.mean(0)))
    assert np.abs(left - np.median(left, 0)).max() < 0.06 and np.abs(np.median(left, 0) - np.median(exposures, 0)).max() < 0.04
    assert {path.name: path.read_bytes() for path in list_images(cameras / "images")} == before
    assert len(read_sparse_model(out / "sparse").cameras) == 20
