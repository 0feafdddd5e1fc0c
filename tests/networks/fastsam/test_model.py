"""FastSAM's network is YOLOv8x-seg (../../parity/README.md), and its published checkpoint is read without running anything in it."""

import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from helpers.fastsam_cases import LEAST_LIKELIHOOD, MOST, MOST_IOU, SIZE_PX, SMALL, image, parameters
from helpers.paths import PARITY
from helpers.seeded import relative_error
from zeroshop_steps.networks.fastsam.masks import choose_candidates, fit_image, mix_masks, propose_masks
from zeroshop_steps.networks.fastsam.model import BoxCandidates, FastSam, load_fastsam
from zeroshop_steps.runtime.errors import StepError

TOLERANCE = 1e-4


@pytest.fixture(scope="module")
def recorded():
    with np.load(PARITY / "fastsam.npz") as file:
        return {name: torch.from_numpy(file[name]) for name in file.files}


def shapes_of(network):
    return {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}


@pytest.fixture(scope="module")
def network():
    network = FastSam(SMALL)
    network.load_state_dict(parameters(shapes_of(network)), strict=False)
    return network.eval().requires_grad_(False)


def test_the_published_size_has_the_names_and_shapes_of_the_checkpoint():
    with torch.device("meta"):
        network = FastSam()
    lines = [line.partition(" ") for line in (PARITY / "fastsam_parameters.txt").read_text().splitlines()]
    assert shapes_of(network) == {name: tuple(map(int, sides.split("x"))) if sides else () for name, _, sides in lines}


def test_boxes_prototypes_and_masks_agree_with_the_reference(network, recorded):
    (found,) = network(image())
    answers = torch.cat([found.boxes, found.likelihoods[:, None], found.mixtures], 1)
    assert relative_error(answers, recorded["answers"]) < TOLERANCE
    assert relative_error(found.prototypes, recorded["prototypes"]) < TOLERANCE
    kept = choose_candidates(found, LEAST_LIKELIHOOD, MOST_IOU, MOST)
    assert 5 < len(kept.boxes) < (found.likelihoods > LEAST_LIKELIHOOD).sum(), "some are doubles"
    assert relative_error(kept.boxes, recorded["kept"][:, :4]) < TOLERANCE
    masks = mix_masks(kept, SIZE_PX)
    assert (masks != recorded["masks"]).float().mean() < 1e-4 and 0.05 < masks.float().mean() < 0.9


def test_photos_are_fitted_and_masks_come_back_in_their_size(network):
    photo = np.random.default_rng(0).integers(0, 256, (75, 100, 3), np.uint8)
    fitted, inner = fit_image(photo, 64)
    assert fitted.shape == (64, 64, 3) and inner == (slice(8, 56), slice(0, 64))
    assert (fitted[:8] == 114).all() and (fitted[56:] == 114).all()
    masks = propose_masks(network, photo, torch.device("cpu"), 64, 0.3, 0.9, 10)
    assert 0 < len(masks) <= 10 and all(mask.shape == (75, 100) and mask.any() for mask in masks)


def test_doubles_and_unlikely_boxes_go_and_no_more_than_asked_for_stay():
    boxes = torch.tensor([[0.0, 0, 10, 10], [0, 0, 10, 9.5], [20, 0, 30, 10], [40, 0, 50, 10], [60, 0, 70, 10]])
    found = BoxCandidates(boxes, torch.tensor([0.5, 0.9, 0.8, 0.01, 0.3]), torch.zeros(5, 32), torch.zeros(32, 4, 4))
    assert choose_candidates(found, 0.05, 0.9, 200).likelihoods.tolist() == pytest.approx([0.9, 0.8, 0.3])
    assert choose_candidates(found, 0.05, 0.9, 2).likelihoods.tolist() == pytest.approx([0.9, 0.8])


class Trap:
    """Writes a file when a pickle of it is read in the usual way."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def pickle_module(network: FastSam, path: Path, trap: Path) -> None:
    """The network as a whole module in half precision, as the publisher saved it, with a trap beside it and one inside."""
    whole = FastSam(SMALL)
    whole.load_state_dict(network.state_dict())
    whole.model["0"].conv.hook = Trap(trap)
    torch.save({"epoch": -1, "model": whole.half(), "ema": None, "train_args": Trap(trap)}, path)


def test_a_pickled_network_is_read_and_nothing_in_it_is_run(network, tmp_path):
    path, trap = tmp_path / "whole.pt", tmp_path / "trapped"
    pickle_module(network, path, trap)
    loaded = load_fastsam(path, SMALL)
    assert not trap.exists()
    for name, tensor in network.state_dict().items():
        torch.testing.assert_close(loaded.state_dict()[name], tensor, atol=1e-3, rtol=1e-3)
    torch.load(path, weights_only=False)
    assert trap.exists(), "the trap works"


def test_damaged_files_and_other_networks_are_refused(network, tmp_path):
    path = tmp_path / "whole.pt"
    pickle_module(network, path, tmp_path / "trapped")
    with pytest.raises(StepError, match="does not fit FastSam.*missing"):
        load_fastsam(path)
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(StepError, match="no whole checkpoint"):
        load_fastsam(path, SMALL)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("whole/data.pkl", pickle.dumps({"weights": 3}))
    with pytest.raises(StepError, match="holds no network"):
        load_fastsam(path, SMALL)
    with pytest.raises(StepError, match="do not exist"):
        load_fastsam(tmp_path / "none.pt", SMALL)
