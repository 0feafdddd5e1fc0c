"""Height by MASt3R: the true scale comes back from what a perfect network with noise would say."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from helpers.made_pairs import MadePairs, Noise
from helpers.made_scene import SIZE_MM, made_scene
from zeroshop_steps.geometry.cameras.pinhole import Camera, read_sparse_model, write_cameras
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.height.mast3r import choose_object_views, measure_scale
from zeroshop_steps.networks.mast3r import global_alignment
from zeroshop_steps.networks.mast3r.global_alignment import align_images
from zeroshop_steps.runtime.errors import StepError

UNITS_A_MM = 0.0137
"""Of the registration, whose scale is arbitrary."""
EMPTY = [Path("empty") / f"{number}.png" for number in range(3)]


@dataclass(frozen=True)
class Measured:
    """As much of height.record.RegisteredObject as the method reads."""

    views: list[View]
    cameras: Path


@pytest.fixture(scope="module", autouse=True)
def fewer_steps():
    """As few pictures as these are aligned in a third of the steps."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(global_alignment, "COARSE_STEPS", global_alignment.COARSE_STEPS // 3)
        patch.setattr(global_alignment, "FINE_STEPS", global_alignment.FINE_STEPS // 3)
        yield


@pytest.fixture(scope="module")
def scenes():
    """Six views of the carton and three of its empty ground."""
    return made_scene([0, 36, 72, 108, 144, 180], [25, 40, 25, 40, 25, 40]), made_scene([20, 110, 200], [35, 45, 35], False)


@pytest.fixture(scope="module")
def registered(scenes, tmp_path_factory):
    """A registration of the carton's views in its own unit, with points that the views show."""
    folder = tmp_path_factory.mktemp("registered")
    cameras = [_in_units(camera) for camera in scenes[0].cameras]
    write_cameras(folder / "sparse", cameras)
    model = pycolmap.Reconstruction(str(folder / "sparse"))
    rng = np.random.default_rng(0)
    for camera, depth in zip(cameras, scenes[0].depths, strict=True):
        image = next(image for image in model.images.values() if image.name == camera.name)
        rows, columns = (rng.integers(3, side - 3, 150) for side in depth.shape)
        pixels = np.stack([columns, rows], axis=1) + 0.5
        along = depth[rows, columns] * UNITS_A_MM
        known = along > 0
        k, pose = camera.intrinsics, camera.camera_from_world
        rays = np.concatenate([(pixels - k[:2, 2]) / k[0, 0], np.ones((150, 1))], axis=1)
        points = (rays * along[:, None] - pose[:3, 3]) @ pose[:3, :3]
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(pixel) for pixel in pixels])
        for number in np.flatnonzero(known):
            model.add_point3D(points[number], pycolmap.Track([pycolmap.TrackElement(image.image_id, int(number))]), np.zeros(3, np.uint8))
    model.write_binary(str(folder / "sparse"))
    views = [View(camera, folder / camera.name, None) for camera in read_sparse_model(folder / "sparse").cameras]
    return Measured(views, folder)


def _in_units(camera: Camera) -> Camera:
    pose = camera.camera_from_world.copy()
    pose[:3, 3] *= UNITS_A_MM
    return Camera(camera.name, camera.width_px, camera.height_px, camera.intrinsics, pose)


def made(scenes, noise, width_px):
    """The network for photos of both scenes, by their names."""
    views = {camera.name: (camera, depth) for camera, depth in zip(scenes[0].cameras, scenes[0].depths, strict=True)}
    empty = list(zip(scenes[1].cameras, scenes[1].depths, strict=True))

    def predictor(paths):
        chosen = [views[path.name] for path in paths if path.parent.name != "empty"]
        chosen += empty[: sum(path.parent.name == "empty" for path in paths)]
        return MadePairs([camera for camera, _ in chosen], [depth for _, depth in chosen], 1e-3, noise, width_px)

    return predictor


@pytest.mark.slow
def test_the_true_height_comes_back(scenes, registered):
    noise, limit = Noise(feature=0.03, point=0.01, scale=0.02), 0.02
    scale = measure_scale(registered, EMPTY, made(scenes, noise, 128))
    height_m = SIZE_MM[2] * UNITS_A_MM * scale.metres_per_unit
    assert abs(height_m / (SIZE_MM[2] * 1e-3) - 1.0) < limit
    assert 0.08 <= scale.deviation < 0.1
    assert len(scale.evidence["object_photos"]) == 2 and len(scale.evidence["scene_photos"]) == 3
    assert abs(scale.evidence["metres_per_unit_by_camera_distance"] / scale.metres_per_unit - 1.0) < 5 * limit


@pytest.mark.slow
def test_the_alignment_finds_the_true_cameras(scenes, monkeypatch):
    """From a start that is off by some 4 cm, 3 degrees and 3 % of the size: what one perfect pair after the other says is right at once."""
    rng, chain = np.random.default_rng(0), global_alignment._chain_pairs

    def shaken(*given):
        start = chain(*given)
        shake = np.tile(np.eye(4), (len(start), 1, 1))
        for pose in shake[1:]:
            pose[:3, :3] = np.exp(rng.normal(scale=0.03)) * Rotation.from_rotvec(rng.normal(scale=0.03, size=3)).as_matrix()
            pose[:3, 3] = rng.normal(scale=0.025, size=3)
        return start @ shake

    monkeypatch.setattr(global_alignment, "_chain_pairs", shaken)
    views = [view for scene in scenes for view in list(zip(scene.cameras, scene.depths, strict=True))[:2]]
    cameras = [camera for camera, _ in views]
    alignment = align_images(MadePairs(cameras, [depth for _, depth in views], 1e-3, Noise(), 192), 1.0)
    first = cameras[0].camera_from_world
    for number, camera in enumerate(cameras):
        true = first @ np.linalg.inv(camera.camera_from_world)
        found = alignment.world_from_camera[number]
        assert np.linalg.norm(found[:3, 3] * 1000 - true[:3, 3]) < 7.0, "mm, of 700 mm"
        assert np.degrees(np.arccos(np.clip((np.trace(found[:3, :3].T @ true[:3, :3]) - 1) / 2, -1, 1))) < 0.5
        assert abs(alignment.focal_px[number] / camera.intrinsics[0, 0] - 1.0) < 0.01
    assert alignment.error_px < 1.5, "matches are whole pixels, in pictures 192 px wide"


@pytest.mark.slow
def test_photos_of_another_place_are_refused(scenes, registered):
    nothing = [np.zeros_like(depth) for depth in scenes[1].depths]
    elsewhere = (scenes[0], type(scenes[1])(scenes[1].cameras, nothing, scenes[1].masks))
    with pytest.raises(StepError, match=r"pictures 2, 3, 4 .* match none of the others"):
        measure_scale(registered, EMPTY, made(elsewhere, Noise(), 128))


def test_views_are_taken_a_little_apart(registered):
    names = [view.camera.name for view in choose_object_views(registered.views, 2)]
    assert names[0] == "000000.png" and names[1] in ("000001.png", "000002.png")
    assert len(choose_object_views(registered.views, 6)) == len(choose_object_views(registered.views, 9)) == 6
