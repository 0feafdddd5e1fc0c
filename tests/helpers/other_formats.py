"""Small folders in the formats of other programs, written by true cameras."""

from pathlib import Path

import numpy as np

from helpers.given import given_cameras, small_ring
from zeroshop_steps.geometry.cameras.pinhole import write_cameras
from zeroshop_steps.geometry.cameras.sparse_files import read_reconstruction
from zeroshop_steps.geometry.cameras.transforms import OPENCV_FROM_OPENGL
from zeroshop_steps.geometry.imaging.images import write_image, write_mask
from zeroshop_steps.runtime.files import write_json

CAMERAS = small_ring(8)
NAMES = [camera.name for camera in CAMERAS]
DEPTH_MM = 400.25


def write_pictures(folder: Path, names=NAMES) -> None:
    rng = np.random.default_rng(0)
    for name in names:
        write_image(folder / name, rng.integers(0, 255, (120, 160, 3), np.uint8))


def write_colmap(folder: Path) -> None:
    write_pictures(folder / "images")
    write_cameras(folder / "sparse/0", [camera for camera in CAMERAS])


def write_colmap_text(folder: Path) -> None:
    write_colmap(folder)
    read_reconstruction(folder / "sparse/0").write_text(str(folder / "sparse/0"))
    for path in (folder / "sparse/0").glob("*.bin"):
        path.unlink()


def write_nerfstudio(folder: Path) -> None:
    write_pictures(folder / "images")
    frames = []
    for camera in CAMERAS:
        pose = given_cameras([camera]).poses[camera.name]
        write_mask(folder / "masks" / camera.name, np.eye(120, 160, dtype=bool))
        np.save(folder / f"{camera.name}.npy", np.full((120, 160, 1), DEPTH_MM / 1000, np.float32))
        places = {"file_path": f"./images/{camera.name}", "mask_path": f"masks/{camera.name}", "depth_file_path": f"{camera.name}.npy"}
        frames.append({**places, "transform_matrix": (np.linalg.inv(pose) @ OPENCV_FROM_OPENGL).tolist()})
    lens = {"fl_x": 300.0, "fl_y": 300.0, "cx": 80.0, "cy": 60.0, "w": 160, "h": 120}
    write_json(folder / "transforms.json", {**lens, "depth_unit_scale_factor": 1.0, "frames": frames})


def write_bop(folder: Path) -> None:
    half = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    cameras, truth = {}, {}
    for number, camera in enumerate(CAMERAS):
        write_pictures(folder / "rgb", [f"{number:06d}.png"])
        write_image(folder / f"depth/{number:06d}.png", np.full((120, 160), round(DEPTH_MM * 4), np.uint16))
        pose = camera.camera_from_world
        entry = {"cam_R_m2c": pose[:3, :3].ravel().tolist(), "cam_t_m2c": pose[:3, 3].tolist(), "obj_id": 5}
        truth[str(number)] = [{**entry, "obj_id": 2, "cam_t_m2c": [0.0, 0.0, 900.0]}, entry]
        for instance in range(2):
            write_mask(folder / f"mask_visib/{number:06d}_{instance:06d}.png", np.eye(120, 160, k=instance, dtype=bool))
        cameras[str(number)] = {"cam_K": (camera.intrinsics - half).ravel().tolist(), "depth_scale": 0.25}
    write_json(folder / "scene_camera.json", cameras)
    write_json(folder / "scene_gt.json", truth)


def write_middlebury(folder: Path) -> None:
    write_pictures(folder)
    lines = [str(len(CAMERAS))]
    for camera in CAMERAS:
        pose = given_cameras([camera]).poses[camera.name]
        intrinsics = camera.intrinsics - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
        lines.append(" ".join([camera.name, *map(repr, map(float, [*intrinsics.ravel(), *pose[:3, :3].ravel(), *pose[:3, 3]]))]))
    (folder / "temple_par.txt").write_text("\n".join(lines) + "\n")


def write_foundationpose(folder: Path) -> None:
    write_pictures(folder / "rgb")
    np.savetxt(folder / "cam_K.txt", CAMERAS[0].intrinsics - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]))
    for name in NAMES:
        write_image(folder / "depth" / name, np.full((120, 160), 400, np.uint16))
        write_mask(folder / "masks" / name, np.eye(120, 160, dtype=bool))
