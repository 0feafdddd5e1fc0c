"""The step from files to a result file, with small random weights, and what bad input is answered."""

import json
import os
import shutil

import numpy as np
import pytest
import torch

from helpers.small_dataset import BOX, CAN, dataset_in, make_dataset
from helpers.small_foundationpose import make_network, write_checkpoints, write_onnx
from zeroshop_steps.bop.formats.detections import Detection, encode_mask, write_detections
from zeroshop_steps.bop.formats.estimates import read_estimates
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import write_ply
from zeroshop_steps.networks import devices, weights
from zeroshop_steps.networks.foundationpose import onnx_pairs
from zeroshop_steps.networks.foundationpose.model import ScoreNet
from zeroshop_steps.pose.foundationpose import estimator, networks
from zeroshop_steps.pose.foundationpose.estimator import PoseEstimator, make_rotations
from zeroshop_steps.runtime.cli import stage_main


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("small")
    write_checkpoints(folder)
    return make_dataset(folder)


@pytest.fixture
def small(made, tmp_path, monkeypatch):
    """A dataset and weights of this test's own; a few hypotheses instead of 252."""
    shutil.copytree(made.folder, tmp_path / "data")
    monkeypatch.chdir(tmp_path / "data")
    monkeypatch.setattr(estimator, "SAME_TURN_DEG", 100.0)
    return dataset_in(tmp_path / "data")


def estimate(small, *words: str, method: str = "foundationpose"):
    out = small.folder / "poses.csv"
    given = ["--models", small.folder / "models", "--scenes", small.scenes, "--targets", small.targets_path, "--out", out]
    return stage_main("zeroshop_steps.pose", ["--method", method, *map(str, given), "--device", "cpu", *words]), out


def detections(small, *found: tuple[np.ndarray, float]) -> list[str]:
    path = small.folder / "found.json"
    write_detections(path, [Detection(1, 0, BOX, score, None, encode_mask(mask)) for mask, score in found])
    return ["--detections", str(path), "--iterations", "1"]


def test_poses_are_estimated_from_true_masks_the_same_each_time(small, capsys):
    status, out = estimate(small, "--iterations", "1")
    first = out.read_text()
    poses = read_estimates(out)
    assert status == 0, capsys.readouterr().err
    found = sorted(zip(poses.image_ids.tolist(), poses.object_ids.tolist(), strict=True))
    assert found == [(0, BOX), (0, CAN), (1, BOX), (1, CAN), (1, CAN)]
    assert (poses.scores == 1).all() and np.isfinite(poses.translations_mm).all()
    assert f"the models of the objects [{BOX}, {CAN}] have no texture" in capsys.readouterr().err
    without_seconds = [line.rsplit(",", 1)[0] for line in first.splitlines()]
    assert estimate(small, "--iterations", "1")[0] == 0
    assert [line.rsplit(",", 1)[0] for line in out.read_text().splitlines()] == without_seconds


def test_the_surest_detection_is_taken_and_its_score_is_the_poses(small):
    mask = small.frames[1, 0].mask(0)
    other = np.zeros_like(mask)
    other[:20, :20] = True
    status, out = estimate(small, *detections(small, (other, 0.4), (mask, 0.7)))
    poses = read_estimates(out)
    assert status == 0 and poses.scores.tolist() == [0.7]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("device", "providers", "words"),
    [
        ("cpu", ["CPUExecutionProvider"], ""),
        ("cuda", ["CPUExecutionProvider"], "install onnxruntime-gpu in place of onnxruntime"),
        ("cuda", ["CUDAExecutionProvider", "CPUExecutionProvider"], "finds no CUDA and cuDNN"),
    ],
)
def test_onnx_files_that_run_on_the_processor_of_a_machine_with_a_card_say_so(tmp_path, monkeypatch, capsys, device, providers, words):
    refiner = write_onnx(tmp_path, pairs=1)[0]
    monkeypatch.setattr(onnx_pairs.onnxruntime, "get_available_providers", lambda: providers)
    onnx_pairs.OnnxPairs(refiner, torch.device(device), outputs=2)
    told = capsys.readouterr().err
    assert ("eleven minutes" in told) == bool(words) and words in told


