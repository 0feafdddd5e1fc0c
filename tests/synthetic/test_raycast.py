"""The virtual captures: their cameras, and that images, masks, depth and cameras agree with each other and with the model."""

import filecmp
from pathlib import Path

import numpy as np
import pytest

from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model
from zeroshop_steps.geometry.imaging.images import read_depth_mm, read_image, read_mask
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.synthetic.raycast import capture
from zeroshop_steps.synthetic.rendering.lighting import place_lights
from zeroshop_steps.synthetic.scenes.camera_rings import DISTANCE_IN_SIZES, ObjectBounds, Rings, place_capture_cameras

WIDTH, HEIGHT = 160, 120
HALF_MM = np.array([20.0, 30.0, 50.0])


@pytest.fixture(scope="module")
def plain(box, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("plain") / "capture"
    capture(box, "su_l", WIDTH, HEIGHT, 0, out)
    return out


@pytest.fixture(scope="module")
def rich(box, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("rich") / "capture"
    capture(box, "su_h", WIDTH, HEIGHT, 0, out)
    return out


@pytest.fixture(scope="module")
def alone(box, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("alone") / "capture"
    capture(box, "se", WIDTH, HEIGHT, 0, out)
    return out


def points_of(capture_folder: Path, camera, only_object: bool) -> np.ndarray:
    depth = read_depth_mm(capture_folder / "depth" / camera.name)
    keep = depth > 0
    if only_object:
        keep &= read_mask(capture_folder / "masks" / camera.name)
    y, x = np.nonzero(keep)
    rays = np.stack([x + 0.5, y + 0.5, np.ones(len(x))], 1) @ np.linalg.inv(camera.intrinsics).T
    world_from_camera = np.linalg.inv(camera.camera_from_world)
    return (rays * depth[y, x, None]) @ world_from_camera[:3, :3].T + world_from_camera[:3, 3]


def test_layout_is_complete(plain, alone):
    for folder, count in ((plain, 20), (alone, 30)):
        names = [f"{index:06d}.png" for index in range(count)]
        for part in ("images", "masks", "depth"):
            assert sorted(path.name for path in (folder / part).iterdir()) == names
        assert [camera.name for camera in read_sparse_model(folder / "truth").cameras] == names
        assert len(read_sparse_model(folder / "held_out" / "truth").cameras) == 2
        for part in ("images", "masks"):
            assert len(list((folder / "held_out" / part).iterdir())) == 2
        facts = read_json(folder / "capture.json")
        assert facts["images"] == count and facts["known_height_m"] == pytest.approx(0.1)
        assert read_image(folder / "images" / names[0]).shape == (HEIGHT, WIDTH, 3)


def test_rings_follow_the_thesis(alone):
    cameras = read_sparse_model(alone / "truth").cameras
    centres = np.array([camera.centre_in_world for camera in cameras])
    assert np.allclose(np.linalg.norm(centres, axis=1), DISTANCE_IN_SIZES * 100.0, atol=1e-6)
    elevations = np.degrees(np.arcsin(centres[:, 2] / 320.0))
    assert np.allclose(elevations, np.repeat([0, 45, -45], 10), atol=1e-6)
    azimuths = np.degrees(np.arctan2(centres[:, 1], centres[:, 0])) % 360
    assert np.allclose((azimuths - np.tile(np.arange(10) * 36, 3) + 180) % 360, 180, atol=1e-6)
    for camera in cameras:
        pixels, depths = camera.project(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 10.0]]))
        assert np.allclose(pixels[0], [WIDTH / 2, HEIGHT / 2]) and pixels[1, 1] < pixels[0, 1] and depths[0] > 0
        assert camera.intrinsics[0, 0] == pytest.approx(WIDTH * 50 / 36)


def test_first_camera_sees_the_front_wherever_it_is():
    for front_deg in (0.0, 90.0, 217.0):
        first = place_capture_cameras(ObjectBounds(np.zeros(3), 100.0, -50.0, front_deg), "su_h", WIDTH, HEIGHT, Rings())[0]
        angle = np.radians(front_deg)
        assert np.allclose(first.centre_in_world[:2] / 320.0, [np.cos(angle), np.sin(angle)], atol=1e-9)


