"""Make the eight first images of the grasp protocol (4.4.3) of one object, as the HSR's camera sees it on a plain table.

They are the same whatever the robot knows of the object, so they are made once: a scene in BOP's layout with an image a pose, numbered
from 1 to 8, and protocol.json, which says how the object came to rest.
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zeroshop_steps.bop.formats.bop_scenes import Frame, read_scene, write_scene
from zeroshop_steps.bop.scoring.depth_render import DepthRenderer
from zeroshop_steps.grasp.gripper import GRIPPERS
from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.runtime.files import atomic_directory, read_json, write_json
from zeroshop_steps.runtime.progress import track
from zeroshop_steps.simulate.camera import SensedFrame, in_memory, photograph
from zeroshop_steps.simulate.dynamics.lifting import settle
from zeroshop_steps.simulate.dynamics.physics import USUAL
from zeroshop_steps.simulate.protocol import ProtocolPose, choose_poses
from zeroshop_steps.simulate.true_object import TrueObject, in_mm, read_true_object
from zeroshop_steps.synthetic.make_test_scenes import write_frame
from zeroshop_steps.synthetic.rendering.shading import use_threads

CACHED = Cached(inputs=("model", "body"), ignored=("threads",))


@dataclass(frozen=True)
class FirstLook:
    """One first image.

    Attributes:
        pose: of the eight, its `world_from_object` after the object has come to rest.
        frame: the image.
        visible: (height, width) bool, the true mask.
    """

    pose: ProtocolPose
    frame: SensedFrame
    visible: np.ndarray


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--model", type=Path, required=True, help="folder of the true model")
    parser.add_argument("--body", type=Path, required=True, help="its physical body, made by --method physical_model")
    parser.add_argument("--seed", type=int, default=0, help="seed of lights and noise (default: %(default)s)")
    parser.add_argument("--threads", type=int, default=0, help="threads for shading (default: all)")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")


def run(args: argparse.Namespace) -> None:
    """Write the images of one object."""
    use_threads(args.threads)
    true = read_true_object(args.model, args.body, None)
    poses = choose_poses(true.body, str(args.model))
    with atomic_directory(args.out) as folder:
        scene, frames, records = folder / f"{true.object_id:06d}", [], []
        for pose in track(poses, "poses", len(poses)):
            rest = settle(true.body, pose.world_from_object, GRIPPERS["hsr"], USUAL)
            frames.append(photograph_rest(scene, true, rest, [args.seed, true.object_id, pose.number, 1], pose.number))
            record = {"number": pose.number, "placement": pose.placement, "turn_deg": pose.turn_deg}
            records.append(record | {"world_from_object": rest.ravel().tolist()})
        write_scene(scene, frames)
        write_json(folder / "protocol.json", {"unit": "metre", "poses": records})
    print(f"{args.out}: {len(frames)} images", file=sys.stderr)


def photograph_rest(scene: Path, true: TrueObject, world_from_object: np.ndarray, seed: list[int], number: int) -> Frame:
    """Photograph the object where it lies, (4, 4) m, and write the image with its mask into the folder of a scene."""
    picture = photograph([true.mesh], [in_mm(world_from_object)], seed)
    poses, renderers = {0: in_mm(world_from_object)}, {true.object_id: DepthRenderer(true.mesh)}
    return write_frame(scene, true.object_id, number, picture, [true.object_id], poses, renderers)


def read_first_looks(folder: Path) -> list[FirstLook]:
    """The images that this step wrote. Raises StepError where they are missing or damaged."""
    records = read_json(folder / "protocol.json")["poses"]
    (scene,) = (path for path in sorted(folder.iterdir()) if path.is_dir())
    frames = read_scene(scene)
    looks = []
    for record in records:
        pose = ProtocolPose(
            record["number"], record["placement"], record["turn_deg"], np.array(record["world_from_object"], float).reshape(4, 4)
        )
        frame = frames[pose.number]
        looks.append(FirstLook(pose, in_memory(frame), frame.mask(0)))
    return looks
