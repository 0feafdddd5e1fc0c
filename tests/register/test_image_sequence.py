"""A tin whose print is there twice: photos that follow one another tell its sides apart, whatever else matches."""

import shutil
from itertools import combinations

import numpy as np
import pycolmap
import pytest

from helpers.camera_ring import ring_camera
from zeroshop_steps.geometry.cameras.pinhole import fit_similarity, take_cameras, to_rigid
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.register import colmap
from zeroshop_steps.register.image_sequence import are_in_order, check_order, keep_sequence
from zeroshop_steps.register.mapping.mapper import make_mapping_options, map_incrementally
from zeroshop_steps.register.matching.turntable import StationaryMatches
from zeroshop_steps.register.matching.view_graph import ViewGraph
from zeroshop_steps.register.scene.database import LEAST_TIES, read_matches
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.register.scene.record import DuplicateStructure, Inconsistent
from zeroshop_steps.register.verification.epipolar_support import count_epipolar_support

COUNT, SIZE_PX, FOCAL_PX, RADIUS, REPEATS = 24, (640, 480), 700.0, 40.0, 2
PRINT = 300  # points of each repeat
LENS = pycolmap.Camera(model="SIMPLE_PINHOLE", width=SIZE_PX[0], height=SIZE_PX[1], params=[FOCAL_PX, 320.0, 240.0], camera_id=1)


@pytest.fixture(scope="module")
def cameras():
    return [ring_camera(number, COUNT, 250.0, (20.0, 30.0), (0, 0, 0), FOCAL_PX, SIZE_PX) for number in range(COUNT)]


def write_database(path, cameras):
    """Keypoints of what each camera sees of the tin, and matches of equal print: verified where most of them agree, as COLMAP does."""
    rng = np.random.default_rng(0)
    turns = rng.uniform(0, 2 * np.pi / REPEATS, PRINT)
    turns = np.concatenate([turns + 2 * np.pi * repeat / REPEATS for repeat in range(REPEATS)])
    heights, normals = np.tile(rng.uniform(-50, 50, PRINT), REPEATS), np.column_stack([np.cos(turns), np.sin(turns), np.zeros_like(turns)])
    points = RADIUS * normals + heights[:, None] * [0, 0, 1]
    shown = []
    with pycolmap.Database.open(path) as opened:
        opened.write_camera(LENS, use_camera_id=True)
        for number, camera in enumerate(cameras):
            ways = camera.centre_in_world - points
            seen = np.flatnonzero((ways * normals).sum(1) > 0.35 * np.linalg.norm(ways, axis=1))
            places = camera.project(points[seen])[0] + rng.normal(0, 0.3, (len(seen), 2))
            opened.write_image(pycolmap.Image(name=f"{number:06d}.png", camera_id=1, image_id=number + 1), use_image_id=True)
            opened.write_keypoints(number + 1, places.astype(np.float32))
            shown.append(seen)
        for one, other in combinations(range(len(cameras)), 2):
            offset = max(range(REPEATS), key=lambda turn: len(_match(shown[one], shown[other], turn)))
            pairs = _match(shown[one], shown[other], offset)
            if len(pairs) >= LEAST_TIES / 2:
                geometry = pycolmap.TwoViewGeometry()
                geometry.config, geometry.inlier_matches = pycolmap.TwoViewGeometryConfiguration.UNCALIBRATED, pairs
                opened.write_matches(one + 1, other + 1, pairs)
                opened.write_two_view_geometry(one + 1, other + 1, geometry)
    return path


def _match(one, other, turn):
    """(M, 2) numbers of the keypoints that show the same print, so many repeats apart."""
    _, first, second = np.intersect1d(one, (other + turn * PRINT) % (REPEATS * PRINT), return_indices=True)
    return np.column_stack([first, second]).astype(np.uint32)


@pytest.fixture(scope="module")
def database(cameras, tmp_path_factory):
    return write_database(tmp_path_factory.mktemp("tin") / "database.db", cameras)


def test_images_are_in_order_by_what_they_match(database, cameras, tmp_path):
    mixed = [cameras[place] for place in np.random.default_rng(1).permutation(COUNT)]
    assert are_in_order(database) and not are_in_order(write_database(tmp_path / "mixed.db", mixed))


@pytest.mark.parametrize("repeat", [1, REPEATS])
def test_a_folded_model_contradicts_the_order(database, cameras, repeat):
    """`repeat`: how often the cameras turn as far as they should."""
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(LENS)
    for number in range(COUNT):
        pose = to_rigid(cameras[number % (COUNT // repeat)].camera_from_world)
        model.add_image_with_trivial_frame(pycolmap.Image(name=f"{number:06d}.png", camera_id=1, image_id=number + 1), pose)
    (finding,) = check_order(count_epipolar_support(model, database)).findings
    assert (finding.strength > 1) == (repeat > 1)
    assert finding.strength < 0.1 or "000011.png and 000012.png" in finding.found


def test_pairs_that_agree_with_the_order_unfold_the_circle(database, cameras, tmp_path):
    options = make_mapping_options(8, 0)
    kept = keep_sequence(database, tmp_path / "copy.db", tmp_path, options)
    steps = np.array([abs(int(one[:6]) - int(other[:6])) for one, other in kept])
    assert (np.minimum(steps, COUNT - steps) <= COUNT // 4).all() and (steps > COUNT // 2).any()  # the end of the circle meets its start
    with pycolmap.Database.open(database) as opened:
        assert len(kept) < 0.7 * len(read_matches(opened))
    found = take_cameras(map_incrementally(tmp_path / "copy.db", tmp_path, tmp_path / "models", options))
    places = np.array([camera.centre_in_world for camera in found])
    true = np.array([cameras[int(camera.name[:6])].centre_in_world for camera in found])
    assert len(found) == COUNT
    assert np.linalg.norm(transform_points(places, fit_similarity(places, true)) - true, axis=1).max() < 2.0


@pytest.mark.parametrize("kind", [DuplicateStructure, Inconsistent])
def test_the_order_is_asked_where_sides_were_merged(database, tmp_path, monkeypatch, kind):
    image_set = ImageSet(tuple(tmp_path / f"{number:06d}.png" for number in range(COUNT)), None, (SIZE_PX,) * COUNT)

    def match(path, *_):
        shutil.copy(database, path)
        return ViewGraph(300.0, 0, "given", 0, StationaryMatches(0.0, 0.0, 0.0), False)

    def reconstruct(images, out, path, options, record, match, all_matches=None):
        graph = match(path, images, options, record.stopwatch)
        if all_matches is None:
            raise record.fail("folded", kind=kind)
        return record.add(registered=COUNT, left=len(graph.pairs))

    monkeypatch.setattr(colmap, "match_and_reconstruct", reconstruct)
    if kind is Inconsistent:
        with pytest.raises(Inconsistent, match="^folded$"):
            colmap.register(image_set, tmp_path, colmap.ColmapOptions(), match)
    else:
        record = colmap.register(image_set, tmp_path, colmap.ColmapOptions(), match)
        assert record["tried"]["colmap"]["reason"] == "folded" and record["left"] < COUNT * (COUNT - 1) / 2
