"""From pictures of an object to a coloured mesh of it: the networks one after the other."""

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
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
from zeroshop_steps.networks.trellis.settings import (
    FlowSettings,
    MeshDecoderSettings,
    SamplerSettings,
    StructureDecoderSettings,
    TrellisSettings,
)
from zeroshop_steps.networks.trellis.sparse import Pooling, SparseVoxels
from zeroshop_steps.networks.weights import load_strictly
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.runtime.progress import ProgressReport

SIZES_FILE = "settings.json"
PARTS: dict[str, type] = {
    "structure_flow": FlowSettings,
    "structure_decoder": StructureDecoderSettings,
    "latent_flow": FlowSettings,
    "mesh_decoder": MeshDecoderSettings,
    "sampler": SamplerSettings,
}

KINDS: dict[str, type[nn.Module]] = {
    "structure_flow": StructureFlow,
    "structure_decoder": StructureDecoder,
    "latent_flow": LatentFlow,
    "mesh_decoder": MeshDecoder,
}
NETWORKS = tuple(KINDS)
"""In the order of their use, each in a file of its name, .safetensors."""


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


@dataclass(frozen=True)
class Sample:
    """What the flows made of one seed: surface voxels, and (N, channels) latents of them; none where nothing came out."""

    voxels: SparseVoxels
    latents: Tensor


class Generator:
    """The networks, in single precision; each is on the device only while it is used, since together they would take twice the memory.

    Args:
        folder: structure_flow.safetensors, structure_decoder, latent_flow and mesh_decoder.
        settings: sizes.
        device: where to calculate.

    Raises:
        StepError: weights that are damaged or do not fit.
    """

    def __init__(self, folder: Path, settings: TrellisSettings, device: torch.device) -> None:
        self.folder, self.settings, self.device = folder, settings, device
        for name in NETWORKS:  # before hours are spent on the first ones
            self._read(name)
        self.mean = torch.tensor(settings.latent_mean, device=device)
        self.std = torch.tensor(settings.latent_std, device=device)
        self._decoder: nn.Module | None = None

    def _read(self, name: str) -> nn.Module:
        """A network with its weights mapped from their file."""
        with torch.device("meta"):
            network: nn.Module = KINDS[name](getattr(self.settings, name))
        load_strictly(network, self.folder / f"{name}.safetensors")
        return network.requires_grad_(False).eval()

    @contextlib.contextmanager
    def _network(self, name: str) -> Iterator[nn.Module]:
        """A network on the device, which has its memory again afterwards."""
        network = self._read(name).to(self.device, torch.float32)
        try:
            yield network
        finally:
            network.to("meta")
            if self.device.type == "cuda":
                torch.cuda.empty_cache()

    def sample(self, conditions: Sequence[Tensor], seeds: Iterable[int]) -> dict[int, Sample | None]:
        """What the flows make of each seed; None where that is nothing.

        Args:
            conditions: of `encode_pictures`, one for each picture.
            seeds: of the noise, which is drawn on the processor, so that it is the same on every device.

        Raises:
            StepError: memory ran out.
        """
        random = {seed: torch.Generator().manual_seed(seed) for seed in seeds}
        with run_network(self.device, "Trellis"):
            with self._network("structure_flow") as flow:
                states = {seed: self._sample_structure(flow, conditions, own) for seed, own in random.items()}
            with self._network("structure_decoder") as decoder:
                side = (self.settings.structure_flow.resolution,) * 3
                voxels = {seed: find_surface_voxels(decoder(state.T.unflatten(1, side)[None])) for seed, state in states.items()}
            with self._network("latent_flow") as flow:
                return {
                    seed: Sample(found, self._sample_latents(flow, conditions, found, random[seed])) if len(found.coordinates) else None
                    for seed, found in voxels.items()
                }

    def decode(self, sample: Sample | None) -> ColoredSurface:
        """A mesh in the cube from -1/2 to 1/2, z up; it has no faces where nothing came out.

        Raises:
            StepError: memory ran out.
        """
        if sample is None:
            return ColoredSurface(np.empty((0, 3)), np.empty((0, 3), np.int64), np.empty((0, 3)))
        with run_network(self.device, "Trellis"):
            if self._decoder is None:
                self._decoder = self._read("mesh_decoder").to(self.device, torch.float32)
            features, fine = self._decoder(sample.latents, sample.voxels)
            places, values = fine.coordinates.cpu().numpy(), features.float().cpu().numpy()
        # Four cubes of the mesh along an edge of a voxel of the sparse grid.
        return extract_surface(CubeFeatures.split(self.settings.mesh_decoder.resolution * 4, places, values))

    def _sample_structure(self, network: nn.Module, conditions: Sequence[Tensor], random: torch.Generator) -> Tensor:
        flow = self.settings.structure_flow
        side = (flow.resolution,) * 3
        noise = torch.randn(1, flow.channels, *side, generator=random)[0].flatten(1).T.to(self.device)
        with ProgressReport("structure (steps)", self.settings.sampler.steps) as report:
            return follow_flow(network, noise, conditions, self.settings.sampler, report.advance)

    def _sample_latents(self, network: nn.Module, conditions: Sequence[Tensor], voxels: SparseVoxels, random: torch.Generator) -> Tensor:
        noise = torch.randn(len(voxels.coordinates), self.settings.latent_flow.channels, generator=random).to(self.device)
        pooling = Pooling.of(voxels)

        def velocity(state: Tensor, time: Tensor, condition: Tensor) -> Tensor:
            moved: Tensor = network(state, voxels, pooling, time, condition)
            return moved

        with ProgressReport("latents (steps)", self.settings.sampler.steps) as report:
            state = follow_flow(velocity, noise, conditions, self.settings.sampler, report.advance)
        return state * self.std + self.mean


def sample_times(settings: SamplerSettings) -> list[float]:
    """The steps + 1 times from 1, noise, to 0, data."""
    even = torch.linspace(1, 0, settings.steps + 1, dtype=torch.float64)
    return (settings.rescale * even / (1 + (settings.rescale - 1) * even)).tolist()


def follow_flow(
    velocity: Callable[[Tensor, Tensor, Tensor], Tensor],
    noise: Tensor,
    conditions: Sequence[Tensor],
    settings: SamplerSettings,
    after_step: Callable[[], None] = lambda: None,
) -> Tensor:
    """What the noise becomes.

    Args:
        velocity: of a state, a time from 1000 to 0, and (T, width) image tokens.
        noise: the state at the start.
        conditions: the tokens of each picture; the steps take them in turns. Zeros in their place are the unguided flow.
        settings: of the steps and the guidance.
        after_step: called after each step.
    """
    times, state = sample_times(settings), noise
    low, high = settings.interval
    for index, (time, following) in enumerate(zip(times, times[1:], strict=False)):
        condition = conditions[index % len(conditions)]
        scaled = torch.tensor(1000.0 * time, dtype=torch.float32, device=state.device)
        speed = velocity(state, scaled, condition)
        if low <= time <= high:
            unguided = velocity(state, scaled, torch.zeros_like(condition))
            speed = (1 + settings.guidance) * speed - settings.guidance * unguided
        state = state - (time - following) * speed
        after_step()
    return state
