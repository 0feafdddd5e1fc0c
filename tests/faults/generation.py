"""Faults of what the generative network is given: photos, masks, heights, weights, devices and memory."""

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
import trimesh

from helpers.faults import Fault, step
from zeroshop_steps.geometry.imaging.images import write_image, write_mask
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.runtime.files import write_json

NETWORKS, ENCODER = Path("resources/weights/small-trellis"), Path("resources/weights/small-dino")


@cache
def make_once() -> Path:
    """Photos of noise with masks, and small random weights."""
    from helpers.small_trellis import write_networks

    folder = Path(mkdtemp(prefix="faults."))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    mask = np.zeros((48, 64), bool)
    mask[10:40, 20:50] = True
    for number in range(4):
        noise = np.random.default_rng(number).integers(0, 255, (48, 64, 3), dtype=np.uint8)
        write_image(folder / f"capture/images/{number}.png", noise)
        write_mask(folder / f"capture/masks/{number}.png", mask)
    write_json(folder / "capture/capture.json", {})
    write_networks(folder / NETWORKS)
    for name in ("config.json", "model.safetensors"):  # only looked for, where something else is wrong
        (folder / ENCODER).mkdir(parents=True, exist_ok=True)
        (folder / ENCODER / name).write_text("{}")
    return folder


def generate(spoil: Callable[[Path], object] = lambda data: None, *words: str) -> Callable[[Path], int]:
    """Generate a mesh of the photos after `spoil` has changed them."""

    def run(folder: Path) -> int:
        data = shutil.copytree(make_once(), folder / "data")
        spoil(data)
        small = ("--networks", "small-trellis", "--encoder", "small-dino", "--device", "cpu", "--steps", "1")
        with contextlib.chdir(data):
            return step("surface", "trellis", "--capture", "capture", *small, *words, out="raw_mesh.ply")

    return run


def in_little_memory(folder: Path) -> int:
    """Generate with a megabyte left."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("zeroshop_steps.networks.devices.measure_free_bytes", lambda device: 1_000_000)
        return generate()(folder)


def without_cuda(folder: Path) -> int:
    """Generate on CUDA where there is none."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("torch.cuda.is_available", lambda: False)
        return generate(lambda data: None, "--device", "cuda")(folder)


def with_encoder(spoil: Callable[[Path], object]) -> Callable[[Path], None]:
    """With a true encoder, for what is found after it has run."""

    def change(data: Path) -> None:
        from helpers.small_trellis import write_encoder

        write_encoder(data / ENCODER)
        spoil(data)

    return change


def other_sizes(data: Path) -> None:
    """The weights of a network of other sizes: those beside them say what was expected."""
    path = data / NETWORKS / "settings.json"
    sizes = json.loads(path.read_text())
    sizes["structure_flow"]["blocks"] = 1
    write_json(path, sizes)


def cut_off(data: Path) -> None:
    """A file of weights that is not whole."""
    path = data / NETWORKS / "structure_flow.safetensors"
    path.write_bytes(path.read_bytes()[:3000])


def mask_of(shape: tuple[int, int], value: bool) -> Callable[[Path], None]:
    """Another first mask."""
    return lambda data: write_mask(data / "capture/masks/0.png", np.full(shape, value))


def finish_alone(**facts: object) -> Callable[[Path], int]:
    """Finish a raw mesh without colours as one that was generated without cameras; `facts` are in its JSON."""

    def run(folder: Path) -> int:
        ball = trimesh.creation.icosphere(1)
        write_ply(folder / "raw_mesh.ply", Mesh(np.array(ball.vertices), np.array(ball.faces, np.int64)))
        write_json(folder / "raw_mesh.json", facts)
        return step("finish", "without_cameras", mesh=folder / "raw_mesh.ply", out=folder / "mesh.ply")

    return run


FAULTS = [
    Fault(
        "trellis without masks", generate(lambda data: shutil.rmtree(data / "capture/masks")), (r"masks does not exist", r"objects\.tsv")
    ),
    Fault("trellis with an empty mask", generate(mask_of((48, 64), False)), (r"masks/0\.png is empty", "255 on the object")),
    Fault("trellis with a mask of the wrong size", generate(mask_of((20, 30), True)), (r"masks/0\.png", "30 x 20", "64 x 48")),
    Fault(
        "trellis with a height in centimetres",
        generate(lambda data: None, "--height-m", "9.6"),
        ("out of range", "centimetres", "in metres"),
    ),
    Fault(
        "trellis with both cameras and photos alone",
        generate(lambda data: None, "--cameras", "capture"),
        ("either --cameras, or --capture",),
    ),
    Fault("trellis without photos", generate(lambda data: shutil.rmtree(data / "capture/images")), (r"capture/images",)),
    Fault(
        "trellis without weights",
        generate(lambda data: (data / NETWORKS / "latent_flow.safetensors").unlink()),
        (r"small-trellis/latent_flow\.safetensors does not exist", "needs no weights"),
    ),
    Fault("trellis on CUDA that is absent", without_cuda, ("--device cuda: PyTorch finds no CUDA device", "--device cpu, or auto")),
    Fault(
        "trellis in too little memory",
        in_little_memory,
        (r"takes 0\.\d GB at its peak, the device cpu has 0\.0 GB free", "2dgs or svraster"),
    ),
    Fault(
        "trellis with weights of another version",
        generate(with_encoder(other_sizes)),
        (r"structure_flow\.safetensors does not fit", r"weights\.csv"),
    ),
    Fault(
        "trellis with weights that were cut off",
        generate(with_encoder(cut_off)),
        (r"structure_flow\.safetensors is no whole checkpoint", "fetch it again"),
    ),
    Fault(
        "a measured mesh finished without cameras",
        finish_alone(seconds=1.0),
        (r"raw_mesh\.json is not of a mesh that was generated without cameras", "finish a mesh with cameras by shape and texture"),
    ),
    Fault(
        "a generated mesh without colours",
        finish_alone(generated=True, height_m=0.1),
        (r"raw_mesh\.ply has no colours", "surface method trellis"),
    ),
]