def test_the_onnx_files_of_the_same_networks_give_the_same_poses_and_scores(small, monkeypatch):
    """Random networks score all hypotheses nearly alike, and rounding decides which is best: the last refined one is compared instead."""
    scored = []
    score = PoseEstimator._score

    def prefer_the_last(*arguments):
        scored.append(score(*arguments))
        return torch.arange(len(scored[-1]))

    monkeypatch.setattr(PoseEstimator, "_score", prefer_the_last)
    monkeypatch.setattr(weights, "verify", lambda *_: None)  # random networks are none of the published files
    write_onnx(small.folder, pairs=len(make_rotations(np.eye(4)[None])))
    words = detections(small, (small.frames[1, 0].mask(0), 0.7))
    status, out = estimate(small, *words)
    ours = read_estimates(out)
    assert status == 0 and estimate(small, *words, method="foundationpose_onnx")[0] == 0
    theirs = read_estimates(out)
    np.testing.assert_allclose(theirs.translations_mm, ours.translations_mm, atol=0.01)
    np.testing.assert_allclose(theirs.rotations, ours.rotations, atol=1e-3)
    assert len(scored) == 2 and len(scored[0]) > 1 and torch.allclose(*scored, rtol=1e-4, atol=1e-5)


def test_nothing_is_estimated_from_an_empty_mask_or_one_without_depth(small):
    empty = np.zeros_like(small.frames[1, 0].mask(0))
    status, out = estimate(small, *detections(small, (empty, 0.7)))
    assert status == 0 and len(read_estimates(out)) == 0
    words = detections(small, (small.frames[1, 0].mask(0), 0.7))
    status, out = estimate(small, *words, "--depth-cut-m", "0.2")
    assert status == 0 and len(read_estimates(out)) == 0, "all of it is farther away than the cut"


def in_metres(small) -> None:
    mesh = read_ply(small.folder / "models/obj_000001.ply")
    write_ply(small.folder / "models/obj_000001.ply", type(mesh)(mesh.vertices / 1000, mesh.faces))


def depth_in_metres(small) -> None:
    path = small.scenes / "000001/scene_camera.json"
    content = json.loads(path.read_text())
    path.write_text(json.dumps({number: entry | {"depth_scale": 1e-4} for number, entry in content.items()}))


def other_weights(small) -> None:
    path = small.folder / "resources/weights/foundationpose/2023-10-28-18-33-37/model_best.pth"
    torch.save({"model": make_network(ScoreNet).state_dict()}, path)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda small: shutil.rmtree(small.scenes / "000001/depth"), "poses are estimated from depth: add it"),
        (depth_in_metres, "metres"),
        (in_metres, "Convert it to millimetres"),
        (other_weights, "does not fit RefineNet"),
        (lambda small: shutil.rmtree(small.folder / "resources"), "from https://drive.google.com"),
    ],
)
def test_bad_input_is_named(small, capsys, damage, message):
    damage(small)
    status, out = estimate(small, "--iterations", "1")
    assert status == 1 and message in capsys.readouterr().err and not out.exists()


def test_masks_of_another_size_are_refused(small, capsys):
    assert estimate(small, *detections(small, (np.ones((10, 10), bool), 0.7)))[0] == 1
    assert "is 10 x 10 px, the image 96 x 72 px" in capsys.readouterr().err


def test_absent_cuda_and_too_little_memory_are_refused_before_the_start(small, capsys, monkeypatch):
    if not torch.cuda.is_available():
        assert estimate(small, "--device", "cuda")[0] == 1
        assert "PyTorch finds no CUDA device" in capsys.readouterr().err
    monkeypatch.setattr(devices, "measure_free_bytes", lambda device: 900_000_000)
    assert estimate(small)[0] == os.EX_OK + 1
    assert "FoundationPose on 1 pose at once takes 1.0 GB at its peak, the device cpu has 0.9 GB free" in capsys.readouterr().err


def test_batches_are_as_large_as_memory_allows(monkeypatch):
    cuda, cpu = torch.device("cuda"), torch.device("cpu")
    for free_pairs, expected in ((1000, 252), (40, 40)):
        monkeypatch.setattr(networks, "check_memory", lambda needs, device: None)
        free = (networks.predict_peak_bytes(0) + free_pairs * networks.PAIR_BYTES) / networks.RESERVE
        monkeypatch.setattr(networks, "measure_free_bytes", lambda device, free=free: int(free) + 1)
        assert networks.choose_batch(cuda) == expected and networks.choose_batch(cpu) == 16
