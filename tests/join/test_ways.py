"""Ways in which one pass may lie to another, from matched points with known answers."""

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.pinhole import to_rigid
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.geometry.cameras.viewpoints import look_at
from zeroshop_steps.join.object_matches import PointPairs
from zeroshop_steps.join.pass_refinement import refine
from zeroshop_steps.join.ways import Way, find_ways_by_matches


def make_similarity(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    similarity = np.eye(4)
    similarity[:3, :3] = rng.uniform(0.5, 2.0) * Rotation.random(random_state=seed).as_matrix()
    similarity[:3, 3] = rng.uniform(-100, 100, 3)
    return similarity


def pair(target: np.ndarray, source: np.ndarray) -> PointPairs:
    ids = np.arange(1, len(target) + 1)
    return PointPairs(target, source, ids, ids, 9)


@pytest.mark.parametrize("seed", range(3))
def test_a_way_is_found_among_wrong_matches(seed):
    rng = np.random.default_rng(seed)
    source, way = rng.uniform(-50, 50, (120, 3)), make_similarity(seed)
    target = transform_points(source, way)
    target[:60] = rng.permutation(target[:60])
    found = find_ways_by_matches(pair(target, source), 0)
    assert len(found) == 1 and found[0].pairs >= 60
    assert np.allclose(found[0].target_from_source, way, atol=0.02 * np.abs(way).max())


def test_print_on_two_sides_supports_two_ways():
    rng = np.random.default_rng(1)
    source = rng.uniform(-50, 50, (100, 3))
    half_turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    target = np.concatenate([source[:60], transform_points(source[60:], half_turn)])
    first, second = find_ways_by_matches(pair(target, source), 0)
    assert first.pairs == 60 and second.pairs == 40
    assert np.allclose(first.target_from_source, np.eye(4), atol=1e-6)
    assert np.allclose(second.target_from_source, half_turn, atol=1e-6)


def test_too_few_matches_and_points_on_a_line_support_none():
    rng = np.random.default_rng(2)
    assert not find_ways_by_matches(pair(rng.normal(size=(5, 3)), rng.normal(size=(5, 3))), 0)
    line = rng.uniform(-50, 50, (40, 1)) * [1.0, 0.2, 0.1] + rng.normal(0, 0.01, (40, 3))
    assert not find_ways_by_matches(pair(line, line), 0)


def make_model(points: np.ndarray, seed: int) -> pycolmap.Reconstruction:
    """Six pinhole cameras around points, which all of them see, 0.3 px off."""
    rng = np.random.default_rng(seed)
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(pycolmap.Camera(model="PINHOLE", width=1000, height=750, params=[1200, 1200, 500, 375], camera_id=1))
    centre, reach = points.mean(0), 4 * np.linalg.norm(points.std(0))
    for index in range(6):
        angle = 2 * np.pi * index / 6
        pose = look_at(centre + reach * np.array([np.cos(angle), np.sin(angle), 0.5]), centre)
        inside = transform_points(points, pose)
        pixels = inside[:, :2] / inside[:, 2:] * 1200 + [500, 375] + rng.normal(0, 0.3, (len(points), 2))
        image = pycolmap.Image(name=f"{index}.png", keypoints=pixels, camera_id=1, image_id=index + 1)
        model.add_image_with_trivial_frame(image, to_rigid(pose))
    for number, point in enumerate(points):
        track = pycolmap.Track()
        for index in range(6):
            track.add_element(index + 1, number)
        model.add_point3D(point, track)
    return model


def test_refining_by_reprojection_beats_distances():
    rng = np.random.default_rng(4)
    source, way = rng.uniform(-50, 50, (60, 3)), make_similarity(4)
    target = transform_points(source, way)
    models = make_model(target, 5), make_model(source, 6)
    wrong = rng.permutation(12)
    noisy = target + rng.normal(0, 0.5, target.shape)
    noisy[:12] = noisy[wrong]
    pairs = PointPairs(noisy, source, np.array(sorted(models[0].point3D_ids())), np.array(sorted(models[1].point3D_ids())), 9)
    [rough] = find_ways_by_matches(pairs, 0)
    exact = PointPairs(target, source, pairs.target_ids, pairs.source_ids, 9)
    refined = refine(Way(rough.target_from_source, rough.pairs), exact, *models)

    def error(found: np.ndarray) -> float:
        return float(np.linalg.norm(transform_points(source, found) - target, axis=1).max())

    assert error(refined.target_from_source) < 0.3 * error(rough.target_from_source)
    assert error(refined.target_from_source) < 0.002 * np.ptp(target)
