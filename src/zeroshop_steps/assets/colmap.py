"""Photos, masks, cameras and points as COLMAP's tools and 3D Gaussian splatting read them, in the mesh's frame and metres.

`images/`, `sparse/0/` (binary), and `masks/IMAGE.png`, which is COLMAP's name for the mask of an image. The photos are undistorted and
the cameras are PINHOLE.
"""

import argparse
import shutil
import sys
from pathlib import Path

import pycolmap

from zeroshop_steps.assets.object_frame import read_object_from_registration
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.cameras.sparse_files import read_reconstruction, write_reconstruction
from zeroshop_steps.geometry.meshes.metric_mesh import add_mesh_arguments
from zeroshop_steps.runtime.files import atomic_directory


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_mesh_arguments(parser)
    parser.add_argument("--cameras", type=Path, required=True, help="the registration's cameras, images and masks")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")


def run(args: argparse.Namespace) -> None:
    """Write one folder."""
    similarity = read_object_from_registration(args.mesh, args.unknown_scale)
    views, _ = read_views(args.cameras)
    model = read_reconstruction(args.cameras / "sparse")
    model.transform(pycolmap.Sim3d(similarity[:3]))
    with atomic_directory(args.out) as folder:
        for name in ("images", "masks"):
            (folder / name).mkdir()
        for view in views:
            shutil.copyfile(view.image_path, folder / "images" / view.camera.name)
            if view.mask_path is not None:
                shutil.copyfile(view.mask_path, folder / "masks" / f"{view.camera.name}.png")
        write_reconstruction(model, folder / "sparse" / "0")
    print(f"colmap: {len(views)} photos in {args.out}", file=sys.stderr)
