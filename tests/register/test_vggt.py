"""Registration by VGGT: its geometry with a network that knows the truth, everything else with small random weights."""

import shutil

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from helpers.camera_ring import ring_camera
from helpers.small_vggt import SETTINGS, TrueNetwork, encode, write_weights
from zeroshop_steps import methods
from zeroshop_steps.evaluate.camera_error import compare_cameras
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model
from zeroshop_steps.geometry.imaging.images import list_images, write_image
from zeroshop_steps.networks import devices
from zeroshop_steps.networks.vggt.model import list_matrices
from zeroshop_steps.networks.vggt.settings import VggtSettings
from zeroshop_steps.register.scene.image_set import read_image_set
from zeroshop_steps.register.scene.record import RegistrationFailed
from zeroshop_steps.register.vggt.feed_forward import decode_cameras
from zeroshop_steps.register.vggt.frames import fit_size, read_frames
from zeroshop_steps.register.vggt.network import VggtNetwork, memory_errors
from zeroshop_steps.register.vggt.options import VggtOptions
from zeroshop_steps.register.vggt.solve import register
from zeroshop_steps.register.vggt.tracks import choose_query_views
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import is_result
from zeroshop_steps.runtime.files import read_json

PX = (518, 14)
FEWER = VggtOptions(tracked_points=400, query_views=4)


@pytest.fixture(scope="module")
def frames(carton_capture):
    return read_frames(read_image_set(carton_capture), *PX)


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return write_weights(tmp_path_factory.mktemp("vggt") / "weights" / "model.safetensors")


def solved(capture, out, options, network):
    record = register(read_image_set(capture), out, options, network, *PX, {})
    truth = read_sparse_model(capture / "truth").cameras
    return record, read_sparse_model(out / "sparse"), compare_cameras(read_sparse_model(out / "sparse").cameras, truth)


@pytest.mark.slow
def test_tracks_and_rough_cameras_give_the_true_cameras(carton_capture, frames, tmp_path):
    network = TrueNetwork(carton_capture, frames, turn_deg=2.0, fov_error=0.02, depth_error=0.01, track_px=0.5, wrong=0.05)
    rough = decode_cameras(network.predict(frames.pixels).encodings, frames)
    before = compare_cameras(rough, read_sparse_model(carton_capture / "truth").cameras)
    assert before.centre_mm.mean() > 3.0 and before.rotation_deg.max() > 1.0
    record, model, after = solved(carton_capture, tmp_path / "cameras", FEWER, network)
    assert record["registered"] == 10 and record["left_out"] == []
    assert after.centre_mm.mean() < 0.5 and after.rotation_deg.max() < 0.1
    assert len(model.points) > 300 and model.track_lengths.min() >= 3
    assert record["reprojection_error_px"] < 1.0


@pytest.mark.slow
def test_feed_forward_cameras_are_the_networks_own(carton_capture, frames, tmp_path):
    network = TrueNetwork(carton_capture, frames, turn_deg=0.2, fov_error=0.002, depth_error=0.003)
    expected = decode_cameras(TrueNetwork(carton_capture, frames, turn_deg=0.2, fov_error=0.002).predict(frames.pixels).encodings, frames)
    record, model, error = solved(carton_capture, tmp_path / "cameras", VggtOptions(refine="none"), network)
    assert record["registered"] == 10 and min(record["consistency"]["depth_agreement"].values()) > 0.8
    assert 0.0 < error.rotation_deg.max() < 0.5
    for ours, theirs in zip(model.cameras, expected, strict=True):
        assert np.allclose(ours.camera_from_world, theirs.camera_from_world) and np.allclose(ours.intrinsics, theirs.intrinsics)
    assert len(model.points) > 5000 and model.track_lengths.min() >= 2


@pytest.mark.slow
def test_feed_forward_cameras_that_depth_contradicts_are_refused(carton_capture, frames, tmp_path):
    network = TrueNetwork(carton_capture, frames, turn_deg=8.0)
    with pytest.raises(RegistrationFailed, match="other views confirm only"):
        solved(carton_capture, tmp_path / "cameras", VggtOptions(refine="none"), network)


@pytest.mark.slow
def test_tracks_that_are_noise_are_refused(carton_capture, frames, tmp_path):
    network = TrueNetwork(carton_capture, frames, wrong=1.0)
    with pytest.raises(RegistrationFailed, match="0 of 10 images registered|is self-consistent but incorrect|matches hold"):
        solved(carton_capture, tmp_path / "cameras", VggtOptions(tracked_points=40, query_views=1), network)


