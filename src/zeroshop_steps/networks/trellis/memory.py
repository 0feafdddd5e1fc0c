"""How much memory the networks will take, said before they start."""

import torch

from zeroshop_steps.networks.devices import MemoryNeeds
from zeroshop_steps.networks.trellis.decoders import MeshDecoder, StructureDecoder
from zeroshop_steps.networks.trellis.flows import LatentFlow, StructureFlow
from zeroshop_steps.networks.trellis.settings import TrellisSettings

VALUE_BYTES = 4
BASE_BYTES = 700_000_000  # Python, PyTorch and the libraries that compare with the photos
SURFACE_SHARE = 0.125
"""Of the coarse grid, the most voxels that are surface: 32,768 of 64^3, the most that the networks were trained with."""
DECODED_WIDTHS = 4.0
"""Values alive at once for each fine voxel, as a multiple of the channels before the last subdivision. Measured with 8,448
voxels: 3.4, the extraction of the mesh included."""


def predict_memory(settings: TrellisSettings) -> MemoryNeeds:
    """What a run takes at its peak, which is in the mesh decoder."""
    with torch.device("meta"):
        networks = (
            StructureFlow(settings.structure_flow),
            StructureDecoder(settings.structure_decoder),
            LatentFlow(settings.latent_flow),
            MeshDecoder(settings.mesh_decoder),
        )
    parameters = sum(parameter.numel() for network in networks for parameter in network.parameters())
    voxels = SURFACE_SHARE * settings.mesh_decoder.resolution**3
    values = 64 * voxels * DECODED_WIDTHS * (settings.mesh_decoder.width // 4)
    peak = BASE_BYTES + int(VALUE_BYTES * (parameters + values))
    instead = "run less beside it, use --device cpu on a machine with more memory, or the surface methods 2dgs or svraster"
    return MemoryNeeds(peak, f"Trellis with {parameters / 1e9:.2f} billion parameters", instead)
