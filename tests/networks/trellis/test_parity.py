"""Our TRELLIS answers as the published one does: same parameters, same inputs, outputs within 1e-4 (../../parity/README.md)."""

import re

import numpy as np
import pytest
import torch

from helpers.named_parameters import fill, noise
from helpers.paths import PARITY
from helpers.small_trellis import SMALL, make_networks
from zeroshop_steps.networks.trellis.decoders import find_surface_voxels
from zeroshop_steps.networks.trellis.generator import follow_flow
from zeroshop_steps.networks.trellis.settings import TrellisSettings
from zeroshop_steps.networks.trellis.sparse import Pooling, SparseVoxels
from zeroshop_steps.networks.weights import look_up_weights

TOLERANCE = 1e-4
KEPT_ROWS = 97


@pytest.fixture(scope="module")
def networks():
    with torch.inference_mode():
        yield {name: fill(network) for name, network in make_networks(SMALL).items()}


@pytest.fixture(scope="module")
def recorded():
    with np.load(PARITY / "trellis.npz") as values:
        return {key: torch.from_numpy(values[key]) for key in values}


def inputs(name: str, *shape: int) -> torch.Tensor:
    return torch.from_numpy(noise(name, shape))


@pytest.fixture(scope="module")
def tokens():
    return inputs("tokens", 2, 7, SMALL.structure_flow.condition_width)


@pytest.fixture(scope="module")
def grid():
    return inputs("grid", 1, SMALL.structure_flow.channels, *(SMALL.structure_flow.resolution,) * 3)


def error(ours: torch.Tensor, theirs: torch.Tensor) -> float:
    """Relative to the size of all values together: single ones may be near zero."""
    assert ours.shape == theirs.shape and ours.isfinite().all() and theirs.std() > 1e-3
    return float((ours - theirs).norm() / theirs.norm())


def as_rows(grid: torch.Tensor) -> torch.Tensor:
    """(R^3, channels) places of a dense (1, channels, R, R, R) grid."""
    return grid[0].flatten(1).T


def test_full_size_has_the_names_shapes_and_file_sizes_of_the_checkpoints():
    with torch.device("meta"):
        networks = make_networks(TrellisSettings())
    lines, elements = {}, {}
    for line in (PARITY / "trellis_parameters.txt").read_text().splitlines():
        count, name, shape, size = line.split()
        lines[f"{name} {shape}"] = int(count)
        elements[name] = int(size)
    found: dict[str, int] = {}
    for part, network in networks.items():
        tensors = 0
        for name, value in network.state_dict().items():
            folded = f"{part}.{name if part == 'structure_decoder' else re.sub(r'^blocks[.][0-9]+[.]', 'blocks.*.', name)}"
            line = f"{folded} {'x'.join(map(str, value.shape))}"
            found[line] = found.get(line, 0) + 1
            tensors += value.numel() * elements[folded]
        published = look_up_weights(f"trellis/{part}.safetensors").size_bytes
        assert 0 < published - tensors < 100_000, (part, published - tensors)  # the header of the file
    assert found == lines
    assert sum(p.numel() for network in networks.values() for p in network.parameters()) == 1_320_573_974


def test_structure_flow(networks, recorded, tokens, grid):
    found = networks["structure_flow"](as_rows(grid), torch.tensor(612.5), tokens[0])
    assert error(found, as_rows(recorded["structure_velocity"])) < TOLERANCE


def test_structure_decoder(networks, recorded, grid):
    assert error(networks["structure_decoder"](grid), recorded["logits"]) < TOLERANCE


def test_latent_flow(networks, recorded, tokens):
    voxels = SparseVoxels(recorded["places"].long())
    latents = inputs("latents", len(voxels.coordinates), SMALL.latent_flow.channels)
    found = networks["latent_flow"](latents, voxels, Pooling.of(voxels), torch.tensor(612.5), tokens[0])
    assert error(found, recorded["latent_velocity"]) < TOLERANCE


@pytest.mark.parametrize("chunk_values", [5000, 1 << 25])
def test_mesh_decoder_however_much_goes_together(networks, recorded, monkeypatch, chunk_values):
    monkeypatch.setattr("zeroshop_steps.networks.trellis.sparse.CHUNK_VALUES", chunk_values)
    voxels = SparseVoxels(recorded["places"].long())
    latents = inputs("latents", len(voxels.coordinates), SMALL.latent_flow.channels)
    features, fine = networks["mesh_decoder"](latents, voxels)
    assert len(features) == len(fine.coordinates) == 64 * len(latents)
    assert error(features[::KEPT_ROWS], recorded["features"]) < TOLERANCE


def test_whole(networks, recorded, tokens, grid):
    flow, decoder = networks["latent_flow"], networks["mesh_decoder"]
    structure = follow_flow(networks["structure_flow"], as_rows(grid), list(tokens), SMALL.sampler)
    assert error(structure, as_rows(recorded["whole_structure"])) < TOLERANCE
    voxels = find_surface_voxels(networks["structure_decoder"](structure.T.unflatten(1, grid.shape[2:])[None]))
    assert torch.equal(voxels.coordinates, recorded["whole_places"].long())
    pooling = Pooling.of(voxels)
    noise = inputs("noise", len(voxels.coordinates), SMALL.latent_flow.channels)
    state = follow_flow(lambda x, time, tokens: flow(x, voxels, pooling, time, tokens), noise, list(tokens), SMALL.sampler)
    latents = state * torch.tensor(SMALL.latent_std) + torch.tensor(SMALL.latent_mean)
    assert error(latents, recorded["whole_latents"]) < TOLERANCE
    assert error(decoder(latents, voxels)[0][::KEPT_ROWS], recorded["whole_features"]) < TOLERANCE
