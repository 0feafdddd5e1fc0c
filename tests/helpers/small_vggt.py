"""A VGGT of small sizes with random weights, in a file like the published one, and one that knows the truth."""

from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from safetensors.torch import save_file
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.pinhole import Camera, read_sparse_model
from zeroshop_steps.geometry.imaging.images import list_images, read_depth_mm
from zeroshop_steps.networks.vggt.model import Vggt
from zeroshop_steps.networks.vggt.settings import VggtSettings
from zeroshop_steps.register.vggt.feed_forward import unproject
from zeroshop_steps.register.vggt.frames import Frames
from zeroshop_steps.register.vggt.network import VggtOutput
from zeroshop_steps.runtime.files import write_json

SETTINGS = VggtSettings(
    image_px=140,
    width=32,
    depth=4,
    embed_depth=2,
    heads=2,
    layers=(0, 1, 2, 3),
    camera_depth=2,
    dense_features=16,
    dense_channels=(8, 12, 16, 16),
    track_features=16,
    track_channels=(8, 12, 16, 16),
    track_width=32,
    track_depth=2,
    track_levels=3,
    virtual_tracks=8,
)


def write_weights(path: Path) -> Path:
    """Random weights that lead to possible cameras, so that nothing ends before the tracks; returns `path`."""
    torch.manual_seed(0)
    network = Vggt(SETTINGS)
    with torch.no_grad():
        for name, parameter in network.named_parameters():
            if name.split(".")[-1] in ("cls_token", "camera_token", "register_token", "query_ref_token", "virual_tracks"):
                parameter.normal_()
        # Four rounds add up: a camera at some distance, no rotation, 40 by 50 degrees.
        network.camera_head.pose_branch.fc2.weight.mul_(0.05)
        network.camera_head.pose_branch.fc2.bias.copy_(torch.tensor([0, 0, 2, 0, 0, 0, 1, 0.7, 0.87]) / 4)
    path.parent.mkdir(parents=True)
    save_file(network.state_dict(), path)
    write_json(path.with_suffix(".settings.json"), asdict(SETTINGS))
    return path


@dataclass
class TrueNetwork:
    """Answers as VGGT would if it knew the cameras and depth of a rendered capture, up to noise.

    Attributes:
        capture: with images/, depth/ and truth/.
        frames: the images as the network sees them.
        turn_deg: size of the cameras' rotation errors; their positions are off by as much, seen from the object.
        fov_error: relative size of the fields of view's errors.
        depth_error: relative size of the depth's errors.
        track_px: size of the tracks' errors in network pixels.
        wrong: share of the tracks' places that are anywhere.
    """

    capture: Path
    frames: Frames
    turn_deg: float = 0.0
    fov_error: float = 0.0
    depth_error: float = 0.0
    track_px: float = 0.0
    wrong: float = 0.0

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(0)
        self.cameras = list(read_sparse_model(self.capture / "truth").cameras)
        self.depth_mm = [read_depth_mm(path) for path in list_images(self.capture / "depth")]

    def predict(self, pixels: np.ndarray) -> VggtOutput:
        encodings = encode(self.cameras, self.frames, self.turn_deg, self.fov_error, self.rng)
        width, height = self.frames.network_size_px
        grid = self.frames.to_image(np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=2)).astype(np.float32) - 0.5
        maps = [cv2.remap(depth, grid[..., 0], grid[..., 1], cv2.INTER_NEAREST) / UNIT_MM for depth in self.depth_mm]
        depth = np.array(maps) * (1 + self.depth_error * self.rng.normal(size=(len(maps), height, width)))
        return VggtOutput(encodings, depth, np.where(np.array(maps) > 0, 10.0, 1.0))

    def track(self, pixels: np.ndarray, view: int, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        places = self.frames.to_image(xy)
        depth = look_up(self.depth_mm[view], places)
        points = unproject(self.cameras[view], places, depth)
        tracks, visibility = [], []
        for camera, own in zip(self.cameras, self.depth_mm, strict=True):
            projected, distance = camera.project(points)
            tracks.append(self.frames.to_network(projected) + self.track_px * self.rng.normal(size=xy.shape))
            visibility.append(np.where((depth > 0) & (np.abs(look_up(own, projected) - distance) < 2.0), 0.9, 0.05))
        tracks, visibility = np.array(tracks), np.array(visibility)
        wrong = self.rng.random(visibility.shape) < self.wrong
        wrong[view] = False
        tracks[wrong] = self.rng.random((wrong.sum(), 2)) * self.frames.network_size_px
        return tracks, visibility


UNIT_MM = 400.0  # the network's unit is any; this one is about the distance of the camera


def look_up(depth_mm: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """(N,) depth of the nearest pixel; 0 off the image."""
    columns, rows = np.floor(xy).astype(int).T
    inside = (columns >= 0) & (rows >= 0) & (columns < depth_mm.shape[1]) & (rows < depth_mm.shape[0])
    return np.where(inside, depth_mm[np.where(inside, rows, 0), np.where(inside, columns, 0)], 0.0)


def encode(cameras: list[Camera], frames: Frames, turn_deg: float, fov_error: float, rng: np.random.Generator) -> np.ndarray:
    """(S, 9) encodings of cameras, in the frame of the first one."""
    rows = []
    world_from_first = np.linalg.inv(cameras[0].camera_from_world)
    for camera in cameras:
        pose = camera.camera_from_world @ world_from_first
        turn = Rotation.from_rotvec(np.radians(turn_deg) * rng.normal(size=3) / np.sqrt(3)).as_matrix()
        away = np.linalg.norm(camera.centre_in_world) * np.radians(turn_deg) / np.sqrt(3)
        translation = (turn @ pose[:3, 3] + away * rng.normal(size=3)) / UNIT_MM
        focal = camera.intrinsics[[0, 1], [0, 1]] * frames.scale
        fov = 2 * np.arctan(np.array(frames.network_size_px) / 2 / focal) * (1 + fov_error * rng.normal())
        rows.append([*translation, *Rotation.from_matrix(turn @ pose[:3, :3]).as_quat(), fov[1], fov[0]])
    return np.array(rows)
