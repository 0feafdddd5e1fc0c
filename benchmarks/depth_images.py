"""Depth images of a rendered capture, as a depth camera with a structured-light sensor's errors takes them, in whole millimetres.

`python benchmarks/depth_images.py --capture results/ycbv/obj_000021/su_h/capture --model results/ycbv/obj_000021/model/model.ply --out OUT`
"""

import argparse
from pathlib import Path

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.runtime.open3d_loader import ray_caster
from zeroshop_steps.synthetic.rendering.depth_sensor import take_depth_image
from zeroshop_steps.synthetic.scenes.scene_meshes import make_object_mesh, make_surface_mesh
from zeroshop_steps.synthetic.virtual_capture import read_object

NOISE_MM = 0.5
"""Standard deviation of what is added: rendered objects stand nearer than such cameras measure, where the sensor's own noise is small."""


def main() -> None:
    """Write a depth image for each true camera of the capture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--capture", type=Path, required=True, help="rendered capture with truth/")
    parser.add_argument("--model", type=Path, required=True, help="the model that was rendered")
    parser.add_argument("--out", type=Path, required=True, help="folder of the depth images")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    facts = read_json(args.capture / "capture.json")
    mesh, bounds, _ = read_object(args.model, facts["width_px"], facts["height_px"], facts["seed"])
    parts = (make_object_mesh(mesh), make_surface_mesh(facts["scene"], bounds, facts["seed"], None))
    scene = ray_caster(*((part.vertices, part.faces) for part in parts if part is not None))
    for number, camera in enumerate(read_sparse_model(args.capture / "truth").cameras):
        rng = np.random.default_rng([args.seed, number])
        _, measured = take_depth_image(scene, camera, rng)
        measured = np.where(measured > 0, measured + rng.normal(0.0, NOISE_MM, measured.shape), 0.0)
        write_image(args.out / f"{Path(camera.name).stem}.png", np.rint(measured).astype(np.uint16))


if __name__ == "__main__":
    main()