def test_cameras_over_a_flat_object_stay_off_the_surface():
    flat = ObjectBounds(np.array([0.0, 0.0, 10.0]), 200.0, 0.0)
    heights = np.array([camera.centre_in_world[2] for camera in place_capture_cameras(flat, "su_l", WIDTH, HEIGHT, Rings())])
    assert np.allclose(heights[:10], 100.0)
    assert np.allclose(heights[10:], 10.0 + 640.0 * np.sin(np.radians(45)))


def test_rings_may_have_other_views_and_elevations_and_skim_the_surface():
    flat = ObjectBounds(np.array([0.0, 0.0, 10.0]), 200.0, 0.0)
    cameras = place_capture_cameras(flat, "su_h", WIDTH, HEIGHT, Rings(views=3, elevations_deg=(0.0, 20.0), least_height_sizes=0.0))
    places = np.array([camera.centre_in_world for camera in cameras]) - flat.centre_mm
    azimuths, elevations = np.degrees(np.arctan2(places[:, 1], places[:, 0])), np.degrees(np.arcsin(places[:, 2] / 640.0))
    assert np.allclose(azimuths % 360 % 359.999999, [0, 120, 240, 0, 120, 240], atol=1e-4)
    assert np.allclose(elevations, [0, 0, 0, 20, 20, 20], atol=1e-6)


def test_equal_lights_are_equal_and_expose_alike():
    bounds = ObjectBounds(np.zeros(3), 100.0, -50.0)
    usual, equal = place_lights(bounds, True), place_lights(bounds, True, [1.0] * 6)
    assert np.ptp(equal.radiances) == 0.0 < np.ptp(usual.radiances)
    assert 0.5 < equal.radiances.mean() / usual.radiances.mean() < 2.0


def test_front_is_unmirrored_and_upright(plain):
    camera = read_sparse_model(plain / "truth").cameras[0]
    image = read_image(plain / "images" / "000000.png").astype(int)

    def color_at(y_mm: float, z_mm: float) -> np.ndarray:
        pixel = camera.project(np.array([[HALF_MM[0], y_mm, z_mm]]))[0][0]
        return image[int(pixel[1]), int(pixel[0])]

    red, green, white = color_at(-15, -10), color_at(15, -10), color_at(0, 40)
    assert red[0] > 2 * red[1] and green[1] > 2 * green[0] and white.min() > 120
    left, right = (camera.project(np.array([[HALF_MM[0], y, 0.0]]))[0][0, 0] for y in (-15, 15))
    assert left < right


@pytest.mark.parametrize("scene", ["plain", pytest.param("rich", marks=pytest.mark.slow), "alone"])
def test_depth_lies_on_the_model_and_agrees_between_views(scene, request):
    folder = request.getfixturevalue(scene)
    cameras = read_sparse_model(folder / "truth").cameras
    for camera in (cameras[0], cameras[3], cameras[12]):
        points = points_of(folder, camera, only_object=True)
        assert len(points) > 200
        off_surface = np.abs(np.maximum((np.abs(points) - HALF_MM).max(1), -HALF_MM.min()))
        assert np.quantile(off_surface, 0.98) < 0.2
    points = points_of(folder, cameras[12], only_object=False)
    pixels, depths = cameras[13].project(points)
    x, y = np.floor(pixels).astype(int).T
    inside = (x >= 0) & (x < WIDTH) & (y >= 0) & (y < HEIGHT)
    seen = read_depth_mm(folder / "depth" / cameras[13].name)[y[inside], x[inside]]
    behind = seen > 0
    step_mm = 0.03 * depths[inside]
    assert (depths[inside][behind] >= seen[behind] - step_mm[behind]).mean() > 0.98
    assert (np.abs(depths[inside] - seen) < step_mm)[behind].mean() > 0.6


