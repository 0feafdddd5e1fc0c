"""Faults of what learned detectors and pose estimators are given: depth, masks, models, weights, devices and memory."""

import atexit
import contextlib
import json
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest

from helpers.faults import Fault, step
from zeroshop_steps.runtime.files import write_json

# What imports torch is imported where it is used: the process that hands tests to others reads this file, too.

ESTIMATORS = ("foundationpose", "sam6d_pem")
DETECTORS = ("cnos", "sam6d_ism")
OPTIONS: dict[str, tuple[str, ...]] = {name: ("--proposals", "fastsam", "--describer", "small") for name in DETECTORS}
REFINER = "foundationpose/2023-10-28-18-33-37/model_best.pth"
MB = 1_000_000


@cache
def make_once() -> Path:
    """A small dataset with views of its models, and small random weights of all networks."""
    from helpers.small_dataset import make_dataset
    from helpers.small_foundationpose import write_checkpoints
    from helpers.small_sam6d import write_pem

    folder = Path(mkdtemp(prefix="faults."))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    make_dataset(folder)
    write_checkpoints(folder)
    write_pem(folder / "resources/weights/sam-6d-pem-base.pth")
    assert step("detect", "templates", models=folder / "models", side_px=56, out=folder / "templates") == 0
    return folder


@cache
def make_detectors_once() -> Path:
    """The same with small random weights of the detectors."""
    from helpers.small_detectors import save_describer, save_fastsam

    folder = make_once()
    save_fastsam(folder / "resources/weights")
    save_describer(folder / "resources/weights", "small")
    return folder


def recognize(method: str, spoil: Callable[[Path], object] = lambda data: None, *words: str) -> Callable[[Path], int]:
    """Detect the objects of the dataset, or estimate their poses, after `spoil` has changed it."""

    def run(folder: Path) -> int:
        made = make_detectors_once() if method in DETECTORS else make_once()
        data = shutil.copytree(made, folder / "data")
        spoil(data)
        stage = "detect" if method in DETECTORS else "pose"
        views = {} if method == "foundationpose" else {"templates": "templates"}
        options = {"models": "models", "scenes": "test", "targets": "test_targets_bop19.json", "out": "found", **views}
        with contextlib.chdir(data):
            return step(stage, method, "--device", "cpu", *OPTIONS.get(method, ()), *words, **options)

    return run


def with_mask(method: str, size: tuple[int, int]) -> Callable[[Path], int]:
    """Estimate the pose of a detection whose mask has this (height, width)."""

    def spoil(data: Path) -> None:
        from zeroshop_steps.bop.formats.detections import Detection, encode_mask, write_detections

        write_detections(data / "found.json", [Detection(1, 0, 1, 0.7, None, encode_mask(np.ones(size, bool)))])

    return recognize(method, spoil, "--detections", "found.json")


def on(method: str, device: str, free_bytes: int) -> Callable[[Path], int]:
    """Work on a machine without CUDA that has so much memory left."""

    def run(folder: Path) -> int:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("torch.cuda.is_available", lambda: False)
            patch.setattr("zeroshop_steps.networks.devices.measure_free_bytes", lambda device: free_bytes)
            return recognize(method, lambda data: None, "--device", device)(folder)

    return run


def depth_in_metres(data: Path) -> None:
    """A depth_scale that makes metres of the depth images."""
    path = data / "test/000001/scene_camera.json"
    content = json.loads(path.read_text())
    path.write_text(json.dumps({image: entry | {"depth_scale": 1e-4} for image, entry in content.items()}))


def mesh_in_metres(data: Path) -> None:
    """A model in metres."""
    from zeroshop_steps.geometry.meshes.ply_surface import read_ply
    from zeroshop_steps.geometry.meshes.triangle_meshes import write_ply

    mesh = read_ply(data / "models/obj_000001.ply")
    write_ply(data / "models/obj_000001.ply", type(mesh)(mesh.vertices / 1000, mesh.faces))


def without_depth(data: Path) -> None:
    """No depth images."""
    shutil.rmtree(data / "test/000001/depth")


def other_weights(name: str, sizes: str, **changes: object) -> Callable[[Path], None]:
    """The checkpoint of a network of other sizes: those beside it say what was expected."""

    def spoil(data: Path) -> None:
        beside = (data / "resources/weights" / name).with_suffix(sizes)
        write_json(beside, json.loads(beside.read_text()) | changes)

    return spoil


ADD_DEPTH = (r"depth has no image 000000", "poses are estimated from depth: add it")
ISM_DEPTH = (r"depth has no image 000000", "--method cnos, which needs colour only")
METRES = ("looks like metres", r"depth_scale in .*scene_camera\.json")
SIZE = ("is 12 x 10 px, the image 96 x 72 px", "same size")
MESH = (r"obj_000001\.ply measures 0\.1", "Convert it to millimetres")
NO_CUDA = ("--device cuda: PyTorch finds no CUDA device", "--device cpu, or auto")
NO_MEMORY = (r"takes \d+\.\d GB at its peak, the device cpu has 0\.0 GB free", "use")
FAULTS = [
    *(Fault(f"{name} without depth", recognize(name, without_depth), ADD_DEPTH) for name in ESTIMATORS),
    *(Fault(f"{name} with depth in metres", recognize(name, depth_in_metres), METRES) for name in ESTIMATORS),
    *(Fault(f"{name} with a mask of the wrong size", with_mask(name, (10, 12)), SIZE) for name in ESTIMATORS),
    *(Fault(f"{name} with a mesh in metres", recognize(name, mesh_in_metres), MESH) for name in ESTIMATORS),
    Fault(
        "foundationpose with weights of another version",
        recognize("foundationpose", other_weights(REFINER, ".settings.json", width=64)),
        (r"model_best\.pth does not fit RefineNet", "weights.csv"),
    ),
    Fault(
        "sam6d_pem with weights of another version",
        recognize("sam6d_pem", other_weights("sam-6d-pem-base.pth", ".json", features=8)),
        (r"sam-6d-pem-base\.pth does not fit Sam6dPem", "weights.csv"),
    ),
    *(Fault(f"{name} on CUDA that is absent", on(name, "cuda", 64_000 * MB), NO_CUDA) for name in (*ESTIMATORS, *DETECTORS)),
    *(Fault(f"{name} in too little memory", on(name, "cpu", MB), NO_MEMORY) for name in (*ESTIMATORS, *DETECTORS)),
    *(Fault(f"{name} with a mesh in metres", recognize(name, mesh_in_metres), MESH) for name in DETECTORS),
    Fault("sam6d_ism without depth", recognize("sam6d_ism", without_depth), ISM_DEPTH),
    Fault("sam6d_ism with depth in metres", recognize("sam6d_ism", depth_in_metres), METRES),
    Fault(
        "cnos with the weights of another FastSAM",
        recognize("cnos", other_weights("FastSAM-x.pt", ".json", width=0.5)),
        (r"FastSAM-x\.pt does not fit FastSam", "weights.csv"),
    ),
]
