"""MASt3R is the published network: same parameters, same outputs (../../parity/README.md)."""

import numpy as np
import pytest
import torch

from helpers.mast3r_cases import SMALL, images, parameters, unfolded
from helpers.paths import PARITY
from helpers.seeded import relative_error, seeded_tensor
from zeroshop_steps.networks.mast3r.model import MASt3R, Mast3rSettings, count_patches, load_mast3r, rotate_by_place
from zeroshop_steps.networks.weights import read_table
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import write_json

TOLERANCE = 1e-4


@pytest.fixture(scope="module")
def recorded():
    with np.load(PARITY / "mast3r.npz") as file:
        return {name: torch.from_numpy(file[name]) for name in file.files}


def shapes_of(network):
    return {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}


@pytest.fixture(scope="module")
def network():
    network = MASt3R(Mast3rSettings(**SMALL))
    network.load_state_dict(parameters(shapes_of(network)))
    return network.eval().requires_grad_(False)


@pytest.fixture(scope="module")
def encoded(network):
    return [(network.encode(image), count_patches(image)) for image in images()]


def test_the_published_size_has_the_names_and_shapes_of_the_checkpoint():
    with torch.device("meta"):
        network = MASt3R()
    expected = unfolded((PARITY / "mast3r_parameters.txt").read_text().splitlines())
    assert shapes_of(network) == expected
    parameter_bytes = 4 * sum(parameter.numel() for parameter in network.parameters())
    checkpoint = next(row for name, row in read_table().items() if name.startswith("MASt3R"))
    assert 0 < checkpoint.size_bytes - parameter_bytes < 1e6, "the published file holds these parameters and little besides"


def test_modules_agree_with_the_reference(network, encoded, recorded):
    (first, grid), (second, other_grid) = encoded
    rotation, other_rotation = (rotate_by_place(size, 16) for size in (grid, other_grid))
    layers, other_layers = network.decode(first, second, grid, other_grid)
    head = network.downstream_head1
    found = {
        "rotary": rotate_by_place(grid, 32)(seeded_tensor("queries", (1, 2, first.shape[1], 32))),
        "patches": network.patch_embed(images()[0]),
        "encoder": first,
        "encoder_block": network.enc_blocks[0](first, rotate_by_place(grid, 32)),
        "decoder_block": network.dec_blocks[0](layers[-1], other_layers[-1], rotation, other_rotation),
        "decoder0": torch.cat([layers[5], layers[-1]]),
        "decoder1": torch.cat([other_layers[5], other_layers[-1]]),
        "dense_head": head.dpt([layers[index] for index in head.layers], *grid),
        "local_head": head.head_local_features(torch.cat([layers[0], layers[-1]], dim=-1)),
    }
    errors = {name: relative_error(tensor, recorded[name]) for name, tensor in found.items()}
    assert max(errors.values()) < TOLERANCE, errors


def test_the_whole_network_agrees_with_the_reference(network, recorded):
    outputs = network(*images())
    for side, output in enumerate(outputs):
        for name in ("points", "confidence", "descriptors", "descriptor_confidence"):
            assert relative_error(getattr(output, name), recorded[f"{name}{side}"]) < TOLERANCE, (name, side)


def test_a_batch_is_its_pairs_one_by_one(network):
    first = seeded_tensor("batch", (2, 3, 32, 32)).clamp(-1, 1)
    second = first.flip(3)
    together = network(first, second)
    alone = network(first[1:], second[1:])
    for side in (0, 1):
        assert relative_error(together[side].points[1:], alone[side].points) < TOLERANCE


def test_a_configuration_beside_the_weights_is_taken(network, tmp_path):
    path = tmp_path / "small.pth"
    torch.save(network.state_dict(), path)
    with pytest.raises(StepError, match="does not fit MASt3R.*missing.*of another shape"):
        load_mast3r(path)
    write_json(tmp_path / "small.json", SMALL)
    loaded = load_mast3r(path)
    assert torch.equal(loaded.dec_norm.weight, network.dec_norm.weight)
    assert torch.equal(loaded.encode(images()[0]), network.encode(images()[0]))
    write_json(tmp_path / "small.json", {"depth": 3})
    with pytest.raises(StepError, match="no configuration of MASt3R"):
        load_mast3r(path)
