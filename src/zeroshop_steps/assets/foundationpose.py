"""The mesh as FoundationPose reads it: textured OBJ in metres, centred.

`mesh/textured_simple.obj` lies where its demo looks for it. The frame is that of the finished mesh, whose origin is the centre of the
bounding box, so the poses that FoundationPose estimates are those of `NVS.ply`, in metres.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from zeroshop_steps.assets.body_files import FRAME_TEXT, GENERATED_FRAME_TEXT, write_textured_obj
from zeroshop_steps.geometry.meshes.metric_mesh import add_mesh_arguments, read_metric_mesh
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_directory, write_json

MESH = "textured_simple.obj"
LARGEST_OFFSET = 0.01  # of the size, between the origin and the centre of the bounding box


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_mesh_arguments(parser)
    parser.add_argument("--out", type=Path, required=True, help="folder to write")


def run(args: argparse.Namespace) -> None:
    """Write one folder."""
    metric = read_metric_mesh(args.mesh, args.unknown_scale)
    low, high = metric.mesh.vertices.min(0), metric.mesh.vertices.max(0)
    if np.abs(low + high).max() / 2 > LARGEST_OFFSET * np.linalg.norm(high - low):
        raise StepError(f"{args.mesh} is not centred: its bounding box has its centre at {(low + high) / 2} m; export it again")
    with atomic_directory(args.out) as folder:
        (folder / "mesh").mkdir()
        write_textured_obj(folder / "mesh", metric.mesh, MESH)
        facts = {
            "mesh": f"mesh/{MESH}",
            "unit": "metre",
            "frame": GENERATED_FRAME_TEXT if metric.generated else FRAME_TEXT,
            "scale": metric.scale,
            "scale_source": metric.scale_source,
            "generated": metric.generated,
        }
        write_json(folder / "mesh.json", facts | {"diameter_m": float(np.linalg.norm(high - low)), "extents_m": (high - low).tolist()})
    print(f"foundationpose: {args.out}/mesh/{MESH}, {' x '.join(f'{extent:.3f}' for extent in high - low)} m", file=sys.stderr)