@pytest.mark.slow
def test_true_encodings_are_the_true_cameras(carton_capture, frames):
    truth = read_sparse_model(carton_capture / "truth").cameras
    found = decode_cameras(encode(list(truth), frames, 0.0, 0.0, np.random.default_rng(0)), frames)
    error = compare_cameras(found, truth)
    assert error.centre_mm.max() < 1e-6 and error.rotation_deg.max() < 1e-5
    for ours, theirs in zip(found, truth, strict=True):
        assert np.allclose(ours.intrinsics, theirs.intrinsics) and (ours.width_px, ours.height_px) == (theirs.width_px, theirs.height_px)


@pytest.mark.slow
@pytest.mark.parametrize("encoding", [[0] * 9, [0, 0, 1, 0, 0, 0, 1, 0, 0.8], [0, 0, 1, 0, 0, 0, 1, 0.8, np.nan]])
def test_what_is_no_camera_is_refused(frames, encoding):
    with pytest.raises(RegistrationFailed, match="found no camera for 000000.png"):
        decode_cameras(np.array([encoding] * 10, float), frames)


@pytest.mark.parametrize(
    ("size_px", "expected"),
    [((1000, 750), ((518, 392), 0)), ((750, 1000), ((392, 518), 63)), ((640, 640), ((518, 518), 0)), ((4000, 90), ((518, 14), 0))],
)
def test_images_fit_the_network(size_px, expected):
    assert fit_size(size_px, *PX) == expected


def test_upright_images_get_black_sides_and_places_come_back(tmp_path):
    for index in range(3):
        write_image(tmp_path / "images" / f"{index}.png", np.full((400, 300, 3), 60 + index, np.uint8))
    frames = read_frames(read_image_set(tmp_path), *PX)
    assert frames.pixels.shape == (3, 3, 518, 518)
    assert (frames.pixels[0, 0] > 0).mean() == pytest.approx(392 / 518)
    corners = np.array([[0.0, 0.0], [300.0, 400.0], [12.5, 99.0]])
    assert np.allclose(frames.to_network(corners)[:2], [[62.5, -0.5], [454.5, 517.5]])
    assert np.allclose(frames.to_image(frames.to_network(corners)), corners)


def test_query_views_are_apart_from_each_other():
    cameras = [ring_camera(index, 10, 400.0, (35.0, 35.0), (0.0, 0.0, 0.0), 600.0, (480, 360)) for index in range(10)]
    assert choose_query_views(cameras, 2) == [0, 5] and sorted(choose_query_views(cameras, 20)) == list(range(10))


def test_matrices_in_half_the_bytes_change_no_bit_of_what_autocast_gives(weights):
    pixels = np.random.default_rng(0).random((3, 3, 42, 56)).astype(np.float32)
    network = VggtNetwork(weights, SETTINGS, "cpu", torch.bfloat16, 1)
    halves = network.predict(pixels)
    assert {part.weight.dtype for part in list_matrices(network.module)} == {torch.bfloat16}
    assert network.module.depth_head.norm.weight.dtype == network.module.aggregator.camera_token.dtype == torch.float32
    whole = VggtNetwork(weights, SETTINGS, "cpu", torch.float32, 1)
    whole.precision = torch.bfloat16
    expected = whole.predict(pixels)
    for name in ("encodings", "depth", "confidence"):
        np.testing.assert_array_equal(getattr(halves, name), getattr(expected, name))


def test_memory_that_runs_out_is_no_result_about_the_pictures():
    with pytest.raises(StepError, match="memory ran out in the network") as caught, memory_errors():
        torch.empty(1 << 60)
    assert not is_result(caught.value)
    with pytest.raises(StepError, match="memory ran out in the network"), memory_errors():
        raise torch.OutOfMemoryError("CUDA out of memory")
    with pytest.raises(RuntimeError, match="something else"), memory_errors():
        raise RuntimeError("something else")


