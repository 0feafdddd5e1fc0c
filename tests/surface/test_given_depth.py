"""Depth images as measurements of the surface: their noise, their scale, what is wrong with them, and joined with stereo."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest

from helpers.ball import RADIUS, ball_views
from helpers.cup import camera_above, depth_of_cup
from helpers.shaded_vessel import HEIGHT_MM, RADIUS_MM, WALL_MM, matt, mug, photograph
from zeroshop_steps.geometry.cameras.object_crops import ObjectSphere
from zeroshop_steps.geometry.cameras.pinhole import SparseModel, to_rigid
from zeroshop_steps.geometry.cameras.registered_views import View, read_views
from zeroshop_steps.geometry.cameras.sparse_files import write_reconstruction
from zeroshop_steps.geometry.imaging.images import write_image, write_mask
from zeroshop_steps.geometry.observation.visual_hull import VisualHull
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.register.scene.depth_folder import DepthFolder
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json, write_json
from zeroshop_steps.surface.mvs.given_depth import GivenDepth, read_given_depth
from zeroshop_steps.surface.mvs.joined_depth import DEVIATION_MAX, STEREO_DEVIATION, combine, join_depths
from zeroshop_steps.surface.mvs.noise_models import NOISE
from zeroshop_steps.surface.mvs.seeds import read_confirmed_points

MM_A_UNIT = 150.0
WALL_BEHIND_MM = 900.0


def test_noise_grows_as_the_kind_of_camera_says() -> None:
    near, far, flat = np.array([300.0]), np.array([1200.0]), np.zeros(1)
    for kind, noise in NOISE.items():
        growth = noise.deviation_mm(far, flat, 640) / noise.deviation_mm(near, flat, 640)
        assert growth > 3 if kind in ("structured_light", "stereo") else 1 <= growth < 2, kind
        # At an edge of 50 mm between neighbours, the place of which is known to a pixel of the camera, all is possible.
        assert noise.deviation_mm(near, np.array([50.0]), 1000) > 20, kind
    at_half_a_metre = [float(NOISE[kind].deviation_mm(np.array([500.0]), flat, 640)[0]) for kind in ("structured_light", "tof", "lidar")]
    assert 0.5 < at_half_a_metre[0] < 1.5 < at_half_a_metre[1] < 5 < at_half_a_metre[2] < 20


def test_two_measurements_are_joined_by_their_inverse_variances() -> None:
    rng = np.random.default_rng(0)
    shape = (50, 60)
    deviations = rng.uniform(0.002, 0.01, (2, *shape)).astype(np.float32)
    first, second = (3.0 + rng.normal(0, deviations)).astype(np.float32)
    none = np.zeros(shape, int)
    depth, deviation, conflict = combine(first, deviations[0], second, deviations[1], none, none)
    agree = ~conflict
    assert agree.mean() > 0.98, "three deviations hold nearly all"
    w = deviations[:, agree] ** -2.0
    assert np.allclose(depth[agree], (w[0] * first[agree] + w[1] * second[agree]) / w.sum(0), atol=1e-5)
    assert np.allclose(deviation[agree], w.sum(0) ** -0.5, rtol=1e-4) and (deviation[agree] < deviations[:, agree].min(0)).all()
    assert np.std((depth - 3.0)[agree] / deviation[agree]) == pytest.approx(1.0, abs=0.05), "the stated deviation is the true one"
    assert not depth[conflict].any(), "of two that contradict each other and have no support, none stays"


def test_of_two_that_contradict_each_other_the_supported_one_stays() -> None:
    first, second = np.full((1, 4), 3.0, np.float32), np.array([[3.2, 3.2, 0.0, 3.001]], np.float32)
    deviation = np.full((1, 4), 0.003, np.float32)
    depth, _, conflict = combine(first, deviation, second, deviation, np.array([[4, 1, 0, 0]]), np.array([[2, 3, 0, 0]]))
    assert depth[0] == pytest.approx([3.0, 3.2, 3.0, 3.0005], abs=1e-5) and conflict.tolist() == [[True, True, False, False]]


def cup_views() -> tuple[list, list[np.ndarray], list[np.ndarray]]:
    """Cameras above a cup, its depth, and where each looks into its hollow."""
    cameras = [camera_above(azimuth) for azimuth in range(0, 360, 30)]
    truths = [depth_of_cup(camera) for camera in cameras]
    return cameras, truths, [(truth > 0) & (np.hypot(*np.mgrid[-60:60, -60:60]) < 12) for truth in truths]


def test_a_plain_hollow_that_depth_saw_is_measured_and_lies_are_dropped() -> None:
    cameras, truths, hollows = cup_views()
    rng = np.random.default_rng(0)
    stereo = [np.where(hollow, 0.0, truth).astype(np.float32) for truth, hollow in zip(truths, hollows, strict=True)]
    noise, depths = 0.006, []
    for index, (truth, hollow) in enumerate(zip(truths, hollows, strict=True)):
        seen = np.where(truth > 0, truth + rng.normal(0, noise, truth.shape), 0.0)
        seen[(rng.uniform(size=truth.shape) < 0.05) & (truth > 0)] -= 0.3  # flying pixels
        seen[hollow] -= 0.3 * (index == 0)  # a glossy floor: one view sees something above it
        depths.append(seen.astype(np.float32))
    deviations = [np.where(depth > 0, np.float32(noise), np.float32(0)) for depth in depths]
    joined = join_depths(cameras, stereo, GivenDepth(depths, deviations, {}))
    inside = [(depth > 0) & hollow for depth, hollow in zip(joined.depths, hollows, strict=True)]
    errors = np.concatenate([(d - t)[i] for d, t, i in zip(joined.depths, truths, inside, strict=True)])
    assert sum(map(np.sum, inside)) > 0.8 * sum(map(np.sum, hollows[1:])), "the hollow is there"
    assert np.abs(errors).max() < 0.1, "no flying pixel, and nothing above the floor"
    assert np.std(errors) < 0.7 * noise, "neighbouring views lower the noise"
    assert joined.figures["added_pixels"] >= sum(map(np.sum, inside)) and joined.figures["refused_pixels"] > 0
    for depth, weight in zip(joined.depths, joined.weights, strict=True):
        assert ((weight > 0) == (depth > 0)).all() and weight.max() <= 1.0
    least = min(weight[weight > 0].min() for weight in joined.weights)
    assert least == pytest.approx(STEREO_DEVIATION / noise * np.sqrt(2), rel=0.01), "one other view supports it at least"


def test_depth_that_is_less_sure_than_the_limit_measures_nothing() -> None:
    cameras, truths, _ = cup_views()
    nothing = [np.zeros_like(truth) for truth in truths]
    unsure = [np.full_like(truth, 1.1 * DEVIATION_MAX) for truth in truths]
    joined = join_depths(cameras, nothing, GivenDepth(truths, unsure, {}))
    assert not any(depth.any() for depth in joined.depths) and joined.figures["measured_pixels"] == 0


@pytest.fixture
def read_ball(tmp_path):
    """Read depth images of the ball, `change(depth in mm)` of the exact ones; `points` says how many sparse points a view sees."""
    views, truths = ball_views(128)
    views, truths = views[:10], truths[:10]
    registered = [View(view.camera, Path("none"), None) for view in views]
    masks = [view.mask.numpy() > 0 for view in views]
    hull = VisualHull.carve([view.camera for view in views], masks, 1.0, 48, misses_allowed=1)
    rng = np.random.default_rng(0)

    def read(change=steps, points=40, kind="structured_light", step_mm=1.0):
        for view, truth in zip(views, truths, strict=True):
            mm = np.where(truth > 0, truth * MM_A_UNIT, WALL_BEHIND_MM)
            write_image(tmp_path / "depth" / view.camera.name, change(mm))
        write_json(tmp_path / "capture" / "capture.json", {})
        shown = rng.normal(size=(3000, 3))
        shown *= RADIUS / np.linalg.norm(shown, axis=1, keepdims=True)
        seen = []
        for view in views:
            centre = view.camera.centre_in_world
            facing = np.flatnonzero(((centre - shown) * shown).sum(1) > 0.5 * RADIUS * np.linalg.norm(centre))
            seen.append(facing[:points])
        model = SparseModel(
            tuple(view.camera for view in views), shown, np.zeros((3000, 3), np.uint8), np.full(3000, 3), tuple(seen)
        )  # fmt: skip
        folder = DepthFolder.find({1: tmp_path / "depth"}, registered, tmp_path, tmp_path / "capture", step_mm)
        return read_given_depth(folder, kind, registered, model, ObjectSphere(np.zeros(3), 1.0), views, hull)

    return read, truths


def steps(mm: np.ndarray) -> np.ndarray:
    return np.rint(mm).astype(np.uint16)


def test_depth_images_are_brought_into_the_unit_of_the_registration(read_ball) -> None:
    read, truths = read_ball
    rng = np.random.default_rng(1)
    given = read(lambda mm: steps(10 * np.clip(mm + rng.normal(0, 0.5, mm.shape), 0, None)), step_mm=0.1)
    assert given.figures["mm_per_unit"] == pytest.approx(MM_A_UNIT, rel=2e-3) and given.figures["images"] == 10
    pairs = zip(given.depths, truths, strict=True)
    errors = np.concatenate([(found - truth[::3, ::3])[found > 0] for found, truth in pairs])
    stated = np.concatenate([deviation[deviation > 0] for deviation in given.deviations])
    assert len(errors) == len(stated) > 1000 and np.abs(errors).max() < 0.3, "nothing of the wall behind"
    assert np.std(errors) < np.median(stated) * 1.5


def test_depth_of_rotated_bits_is_turned_back(read_ball, capsys) -> None:
    read, _ = read_ball
    rotated = read(lambda mm: (steps(mm) << 3) | (steps(mm) >> 13))
    assert rotated.figures["mm_per_unit"] == pytest.approx(MM_A_UNIT, rel=5e-3)
    assert "their bits are rotated by 3" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda mm: steps(mm / 10), r"\.png: the object's depth, at 1 mm a step, is .* mm in the median"),
        (lambda mm: steps(mm * 50), "expected 50 to 5000"),
        (lambda mm: np.roll(steps(mm), 40, axis=1), "not aligned with the photos"),
        (lambda mm: steps(mm)[::2, ::2].copy(), "64 x 64 px, its photo 128 x 128 px.*not aligned"),
        (lambda mm: (mm / 8).astype(np.uint8), "uint8.*expected a 16-bit PNG"),
    ],
)
def test_depth_images_that_are_no_good_are_refused(read_ball, change, message) -> None:
    with pytest.raises(StepError, match=message):
        read_ball[0](change)


@pytest.mark.parametrize("how", [{"points": 5}, {"change": lambda mm: np.where(mm < WALL_BEHIND_MM, 0, steps(mm)).astype(np.uint16)}])
def test_depth_that_tells_too_little_leaves_the_photos_alone(read_ball, how, capsys) -> None:
    assert read_ball[0](**how) is None
    assert "the surface is measured by the photos alone" in capsys.readouterr().err


def write_registration(folder: Path, photos: list, points: np.ndarray, seen: list[np.ndarray]) -> None:
    """Photos with masks as `register` leaves them, and sparse points with the images that see them."""
    model = pycolmap.Reconstruction()
    tracks = [pycolmap.Track() for _ in points]
    for number, view in enumerate(photos, start=1):
        camera = view.camera
        write_image(folder / "images" / camera.name, view.image())
        write_mask(folder / "masks" / camera.name, view.mask())
        model.add_camera_with_trivial_rig(
            pycolmap.Camera(model="PINHOLE", width=camera.width_px, height=camera.height_px, params=camera.pinhole_params, camera_id=number)
        )
        pixels = camera.project(points[seen[number - 1]])[0]
        image = pycolmap.Image(name=camera.name, keypoints=pixels, camera_id=number, image_id=number)
        model.add_image_with_trivial_frame(image, to_rigid(camera.camera_from_world))
        for place, row in enumerate(seen[number - 1]):
            tracks[row].add_element(number, place)
    for number, (point, track) in enumerate(zip(points, tracks, strict=True), start=1):
        model.add_point3D_with_id(number, pycolmap.Point3D(xyz=point, color=np.zeros(3, np.uint8), error=0.5, track=track))
        for element in track.elements:
            model.images[element.image_id].set_point3D_for_point2D(element.point2D_idx, number)
    write_reconstruction(model, folder / "sparse")


@pytest.mark.slow
def test_the_step_measures_a_plain_mug_by_its_depth_images(tmp_path, capsys) -> None:
    mesh = mug()
    photos = sorted(photograph(mesh, matt), key=lambda view: view.camera.name)
    renderer, rng = MeshRenderer(mesh), np.random.default_rng(3)
    table = rng.uniform(-70, 70, (600, 3))
    table[:, 2] = -HEIGHT_MM / 2
    table = table[np.hypot(table[:, 0], table[:, 1]) > RADIUS_MM + 20]
    seen = []
    for view in photos:
        depth = renderer.find_depth(view.camera)
        pixels, z = view.camera.project(table)
        x, y = np.floor(pixels).astype(int).T
        framed = np.flatnonzero((x > 0) & (y > 0) & (x < view.camera.width_px - 1) & (y < view.camera.height_px - 1))
        framed = framed[depth[y[framed], x[framed]] == 0]
        seen.append(framed)
        # The table, on which the mug stands, at the points; elsewhere the camera saw nothing.
        depth[y[framed, None, None] + np.arange(-1, 2)[:, None], x[framed, None, None] + np.arange(-1, 2)] = z[framed, None, None]
        noisy = np.where(depth > 0, depth * 2.0 + rng.normal(0, 0.5, depth.shape), 0.0)  # a unit of this registration is 2 mm
        write_image(tmp_path / "depth" / view.camera.name, steps(np.clip(noisy, 0, None)))
    write_registration(tmp_path / "cameras", photos, table, seen)
    write_json(tmp_path / "capture" / "capture.json", {})
    words = ["--method", "stereo", "--cameras", tmp_path / "cameras", "--threads", 1, "--capture", tmp_path / "capture"]
    inside = {}
    for name, more in (("photos", []), ("joined", ["--depth", tmp_path / "depth"])):
        words_now = [str(word) for word in [*words, "--out", tmp_path / name, *more]]
        assert stage_main("zeroshop_steps.surface", words_now) == 0, capsys.readouterr().err
        points = read_confirmed_points(tmp_path / name / "seeds.npz", read_views(tmp_path / "cameras")[0])
        radius = np.hypot(points[:, 0], points[:, 1])
        wall = (np.abs(radius - (RADIUS_MM - WALL_MM)) < 1.5) & (points[:, 2] > -10) & (points[:, 2] < HEIGHT_MM / 2 - 8)
        inside[name] = int(wall.sum())
    facts = read_json(tmp_path / "joined/stereo.json")["given_depth"]
    assert "given_depth" not in read_json(tmp_path / "photos/stereo.json")
    assert facts["mm_per_unit"] == pytest.approx(2.0, rel=5e-3) and facts["camera"] == "structured_light" and facts["added_pixels"] > 0
    assert inside["joined"] > 300 > 3 * inside["photos"], "the wall inside is measured"