def test_mask_is_the_silhouette(plain, alone):
    for folder in (plain, alone):
        camera = read_sparse_model(folder / "truth").cameras[0]
        corners = np.array([[20.0, y, z] for y in (-30, 30) for z in (-50, 50)])
        pixels, _ = camera.project(corners)
        (left, top), (right, bottom) = pixels.min(0), pixels.max(0)
        mask = read_mask(folder / "masks" / camera.name)
        assert abs(mask.sum() - (right - left) * (bottom - top)) < 0.02 * mask.sum()
        assert abs(np.nonzero(mask.any(0))[0][0] - left) <= 1 and abs(np.nonzero(mask.any(1))[0][-1] + 1 - bottom) <= 1


def test_alone_is_black_outside_the_mask(alone):
    for name in ("000000.png", "000013.png", "000027.png"):
        mask = read_mask(alone / "masks" / name)
        assert not read_image(alone / "images" / name)[~mask].any()
        assert np.array_equal(read_depth_mm(alone / "depth" / name) > 0, mask)


def test_object_darkens_the_surface_beside_it(plain):
    camera = read_sparse_model(plain / "truth").cameras[10]
    image = read_image(plain / "images" / camera.name).astype(float).mean(2)

    def brightness(distance_mm: float) -> float:
        points = np.array([[x, side * (30.0 + distance_mm), -50.0] for x in np.linspace(-15, 15, 9) for side in (-1, 1)])
        x, y = np.floor(camera.project(points)[0]).astype(int).T
        return float(image[y, x].mean())

    assert brightness(4.0) < 0.93 * brightness(60.0)


@pytest.mark.slow
def test_surfaces_differ_as_the_scenes_say(plain, rich):
    view = "000010.png"
    outside = ~read_mask(plain / "masks" / view)
    grey = {
        name: read_image(folder / "images" / view).astype(float).mean(2)[outside] for name, folder in (("plain", plain), ("rich", rich))
    }
    assert grey["plain"].std() < 12 and grey["rich"].std() > 25


@pytest.mark.slow
def test_same_seed_same_bytes_and_other_seed_other_noise(box, tmp_path):
    for out, seed in (("once", 0), ("again", 0), ("other", 1)):
        capture(box, "se", WIDTH, HEIGHT, seed, tmp_path / out, rings=Rings(views=2))
    once = tmp_path / "once"
    files = [path.relative_to(once) for path in sorted(once.rglob("*")) if path.is_file() and path.name != "capture.json"]
    facts = [read_json(folder / "capture.json") for folder in (once, tmp_path / "again")]
    assert [fact | {"seconds": 0} for fact in facts] == [facts[0] | {"seconds": 0}] * 2
    assert len(files) > 3 * 6 and all(filecmp.cmp(once / file, tmp_path / "again" / file, shallow=False) for file in files)
    name = "images/000000.png"
    assert not filecmp.cmp(once / name, tmp_path / "other" / name, shallow=False)
    difference = read_image(once / name).astype(int) - read_image(tmp_path / "other" / name)
    assert 0.1 < np.abs(difference[read_mask(once / "masks/000000.png")]).mean() < 5


def test_bad_models_and_options_are_named(box, tmp_path):
    mesh = read_ply(box)
    write_ply(tmp_path / "metres.ply", Mesh(mesh.vertices / 1000, mesh.faces))
    (tmp_path / "broken.ply").write_bytes(box.read_bytes()[:400])
    for name, words in (("metres.ply", "millimetres"), ("broken.ply", "cannot be read"), ("none.ply", "exist")):
        with pytest.raises(StepError, match=words) as error:
            capture(tmp_path / name, "se", WIDTH, HEIGHT, 0, tmp_path / "out")
        assert name in str(error.value)
    with pytest.raises(StepError, match="image size 10 x 120"):
        capture(box, "se", 10, HEIGHT, 0, tmp_path / "out")
    with pytest.raises(StepError, match="seed -1"):
        capture(box, "se", WIDTH, HEIGHT, -1, tmp_path / "out")
    assert not (tmp_path / "out").exists() and not list(tmp_path.glob(".out*"))
