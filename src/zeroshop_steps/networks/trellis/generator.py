"""From pictures of an object to a coloured mesh of it: the networks one after the other."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from zeroshop_steps.networks.devices import run_network
from zeroshop_steps.networks.trellis.conditioning import ImageEncoder
from zeroshop_steps.networks.trellis.decoders import MeshDecoder, StructureDecoder, find_surface_voxels
from zeroshop_steps.networks.trellis.flexible_surface import ColoredSurface, CubeFeatures, extract_surface
from zeroshop_steps.networks.trellis.flows import LatentFlow, StructureFlow
from zeroshop_steps.networks.trellis.sampler import follow_flow
from zeroshop_steps.networks.trellis.settings import (
    FlowSettings,
    MeshDecoderSettings,
    SamplerSettings,
    StructureDecoderSettings,
    TrellisSettings,
)
from zeroshop_steps.networks.trellis.sparse import Pooling, Voxels
from zeroshop_steps.networks.weights import load_strictly
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.runtime.progress import ProgressReport

SIZES_FILE = "settings.json"
FINER = 4
"""Cubes of the mesh along an edge of a voxel of the sparse structure."""
PARTS: dict[str, type] = {
    "structure_flow": FlowSettings,
    "structure_decoder": StructureDecoderSettings,
    "latent_flow": FlowSettings,
    "mesh_decoder": MeshDecoderSettings,
    "sampler": SamplerSettings,
}

NETWORKS = ("structure_flow", "structure_decoder", "latent_flow", "mesh_decoder")
"""Each in a file of its name, .safetensors."""


def read_settings(folder: Path) -> TrellisSettings:
    """The sizes of the networks: those that were published, or those in settings.json beside the weights."""
    path = folder / SIZES_FILE
    if not path.is_file():
        return TrellisSettings()
    try:
        values: dict[str, Any] = {key: _as_settings(key, value) for key, value in read_json(path).items()}
        return TrellisSettings(**values)
    except TypeError as error:
        raise StepError(f"{path} does not fit the networks ({error}); delete it to use the published sizes") from None


def _as_settings(key: str, value: Any) -> Any:
    if key in PARTS:
        return PARTS[key](**{name: tuple(part) if isinstance(part, list) else part for name, part in value.items()})
    return tuple(value) if isinstance(value, list) else value


def encode_pictures(folder: Path, pictures: Sequence[np.ndarray], device: torch.device) -> list[Tensor]:
    """The tokens of each of some pictures, `conditioning.frame_object`'s, by DINOv2 from its folder."""
    with run_network(device, "DINOv2"):
        encoder = ImageEncoder(folder, device)
        return [encoder(picture) for picture in pictures]


class Generator:
    """The networks with their weights on a device, in single precision.

    Args:
        folder: structure_flow.safetensors, structure_decoder, latent_flow and mesh_decoder.
        settings: sizes.
        device: where to calculate.
    """

    def __init__(self, folder: Path, settings: TrellisSettings, device: torch.device) -> None:
        self.settings, self.device = settings, device
        with torch.device("meta"):
            networks = StructureFlow, StructureDecoder, LatentFlow, MeshDecoder
            made = [network(getattr(settings, name)) for network, name in zip(networks, NETWORKS, strict=True)]
        with run_network(device, "Trellis"):
            self.structure_flow, self.structure_decoder, self.latent_flow, self.mesh_decoder = (
                self._load(network, folder / f"{name}.safetensors") for network, name in zip(made, NETWORKS, strict=True)
            )
        self.mean = torch.tensor(settings.latent_mean, device=device)
        self.std = torch.tensor(settings.latent_std, device=device)

    def _load(self, network: nn.Module, path: Path) -> nn.Module:
        load_strictly(network, path)
        return network.requires_grad_(False).eval().to(self.device, torch.float32)

    def generate(self, conditions: Sequence[Tensor], seed: int) -> ColoredSurface:
        """A mesh in the cube from -1/2 to 1/2, z up; it has no faces where nothing came out.

        Args:
            conditions: of `encode_pictures`, one for each picture.
            seed: of the noise, which is drawn on the processor, so that it is the same on every device.

        Raises:
            StepError: memory ran out.
        """
        random = torch.Generator().manual_seed(seed)
        with run_network(self.device, "Trellis"):
            voxels = self._sample_structure(conditions, random)
            if len(voxels.coordinates) == 0:
                return ColoredSurface(np.empty((0, 3)), np.empty((0, 3), np.int64), np.empty((0, 3)))
            latents = self._sample_latents(conditions, voxels, random)
            features, fine = self.mesh_decoder(latents, voxels)
            places, values = fine.coordinates.cpu().numpy(), features.float().cpu().numpy()
        return extract_surface(CubeFeatures.split(self.settings.mesh_decoder.resolution * FINER, places, values))

    def _sample_structure(self, conditions: Sequence[Tensor], random: torch.Generator) -> Voxels:
        flow = self.settings.structure_flow
        side = (flow.resolution,) * 3
        noise = torch.randn(1, flow.channels, *side, generator=random)[0].flatten(1).T.to(self.device)
        with ProgressReport("structure (steps)", self.settings.sampler.steps) as report:
            state = follow_flow(self.structure_flow, noise, conditions, self.settings.sampler, report.advance)
        return find_surface_voxels(self.structure_decoder(state.T.unflatten(1, side)[None]))

    def _sample_latents(self, conditions: Sequence[Tensor], voxels: Voxels, random: torch.Generator) -> Tensor:
        noise = torch.randn(len(voxels.coordinates), self.settings.latent_flow.channels, generator=random).to(self.device)
        pooling = Pooling.of(voxels)

        def velocity(state: Tensor, time: Tensor, condition: Tensor) -> Tensor:
            return self.latent_flow(state, voxels, pooling, time, condition)

        with ProgressReport("latents (steps)", self.settings.sampler.steps) as report:
            state = follow_flow(velocity, noise, conditions, self.settings.sampler, report.advance)
        return state * self.std + self.mean
