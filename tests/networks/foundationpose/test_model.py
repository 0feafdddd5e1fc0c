"""Our networks answer as the published ones do: same parameters, same inputs (../../parity/README.md)."""

import numpy as np
import pytest
import torch

from helpers.foundationpose_cases import SMALL, lines, pairs, parameters
from helpers.paths import PARITY
from helpers.seeded import relative_error
from zeroshop_steps.networks.foundationpose.model import RefineNet, ScoreNet, load_network
from zeroshop_steps.networks.foundationpose.settings import FoundationPoseSettings
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import write_json

TOLERANCE = 1e-4
KINDS = {"refiner": RefineNet, "scorer": ScoreNet}


def small(kind):
    network = kind(FoundationPoseSettings(**SMALL))
    network.load_state_dict(parameters(network.state_dict()))
    return network.eval()


@pytest.fixture(scope="module")
def recorded() -> dict[str, torch.Tensor]:
    with np.load(PARITY / "foundationpose.npz") as values:
        return {name: torch.from_numpy(values[name]) for name in values}


def assert_same(ours: torch.Tensor, theirs: torch.Tensor) -> None:
    assert ours.shape == theirs.shape and theirs.std() > 1e-3
    assert relative_error(ours, theirs) < TOLERANCE


@pytest.mark.parametrize("name", KINDS)
def test_full_size_has_the_names_and_shapes_of_the_checkpoint(name):
    with torch.device("meta"):
        network = KINDS[name]()
    expected = (PARITY / f"foundationpose_{name}_parameters.txt").read_text().splitlines()
    assert sorted(lines(network.state_dict())) == sorted(expected)


@torch.inference_mode()
def test_the_refiner_answers_as_the_published_one(recorded):
    network = small(RefineNet)
    rendered, observed = pairs()
    image = network.encodeA(rendered)
    assert_same(image, recorded["image_encoder"])
    pair = network.encodeAB(torch.cat([image, network.encodeA(observed)], dim=1))
    assert_same(pair, recorded["pair_encoder"])
    assert_same(network.pos_embed.pe, recorded["positions"])
    assert_same(network.rot_head[0](network.pos_embed(pair.flatten(2).transpose(1, 2))), recorded["transformer_block"])
    translation, turn = network(rendered, observed)
    assert_same(translation, recorded["translation"])
    assert_same(turn, recorded["turn"])


@torch.inference_mode()
def test_the_scorer_answers_as_the_published_one_and_in_parts_as_at_once(recorded):
    network = small(ScoreNet)
    rendered, observed = pairs()
    assert_same(network.describe(rendered, observed), recorded["description"])
    assert_same(network(rendered, observed), recorded["scores"])
    assert_same(network(rendered[:3], observed[:3]), recorded["scores_of_three"])
    parts = torch.cat([network.describe(rendered[:2], observed[:2]), network.describe(rendered[2:], observed[2:])])
    assert_same(network.rank(parts), recorded["scores"])


def test_scores_depend_on_the_poses_that_they_are_compared_with(recorded):
    assert (recorded["scores"][:3] - recorded["scores_of_three"]).abs().max() > 1e-3


def test_weights_are_loaded_whole_or_not_at_all(tmp_path):
    path = tmp_path / "model_best.pth"
    state = small(RefineNet).state_dict()
    torch.save({"model": state, "epoch": 7}, path)
    write_json(tmp_path / "model_best.settings.json", SMALL)
    rendered, observed = pairs(2)
    with torch.inference_mode():
        found = load_network(RefineNet, path, torch.device("cpu"))(rendered, observed)
        torch.testing.assert_close(found, small(RefineNet)(rendered, observed))
    with pytest.raises(StepError, match=r"does not fit ScoreNet.*missing \(encoderA"):
        load_network(ScoreNet, path, torch.device("cpu"))
    (tmp_path / "model_best.settings.json").unlink()
    with pytest.raises(StepError, match=r"of another shape \(encodeA.0.net.0.weight \(8, 6, 7, 7\) instead of \(64, 6, 7, 7\)"):
        load_network(RefineNet, path, torch.device("cpu"))
    write_json(tmp_path / "model_best.settings.json", {"depth": 3})
    with pytest.raises(StepError, match="has no FoundationPoseSettings"):
        load_network(RefineNet, path, torch.device("cpu"))
