"""U²-Net in PyTorch gives what its ONNX file gives, and its weights go from file to network and back."""

import sys

import cv2
import numpy as np
import onnxruntime
import pytest
import torch

from helpers.paths import REPOSITORY
from helpers.small_saliency import write_network
from helpers.small_u2net import export_small, make_small
from u2net import U2Net, read_weights, write_weights
from zeroshop_steps.geometry.imaging.images import read_image
from zeroshop_steps.networks.imagenet import LEVEL_DEVIATION, LEVEL_MEAN
from zeroshop_steps.networks.saliency.salient_networks import NETWORKS
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.runtime.errors import StepError

REAL = NETWORKS["u2netp"]
PHOTO = REPOSITORY / "docs/mustard_bottle.jpg"
SIDES_PX = 72, 104  # odd where halved often


@pytest.fixture
def exported(tmp_path):
    """An ONNX file of a small network, written by PyTorch."""
    return export_small(tmp_path / "small.onnx", *SIDES_PX)


def run_both(network: U2Net, path, images: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Each output by PyTorch and by onnxruntime."""
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    with torch.no_grad():
        ours = network(torch.from_numpy(images).to(network.fuse.weight.dtype))
    theirs = session.run(None, {session.get_inputs()[0].name: images})
    return [(one.numpy(), other) for one, other in zip(ours, theirs, strict=True)]


def test_the_published_weights_give_what_onnxruntime_gives():
    path = REPOSITORY / REAL.path
    if not path.is_file():
        pytest.skip(f"{path} is not there; `snakemake {REAL.path}` downloads it")
    network = U2Net()
    read_weights(network, path)
    photo = cv2.resize(read_image(PHOTO), (REAL.side_px, REAL.side_px), interpolation=cv2.INTER_AREA)
    levels = ((photo - np.array(REAL.mean)) / REAL.deviation).astype(np.float32)
    # In double precision: in single precision, rounding alone is up to 1e-4, in either library.
    outputs = run_both(network.double(), path, np.ascontiguousarray(levels.transpose(2, 0, 1)[None]))
    for log_odds, probability in outputs:
        np.testing.assert_allclose(1 / (1 + np.exp(-log_odds)), probability, atol=1e-4)
    assert outputs[0][1].max() > 0.9 and outputs[0][1].min() < 0.1  # it sees a thing, and something else


def test_weights_are_written_and_read(tmp_path, exported):
    """A file with new weights gives what the network gives, also as the finder of objects reads it."""
    trained, read = make_small(1), make_small(2)
    write_weights(trained, exported, tmp_path / "trained.onnx")
    read_weights(read, tmp_path / "trained.onnx")
    assert all(torch.equal(one, other) for one, other in zip(trained.parameters(), read.parameters(), strict=True))
    rng = np.random.default_rng(0)
    for one, other in run_both(trained, tmp_path / "trained.onnx", rng.normal(size=(1, 3, *SIDES_PX)).astype(np.float32)):
        np.testing.assert_allclose(one, other, atol=1e-5)
        assert np.ptp(one) > 1e-3
    finder = SalientObjectNetwork(tmp_path / "trained.onnx", LEVEL_MEAN, LEVEL_DEVIATION)
    found = finder.predict(rng.integers(0, 256, (50, 60, 3), dtype=np.uint8), (60, 50))
    assert found.shape == (50, 60) and 0 < found.min() < found.max() < 1


def test_other_files_are_refused(tmp_path, exported):
    write_network(tmp_path / "other.onnx")
    (tmp_path / "cut.onnx").write_bytes(exported.read_bytes()[:2000])
    for name, reason in (("other", "has 2 arrays .* u2netp.onnx"), ("cut", "cannot be read"), ("missing", "does not exist")):
        with pytest.raises(StepError, match=reason):
            read_weights(make_small(0), tmp_path / f"{name}.onnx")
        with pytest.raises(StepError, match=reason):
            write_weights(make_small(0), tmp_path / f"{name}.onnx", tmp_path / "new.onnx")
    with pytest.raises(StepError, match="or of other shapes"):
        read_weights(U2Net(), exported)
    assert not (tmp_path / "new.onnx").exists()


def test_the_package_that_reads_them_is_named(monkeypatch, exported):
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(StepError, match="pip install onnx"):
        read_weights(make_small(0), exported)
