"""Registration with the true cameras."""

import numpy as np
import pytest

from helpers.camera_ring import ring_camera
from zeroshop_steps.evaluate.camera_error import compare_cameras
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model, write_cameras
from zeroshop_steps.geometry.imaging.images import list_images, read_image
from zeroshop_steps.register.features.sift import SiftOptions
from zeroshop_steps.register.scene.image_set import read_image_set
from zeroshop_steps.register.scene.record import RegistrationFailed, read_registration
from zeroshop_steps.register.truth import register
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import Failure, write_failure
from zeroshop_steps.runtime.files import read_json


@pytest.mark.slow
def test_true_cameras_and_pictures_stay_as_they_are(carton_capture, tmp_path):
    register(read_image_set(carton_capture), carton_capture / "truth", "su_h", tmp_path / "cameras", SiftOptions(max_features=1000))
    model, truth = read_sparse_model(tmp_path / "cameras" / "sparse"), read_sparse_model(carton_capture / "truth")
    error = compare_cameras(model.cameras, truth.cameras)
    assert error.centre_mm.max() < 1e-6 and error.rotation_deg.max() < 1e-6
    assert len(model.points) > 200
    for path in list_images(carton_capture / "images"):
        assert np.array_equal(read_image(path), read_image(tmp_path / "cameras" / "images" / path.name))


def test_a_picture_without_a_true_camera_is_named(blank_capture, tmp_path):
    image_set = read_image_set(blank_capture)
    write_cameras(
        tmp_path / "truth", [ring_camera(index, 10, 400.0, (5.0, 35.0), (0.0, 0.0, 0.0), 200.0, (160, 120)) for index in range(5)]
    )
    with pytest.raises(StepError, match="no camera for image 000005.png"):
        register(image_set, tmp_path / "truth", "su_h", tmp_path / "cameras", SiftOptions(max_features=1000))


def test_a_failed_record_is_refused_by_later_stages(tmp_path):
    error = RegistrationFailed("3 of 20 images registered", {"registered": 3})
    write_failure([f"{tmp_path}/cameras/"], Failure("register.colmap", str(error)), error.write_details)
    assert read_json(tmp_path / "cameras" / "registration.json")["registered"] == 3
    with pytest.raises(StepError, match="3 of 20 images registered"):
        read_registration(tmp_path / "cameras")
