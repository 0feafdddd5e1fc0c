"""Heights by MASt3R's alignment of a rendered object, with stand-ins for the network: the truth with noise.

    PYTHONPATH=tests python tests/helpers/stand_in_heights.py --object results/demo/mug [--nvs 2dgs --scale-noise 0.05]

Two photos of the object and four of the empty scene, as in the thesis. What the network would say of a pair is made from true depth and
cameras; only what it has learned is left out. So this tries the way from pairs to a height, not the network.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np

from helpers.made_pairs import MadePairs, Noise
from zeroshop_steps.geometry.cameras.pinhole import Camera, read_sparse_model
from zeroshop_steps.geometry.imaging.images import decode_image, list_images
from zeroshop_steps.height import mast3r, record
from zeroshop_steps.height.mast3r import _take_evenly
from zeroshop_steps.runtime.files import read_json

FAR_MM = 3000.0


def plane_depth(camera: Camera, height_mm: float) -> np.ndarray:
    """(height, width) depth in mm of the plane z = `height_mm`, 0 where a pixel looks above its horizon."""
    columns, rows = np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5)
    k, pose = camera.intrinsics, camera.camera_from_world
    rays = np.stack([(columns - k[0, 2]) / k[0, 0], (rows - k[1, 2]) / k[1, 1], np.ones_like(columns)], axis=-1)
    down = rays @ pose[:3, :3][:, 2]
    centre = -pose[:3, :3].T @ pose[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (height_mm - centre[2]) / down
    return np.where(np.isfinite(depth) & (depth > 0) & (depth < 20_000), depth, 0.0)


def main() -> None:
    """Write height_by_stand_in.json beside the cell's other heights, and print the error."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--object", type=Path, required=True, help="folder of the object's results")
    parser.add_argument("--registration", default="colmap")
    parser.add_argument("--nvs", default="2dgs")
    parser.add_argument("--scale-noise", type=float, default=0.05, help="of the size of every pair, as a share")
    parser.add_argument("--point-noise", type=float, default=0.01, help="of every point, as a share of its distance")
    parser.add_argument("--long-side-px", type=int, default=256, help="of the pictures that the network would see")
    args = parser.parse_args()
    scene = args.object / "su_h"
    run, facts = scene / args.registration, read_json(scene / "capture/capture.json")
    true = {camera.name: camera for camera in read_sparse_model(scene / "capture/truth").cameras}
    empty = {camera.name: camera for camera in read_sparse_model(scene / "empty_scene/truth").cameras}
    photos = _take_evenly(list_images(scene / "empty_scene/images"), mast3r.SCENE_VIEWS)
    step_mm = facts.get("depth_step_mm", 0.1)

    def predictor(paths: list[Path]) -> MadePairs:
        cameras, depths = [], []
        for path in paths:
            of_scene = path in photos
            cameras.append((empty if of_scene else true)[path.name])
            if of_scene:
                depths.append(plane_depth(cameras[-1], facts["support_z_mm"]))
            else:
                image = decode_image(scene / "capture/depth" / path.with_suffix(".png").name, cv2.IMREAD_UNCHANGED)
                depths.append(image.astype(np.float32) * step_mm)
        noise = Noise(feature=0.03, point=args.point_noise, scale=args.scale_noise)
        pairs = MadePairs(cameras, depths, 1e-3, noise, args.long_side_px)
        for camera, points, known in zip(cameras, pairs.points, pairs.known, strict=True):
            # A network puts what it does not know somewhere in front of the camera, too.
            points[~known] = camera.centre_in_world + FAR_MM * camera.camera_from_world[2, :3]
        return pairs

    out = run / args.nvs / "height_by_stand_in.json"
    words = argparse.Namespace(
        mesh=run / args.nvs / "clean.ply", cameras=run / "cameras", capture=scene / "capture", height_m=None,
        stereo=run / "stereo/seeds.npz", out=out,
    )  # fmt: skip
    record.write_height(words, "mast3r", lambda registered: mast3r.measure_scale(registered, photos, predictor))
    found = read_json(out)
    error = 100 * (found["height_m"] / found["known_height_m"] - 1)
    print(f"{args.object.name}: {1000 * found['height_m']:.1f} mm, true {1000 * found['known_height_m']:.1f} mm, {error:+.2f} %")


if __name__ == "__main__":
    main()