def test_a_device_that_is_absent_is_refused(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert devices.choose_device("auto") == "cpu" and devices.choose_precision("auto", "cpu") == torch.float32
    with pytest.raises(StepError, match="no CUDA device"):
        devices.choose_device("cuda")


def run(capture, out, weights, *words) -> int:
    words = ("--method", "vggt", "--capture", capture, "--scene", "su_h", "--out", out, "--weights", weights, "--device", "cpu", *words)
    return stage_main("zeroshop_steps.register", [str(word) for word in words])


@pytest.mark.slow
@pytest.mark.parametrize("refine", ["none", "tracks"])
def test_random_weights_end_as_a_failed_registration(carton_capture, weights, tmp_path, refine):
    out = tmp_path / "cell" / "cameras"
    words = ("--refine", refine, "--tracked-points", 30, "--query-views", 2, "--record-failure", f"{out}/")
    assert run(carton_capture, out, weights, *words) == 0
    record = read_json(out / "registration.json")
    assert record["status"] == "failed" and record["images"] == 10
    assert ("images registered" if refine == "tracks" else "other views confirm only") in record["reason"]
    assert record["precision"] == "float32" and record["predicted_peak_gb"] > 0
    assert {path.name for path in out.iterdir()} >= {"failure.json", "registration.json"}


@pytest.mark.slow
def test_same_input_gives_the_same_record(carton_capture, weights, tmp_path):
    few = shutil.copytree(carton_capture, tmp_path / "few")
    for path in [path for part in ("images", "masks", "depth") for path in list_images(few / part)[5:]]:
        path.unlink()
    words = ("--tracked-points", 30, "--query-views", 2, "--precision", "bfloat16", "--record-failure")
    for name in ("once", "again"):
        assert run(few, tmp_path / name, weights, *words, f"{tmp_path / name}/") == 0
    once, again = (read_json(tmp_path / name / "registration.json") for name in ("once", "again"))
    assert once.pop("seconds").keys() == again.pop("seconds").keys() and once == again


def test_bad_weights_are_refused_by_name(blank_capture, weights, tmp_path, capsys):
    state = load_file(weights)
    settings = weights.with_suffix(".settings.json").read_text()

    def refused(name: str, content: dict | None, expected: str, sizes: str = settings) -> None:
        path = tmp_path / name
        if content is not None:
            save_file(content, path)
        path.with_suffix(".settings.json").write_text(sizes)
        assert run(blank_capture, tmp_path / "cameras", path) == 1
        assert expected in capsys.readouterr().err and not (tmp_path / "cameras").exists()

    refused("none.safetensors", None, "do not exist")
    refused(
        "less.safetensors", {key: value for key, value in state.items() if "trunk.0.norm1" not in key}, "camera_head.trunk.0.norm1.weight"
    )
    refused("more.safetensors", {**state, "other.weight": torch.zeros(1)}, "other.weight")
    refused("other.safetensors", state, "image size", settings.replace('"width": 32', '"breadth": 32').replace("{", '{"image size": 1,', 1))
    (tmp_path / "cut.safetensors").write_bytes(weights.read_bytes()[:5000])
    refused("cut.safetensors", None, "damaged or was cut short")


@pytest.mark.parametrize(
    ("words", "file", "licence"),
    [
        ((), "VGGT-1B/model.safetensors", "CC BY-NC"),
        (
            ("--weights", f"resources/weights/{methods.REGISTRATIONS['vggt_commercial'].weights[0]}"),
            "VGGT-1B-Commercial/vggt_1B_commercial.pt",
            "commercial use",
        ),
    ],
)
def test_the_published_weights_are_asked_for_with_their_licence(blank_capture, tmp_path, monkeypatch, capsys, words, file, licence):
    monkeypatch.chdir(tmp_path)
    words = ("--method", "vggt", *words, "--capture", str(blank_capture), "--scene", "su_h", "--out", "cameras")
    assert stage_main("zeroshop_steps.register", words) == 1
    message = capsys.readouterr().err
    assert f"resources/weights/{file}" in message and licence in message and "colmap needs no weights" in message


def test_a_checkpoint_in_pytorchs_format_gives_the_same_network(weights, tmp_path):
    """As VGGT-1B-Commercial has it."""
    state = load_file(weights)
    torch.save(state, tmp_path / "model.pt")
    network = VggtNetwork(tmp_path / "model.pt", SETTINGS, "cpu", torch.float32, 4)
    assert all(torch.equal(tensor, state[name]) for name, tensor in network.module.state_dict().items())


def test_two_images_are_refused(blank_capture, weights, tmp_path, capsys):
    for path in list_images(blank_capture / "images")[2:]:
        path.unlink()
    assert run(blank_capture, tmp_path / "cameras", weights) == 1
    assert "holds 2 image(s); at least 3 are needed" in capsys.readouterr().err


def test_settings_fit_the_patches():
    for settings in (VggtSettings(), SETTINGS):
        assert settings.image_px % settings.patch_px == 0 and settings.width % (4 * settings.heads) == 0
