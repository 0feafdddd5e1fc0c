"""How much memory the networks will take, said before they start."""

import torch

from zeroshop_steps.networks.devices import PROCESS_BYTES, MemoryNeeds
from zeroshop_steps.networks.trellis.decoders import MeshDecoder, StructureDecoder
from zeroshop_steps.networks.trellis.flows import LatentFlow, StructureFlow
from zeroshop_steps.networks.trellis.settings import TrellisSettings

SURFACE_SHARE = 0.125
"""Of the coarse grid, the most voxels that are surface: 32,768 of 64^3, the most that the networks were trained with."""
DECODED_WIDTHS = 4.0
"""Values alive at once for each fine voxel, as a multiple of the channels before the last subdivision. Measured with 8,448
voxels: 3.4, the extraction of the mesh included."""


BLOCK_WIDTHS = 24.0
"""Values alive at once for each token of a flow, as a multiple of its width: keys, queries, values, the hidden layer and its input."""


def predict_memory(settings: TrellisSettings) -> MemoryNeeds:
    """What a run takes at its peak, with one network on the device at a time."""
    with torch.device("meta"):
        networks = {
            "structure_flow": StructureFlow(settings.structure_flow),
            "structure_decoder": StructureDecoder(settings.structure_decoder),
            "latent_flow": LatentFlow(settings.latent_flow),
            "mesh_decoder": MeshDecoder(settings.mesh_decoder),
        }
    voxels = SURFACE_SHARE * settings.mesh_decoder.resolution**3
    values = {
        "structure_flow": settings.structure_flow.resolution**3 * settings.structure_flow.width * BLOCK_WIDTHS,
        "structure_decoder": 64 * settings.structure_flow.resolution**3 * settings.structure_decoder.channels[-1] * DECODED_WIDTHS,
        "latent_flow": voxels * settings.latent_flow.width * BLOCK_WIDTHS,
        "mesh_decoder": 64 * voxels * DECODED_WIDTHS * (settings.mesh_decoder.width // 4),
    }
    counts = {name: sum(parameter.numel() for parameter in network.parameters()) for name, network in networks.items()}
    largest = max(networks, key=lambda name: counts[name] + values[name])
    peak = PROCESS_BYTES + int(torch.float32.itemsize * (counts[largest] + values[largest]))
    instead = "run less beside it, use --device cpu on a machine with more memory, or the surface methods 2dgs or svraster"
    return MemoryNeeds(peak, f"Trellis, whose largest part is its {largest.replace('_', ' ')},", instead)
