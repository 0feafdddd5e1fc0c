"""Training a network further: it learns, an interrupted run goes on as if nothing had happened, and two networks are compared."""

import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

import compare_networks
import train_network
from helpers.small_saliency import write_network
from helpers.small_u2net import export_small, make_small
from masked_photos import find_rendered
from train_network import Settings, choose_surroundings, make_example, train
from u2net import U2Net, read_weights
from zeroshop_steps.geometry.imaging.images import write_image, write_mask
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.tables import read_table

SIDE_PX = 32
SETTINGS = Settings(updates=6, batch=2, learning_rate=2e-2, frozen=1, seed=0)


@pytest.fixture
def inputs(tmp_path: Path) -> Path:
    """Red discs on grey, of an object of each half."""
    rng = np.random.default_rng(0)
    for capture in ("apple_1", "mug_1"):
        for stem in ("a", "b", "c"):
            disc = np.zeros((60, 80), np.uint8)
            cv2.circle(disc, (int(rng.integers(25, 55)), int(rng.integers(20, 40))), 14, 1, -1)
            photo = np.where(disc[..., None] > 0, np.uint8([250, 10, 10]), rng.integers(60, 160, (60, 80, 1), dtype=np.uint8))
            write_image(tmp_path / "rendered" / capture / "capture/images" / f"{stem}.png", photo.astype(np.uint8))
            write_mask(tmp_path / "rendered" / capture / "capture/truth/masks" / f"{stem}.png", disc > 0)
    return tmp_path


@pytest.fixture
def start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file of a small network with random weights, which is trained in place of the real one."""
    monkeypatch.setattr(train_network, "U2Net", make_small)
    monkeypatch.setattr(train_network, "KNOWN", replace(train_network.KNOWN, side_px=SIDE_PX))
    monkeypatch.setattr(train_network, "CHECKPOINT_EVERY", 2)
    return export_small(tmp_path / "start.onnx", SIDE_PX, SIDE_PX)


def load(path: Path) -> U2Net:
    network = make_small()
    read_weights(network, path)
    return network


def test_halves_share_no_object(inputs):
    assert {one.capture for one in find_rendered(inputs, "tune")} == {"apple_1"}
    assert {one.capture for one in find_rendered(inputs, "judge")} == {"mug_1"}
    with pytest.raises(StepError, match="holds no rendered captures of the half judge"):
        find_rendered(inputs / "rendered", "judge")


def test_examples_keep_photo_and_mask_together(inputs):
    """Under each change of light, and in each part of a photo, what is red is the object."""
    photos = find_rendered(inputs, "tune")
    for seed in range(12):
        image, mask = make_example(photos[0], np.random.default_rng(seed))
        assert image.shape == (1, 3, 320, 320) and mask.shape == (1, 1, 320, 320)
        red = (image[0, 0] - image[0, 2] > 1).numpy()
        assert ((mask[0, 0].numpy() > 0.5) == red).mean() > 0.97
    corner = np.zeros((40, 50), bool)
    corner[:5, 45:] = True
    rows, columns = choose_surroundings(corner, np.random.default_rng(0))
    assert rows.start == 0 and rows.stop >= 5 and columns.start < 45


def test_it_learns_and_keeps_what_is_frozen(tmp_path, inputs, start):
    photos = find_rendered(inputs, "tune")
    train(photos, start, replace(SETTINGS, updates=30), tmp_path / "trained.onnx")
    before, after = load(start), load(tmp_path / "trained.onnx")
    image, mask = make_example(photos[0], np.random.default_rng(5))
    with torch.no_grad():
        losses = [torch.nn.functional.binary_cross_entropy_with_logits(one(image)[0], mask) for one in (before, after)]
    assert losses[1] < 0.9 * losses[0]
    same = [torch.equal(one, other) for one, other in zip(before.parameters(), after.parameters(), strict=True)]
    frozen = len(list(before.down[0].parameters()))
    assert all(same[:frozen]) and not any(same[-4:])


def test_an_interrupted_run_goes_on(tmp_path, monkeypatch, inputs, start):
    photos = find_rendered(inputs, "tune")
    train(photos, start, SETTINGS, tmp_path / "whole.onnx")
    take_step, updates = train_network.take_step, []

    def stop_at_the_fourth(*words):
        updates.append(words[-1])
        if len(updates) == 4:
            raise KeyboardInterrupt
        return take_step(*words)

    monkeypatch.setattr(train_network, "take_step", stop_at_the_fourth)
    with pytest.raises(KeyboardInterrupt):
        train(photos, start, SETTINGS, tmp_path / "twice.onnx")
    checkpoint = tmp_path / "twice.checkpoint.pt"
    assert checkpoint.is_file() and not (tmp_path / "twice.onnx").exists()
    with pytest.raises(StepError, match="is of a run with"):
        train(photos, start, replace(SETTINGS, seed=1), tmp_path / "twice.onnx")
    train(photos, start, SETTINGS, tmp_path / "twice.onnx")
    assert updates == [0, 1, 2, 3, 2, 3, 4, 5] and not checkpoint.exists()
    assert (tmp_path / "twice.onnx").read_bytes() == (tmp_path / "whole.onnx").read_bytes()
    checkpoint.write_bytes(b"nothing")
    with pytest.raises(StepError, match="cannot be read .* delete it"):
        train(photos, start, SETTINGS, tmp_path / "twice.onnx")


def test_networks_are_compared(tmp_path, monkeypatch, capsys, inputs):
    write_network(tmp_path / "red.onnx")
    folders = [str(inputs / "rendered/mug_1/capture" / name) for name in ("images", "truth/masks")]

    def compare(*words: str) -> int:
        monkeypatch.setattr(sys, "argv", ["compare_networks.py", str(tmp_path / "red.onnx"), *words])
        return compare_networks.main()

    assert compare("--inputs", str(inputs), "--photos", "mine", *folders, "--table", str(tmp_path / "table.csv")) == 0
    table = read_table(tmp_path / "table.csv")
    assert list(table["capture"]) == ["apple_1"] * 3 + ["mine"] * 3
    assert table["overlap"].astype(float).between(0.8, 1).all()
    assert "ALL" in capsys.readouterr().out
    (inputs / "rendered/mug_1/capture/images/c.png").unlink()
    assert compare("--photos", "mine", *folders) == 1 and "belongs to c.png" in capsys.readouterr().err
    assert compare() == 1 and "nothing to compare on" in capsys.readouterr().err
