"""Which cameras of joined passes say how a model lies to the truth."""

from helpers.carton_scene import camera_at
from zeroshop_steps.geometry.cameras.pinhole import write_cameras
from zeroshop_steps.geometry.cameras.registered_views import PASSES, read_first_cameras
from zeroshop_steps.runtime.files import write_json


def test_the_cameras_of_the_first_pass_alone(tmp_path):
    names = ["000000.png", "000001.png", "2_000000.png"]
    write_cameras(tmp_path / "sparse", [camera_at(name, 36.0 * index, 30.0) for index, name in enumerate(names)])
    assert [camera.name for camera in read_first_cameras(tmp_path)] == names, "there was one pass only"
    write_json(tmp_path / PASSES, {"passes": [{"number": 1, "images": names[:2]}, {"number": 2, "images": names[2:]}]})
    assert [camera.name for camera in read_first_cameras(tmp_path)] == names[:2]
