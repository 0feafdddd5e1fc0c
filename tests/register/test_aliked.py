"""Registration by learned features: its back end finds the true cameras from what perfect networks with noise would say."""

import numpy as np
import pytest

from helpers.made_scene import MadeScene, made_scene
from zeroshop_steps.geometry.cameras.pinhole import align_to_truth, pair_with_truth, read_sparse_model
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.register.aliked import AlikedOptions, match_images, register
from zeroshop_steps.register.pipeline import StructureOptions
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.register.scene.record import RegistrationFailed
from zeroshop_steps.runtime.errors import StepError

WIDTH_PX, HEIGHT_PX = 480, 360


class KnownFeatures:
    """Stands for networks.aliked.AlikedMatcher: points of the carton, seen where nothing hides them, within a tenth of a pixel."""

    def __init__(self, scene: MadeScene) -> None:
        rng = np.random.default_rng(0)
        points = []
        for camera, depth, mask in zip(scene.cameras, scene.depths, scene.masks, strict=True):
            rows, columns = np.nonzero(mask)
            picked = rng.choice(len(rows), 60, replace=False)
            pixels = np.stack([columns[picked] + 0.5, rows[picked] + 0.5, np.ones(60)], axis=1)
            local = pixels @ np.linalg.inv(camera.intrinsics).T * depth[rows[picked], columns[picked], None]
            points.append((local - camera.camera_from_world[:3, 3]) @ camera.camera_from_world[:3, :3])
        world = np.concatenate(points)
        self.keypoints, self.numbers = [], []
        for camera, depth in zip(scene.cameras, scene.depths, strict=True):
            rows, columns, away, seen = camera.find_pixels(world)
            seen &= np.abs(np.where(seen, depth[rows * seen, columns * seen], 0) - away) < 1.5
            self.numbers.append(np.flatnonzero(seen))
            self.keypoints.append(camera.project(world[seen])[0] + rng.normal(scale=0.1, size=(seen.sum(), 2)))

    def similarities(self) -> np.ndarray:
        return np.array([[float(len(np.intersect1d(one, other))) for other in self.numbers] for one in self.numbers])

    def match(self, first: int, second: int) -> tuple[np.ndarray, np.ndarray]:
        _, one, other = np.intersect1d(self.numbers[first], self.numbers[second], return_indices=True)
        return np.stack([one, other], axis=1), np.full(len(one), 0.95)


@pytest.fixture(scope="module")
def scene():
    elevations = [40.0 if number % 2 else 25.0 for number in range(12)]
    return made_scene([30.0 * number for number in range(12)], elevations, width_px=WIDTH_PX, height_px=HEIGHT_PX)


@pytest.mark.slow
def test_true_matches_with_noise_give_the_true_cameras(scene, tmp_path):
    (tmp_path / "cameras").mkdir()
    figures = register(scene.image_set(tmp_path), tmp_path / "cameras", AlikedOptions(), lambda crops: KnownFeatures(scene))
    assert figures["registered"] == 12 and figures["contradicting_pairs"] == [] and figures["strangers"] == []
    errors_mm = measure_errors_mm(scene, tmp_path / "cameras")
    assert errors_mm.mean() < 1.5, errors_mm
    assert len(list((tmp_path / "cameras/masks").iterdir())) == 12


class TwoHalves(KnownFeatures):
    """Nothing matches between the first six views and the others."""

    def match(self, first, second):
        numbers, scores = super().match(first, second)
        return (numbers, scores) if (first < 6) == (second < 6) else (numbers[:0], scores[:0])


def measure_errors_mm(scene, cameras):
    pairs = pair_with_truth(read_sparse_model(cameras / "sparse").cameras, tuple(scene.cameras))
    found = transform_points(np.array([camera.centre_in_world for camera, _ in pairs]), align_to_truth(pairs))
    return np.linalg.norm(found - [camera.centre_in_world for _, camera in pairs], axis=1)


@pytest.mark.slow
def test_two_halves_of_a_plain_carton_are_not_joined(scene, tmp_path):
    """It fits onto itself in two ways, and no print tells them apart."""
    (tmp_path / "cameras").mkdir()
    with pytest.raises(RegistrationFailed, match="6 of 12 images registered") as failure:
        register(scene.image_set(tmp_path), tmp_path / "cameras", AlikedOptions(), lambda crops: TwoHalves(scene))
    (tried,) = failure.value.figures["joining"]
    assert [way["verdict"] for way in tried["ways"]].count("same") + [way["verdict"] for way in tried["ways"]].count("open") >= 2


@pytest.mark.slow
def test_two_halves_of_a_printed_carton_are_joined(scene, tmp_path):
    """Though they are photos, of which some may be of something else."""
    (tmp_path / "cameras").mkdir()
    image_set = scene.image_set(tmp_path)
    scene.paint(tmp_path)
    options = AlikedOptions(structure=StructureOptions(leave_out=True))
    figures = register(image_set, tmp_path / "cameras", options, lambda crops: TwoHalves(scene))
    assert figures["registered"] == 12
    assert [way["verdict"] for way in figures["joining"][0]["ways"]].count("same") == 1
    assert figures["compared_neighbours"] == 0 and figures["compared_far_neighbours"] > 0 and figures["differing"] == []
    errors_mm = measure_errors_mm(scene, tmp_path / "cameras")
    assert errors_mm.mean() < 3.0, errors_mm


def test_whole_photos_are_refused(scene, tmp_path):
    image_set = scene.image_set(tmp_path)
    with pytest.raises(StepError, match="has no masks"):
        register(ImageSet(image_set.images, None, image_set.sizes_px), tmp_path, AlikedOptions(), lambda crops: None)


def test_a_pair_counts_by_its_sure_matches():
    class Said:
        keypoints = [np.zeros((30, 2))] * 3

        def similarities(self):
            return np.ones((3, 3))

        def match(self, first, second):
            numbers = np.stack([np.arange(30)] * 2, axis=1)
            return numbers, np.where(np.arange(30) < (15 if second == 1 else 14), 0.9, np.where(np.arange(30) < 25, 0.5, 0.3))

    found = match_images(Said(), AlikedOptions())
    assert set(found) == {(0, 1)} and len(found[0, 1][0]) == 25, "14 sure matches are too few; matches below 0.4 are left out"


def test_pictures_without_matches_are_a_failure_with_its_reason(scene, tmp_path):
    class Nothing(KnownFeatures):
        def match(self, first, second):
            return np.zeros((0, 2), int), np.zeros(0)

    (tmp_path / "cameras").mkdir()
    with pytest.raises(RegistrationFailed, match="no two images share enough features"):
        register(scene.image_set(tmp_path), tmp_path / "cameras", AlikedOptions(), lambda crops: Nothing(scene))
