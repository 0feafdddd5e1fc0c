"""Faults of recorded bags and of the models that are looked for in them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from helpers.faults import Fault, step
from helpers.painted_scene import can
from zeroshop_steps.geometry.meshes.triangle_meshes import write_ply
from zeroshop_steps.robot.bags import RecognitionBag, RecordedRequest
from zeroshop_steps.robot.recognition import Recognition, RecognitionRequest
from zeroshop_steps.runtime.files import write_json

RGB, DEPTH, INFO = "/camera/rgb/image", "/camera/depth/image", "/camera/rgb/camera_info"


def recognize(folder: Path, **changes: object) -> int:
    """Recognize in the bag of this folder."""
    options = {"models": folder / "models", "bag": folder / "bag", "rgb_topic": RGB, "depth_topic": DEPTH, "camera_info_topic": INFO}
    return step("robot", "recognize_bag", **options | changes, out=folder / "out")


def write_bag(folder: Path, depth_mm: float | None = 700.0) -> None:
    """A bag of one small image."""
    depth = None if depth_mm is None else np.full((30, 40), depth_mm, np.float32)
    intrinsics = np.array([[50.0, 0, 20], [0, 50, 15], [0, 0, 1]])
    with RecognitionBag(folder / "bag", lambda name: np.zeros((2, 3))) as bag:
        bag.add(RecordedRequest(1, "camera", RecognitionRequest(np.zeros((30, 40, 3), np.uint8), depth, intrinsics)), Recognition(()))


def with_file(name: str, content: bytes) -> Callable[[Path], int]:
    """Recognize in a file with this content."""

    def run(folder: Path) -> int:
        (folder / name).write_bytes(content)
        return recognize(folder, bag=folder / name)

    return run


def with_bag(depth_mm: float | None = 700.0, **changes: object) -> Callable[[Path], int]:
    """Recognize in a small bag, with other options."""

    def run(folder: Path) -> int:
        write_bag(folder, depth_mm)
        return recognize(folder, **changes)

    return run


def with_mesh_of(scale: str) -> Callable[[Path], int]:
    """Recognize a mesh of the workflow whose record says this of its scale."""

    def run(folder: Path) -> int:
        write_bag(folder)
        write_ply(folder / "models/can/2dgs.ply", can().with_normals())
        write_json(folder / "models/can/2dgs.json", {"scale": scale, "scale_source": None})
        return recognize(folder)

    return run


FAULTS = [
    Fault("a bag that is none", with_file("robot.mcap", b"none"), (r"the bag .*robot\.mcap cannot be read",)),
    Fault("an empty bag of ROS 1", with_file("robot.bag", b""), (r"the bag .*robot\.bag cannot be read",)),
    Fault("a bag that is not there", recognize, (r"the bag .*/bag cannot be read",)),
    Fault(
        "a topic that is not there", with_bag(rgb_topic="/rgb"), ("has no topic /rgb of sensor_msgs/Image", "it has .*/camera/rgb/image")
    ),
    Fault("a topic of another kind", with_bag(depth_topic="/tf"), ("has no topic /tf of sensor_msgs/Image", r"/tf \(tf2_msgs")),
    Fault("a bag without depth", with_bag(None), ("no colour image with a depth image of its time",)),
    Fault("no image is taken", with_bag(every=0), ("--every", "0")),
    Fault("no models", with_bag(), ("has no usable model", "expected models_info.json or OBJECT/2dgs.ply")),
    Fault("a mesh of unknown scale", with_mesh_of("unknown"), (r"can/2dgs\.ply is unknown", "give its height")),
]
