"""Trellis (Xiang et al. 2025): a mesh that a generative network makes of two photos, fitted to all of them.

Two views from opposite sides, about 45 degrees above the object, go into the network, without their cameras. Of several meshes, each
from noise of its own, the one whose outlines and colours fit the photos best is kept. A similarity brings it into the registration's
frame. It is a likely shape, not a measured one: where no photo looks, all of it is a guess. The weights, 2.7 GB (MIT) and 1.2 GB of
DINOv2 (Apache-2.0), must be there. Without cameras (registration none), the mesh is as high as the user says.
"""

import argparse
from pathlib import Path
from typing import Any

from zeroshop_steps.networks.devices import DEVICES
from zeroshop_steps.networks.trellis.settings import SamplerSettings

METHOD: dict[str, Any] = {
    "title": "Trellis",
    "rank": 2,
    "stereo": False,
    "generated": True,
    "cameras_optional": True,
    "models": {
        "networks": (
            "trellis",
            ("structure_flow.safetensors", "structure_decoder.safetensors", "latent_flow.safetensors", "mesh_decoder.safetensors"),
        ),
        "encoder": ("dinov2-with-registers-large", ("config.json", "model.safetensors")),
    },
    "mem_mb": 10000,
    "runtime_min": 720,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--cameras", type=Path, help="folder of a registration, with images and masks")
    parser.add_argument("--capture", type=Path, help="in place of it, photos with masks whose cameras are not known")
    parser.add_argument("--height-m", type=float, help="height of the object in metres, where cameras are not known")
    parser.add_argument("--generations", type=int, default=6, help="meshes of which the best is kept (default: %(default)s)")
    usual = SamplerSettings()
    parser.add_argument("--steps", type=int, default=usual.steps, help="of each flow from noise to data (default: %(default)s)")
    parser.add_argument(
        "--guidance", type=float, default=usual.guidance, help="how strongly the photos steer the flows (default: %(default)s)"
    )
    names = {key: folder for key, (folder, _) in METHOD["models"].items()}
    parser.add_argument(
        "--networks", default=names["networks"], help="folder of the networks below resources/weights (default: %(default)s)"
    )
    parser.add_argument("--encoder", default=names["encoder"], help="folder of DINOv2 below resources/weights (default: %(default)s)")
    parser.add_argument("--device", choices=DEVICES, default="auto", help="where the networks run (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the first mesh; each has the next one (default: %(default)s)")
    parser.add_argument("--threads", type=int, default=1, help="default: %(default)s")
    parser.add_argument("--out", type=Path, required=True, help="raw mesh with colours, PLY in the registration's frame")


def run(args: argparse.Namespace) -> None:
    """Write the raw mesh."""
    from zeroshop_steps.surface.trellis.reconstruct import reconstruct

    reconstruct(args, {key: files for key, (_, files) in METHOD["models"].items()})
