"""Draw the best grasps on the object from three sides: each a fork of two fingers and a handle, green where good, red where poor."""

import argparse
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.viewpoints import direction_at, place_around
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.geometry.meshes.metric_mesh import add_mesh_arguments, read_metric_mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.grasp.grasps import Grasp, read_grasps
from zeroshop_steps.grasp.gripper import GRIPPERS, Gripper, find_gripper
from zeroshop_steps.grasp.ranking import choose_spread

TILE_PX = 480
SIDES_DEG = ((30.0, 20.0), (150.0, 20.0), (-80.0, 55.0))  # azimuth and elevation of the cameras
POINTS = 40  # along a stroke, each hidden by the object or not


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_mesh_arguments(parser)
    parser.add_argument("--grasps", type=Path, required=True, help="grasps.json")
    parser.add_argument("--gripper", choices=list(GRIPPERS), default="hsr", help="the gripper that the grasps are for")
    parser.add_argument("--count", type=int, default=9, help="how many grasps are drawn, good ones that are not alike")
    parser.add_argument("--out", type=Path, required=True, help="PNG to write")


def run(args: argparse.Namespace) -> None:
    """Draw one object."""
    metric = read_metric_mesh(args.mesh, args.unknown_scale)
    grasps, gripper = read_grasps(args.grasps), find_gripper(args.gripper)
    poses, scores = np.array([grasp.object_from_gripper for grasp in grasps]), np.array([grasp.score for grasp in grasps])
    drawn = [grasps[number] for number in choose_spread(poses, gripper.tcp_m, scores, args.count)]
    renderer = MeshRenderer(metric.mesh)
    strokes = [(_strokes(grasp, gripper), _color(grasp.score)) for grasp in drawn]
    tiles = [draw_side(renderer, strokes, *side) for side in SIDES_DEG]
    write_image(args.out, np.concatenate(tiles, 1))


def draw_side(
    renderer: MeshRenderer, strokes: Sequence[tuple[np.ndarray, tuple[int, int, int]]], azimuth_deg: float, elevation_deg: float
) -> np.ndarray:
    """(TILE_PX, TILE_PX, 3) one side of an object in metres, with (S, 2, 3) strokes and their colours; hidden parts are faint."""
    places = np.concatenate([renderer.mesh.vertices, *(lines.reshape(-1, 3) for lines, _ in strokes)])
    middle = (places.min(0) + places.max(0)) / 2
    radius = float(np.linalg.norm(places - middle, axis=1).max())
    camera = place_around(middle, radius, direction_at(np.radians(azimuth_deg), np.radians(elevation_deg)), TILE_PX)
    image = renderer.render_color(camera)
    depth = renderer.find_depth(camera)
    faint = image.copy()
    for lines, color in strokes:
        for start, end in lines:
            path = start + np.linspace(0, 1, POINTS)[:, None] * (end - start)
            pixels, depths = camera.project(path)
            column, row = np.clip(pixels.T.astype(int), 0, TILE_PX - 1)
            hidden = (depth[row, column] > 0) & (depth[row, column] < depths - 0.001)
            for index in range(POINTS - 1):
                ends = [tuple(int(value) for value in pixels[place]) for place in (index, index + 1)]
                cv2.line(faint if hidden[index] else image, ends[0], ends[1], color, 2, cv2.LINE_AA)
                if not hidden[index]:
                    cv2.line(faint, ends[0], ends[1], color, 2, cv2.LINE_AA)
    return cv2.addWeighted(image, 0.75, faint, 0.25, 0)


def _strokes(grasp: Grasp, gripper: Gripper) -> np.ndarray:
    """(4, 2, 3) ends of both fingers, the bar between them and the handle, metres, object frame."""
    half, base, tip_m = grasp.width_m / 2, gripper.palm_front_m, gripper.tip_m
    fork = [[(0, side, tip_m), (0, side, base)] for side in (half, -half)]
    fork += [[(0, half, base), (0, -half, base)], [(0, 0, base), (0, 0, base - 0.02)]]
    return np.array(fork) @ grasp.object_from_gripper[:3, :3].T + grasp.object_from_gripper[:3, 3]


def _color(score: float) -> tuple[int, int, int]:
    """Red at 0.3 and below, green at 0.9 and above."""
    share = float(np.clip((score - 0.3) / 0.6, 0, 1))
    return (round(220 * (1 - share)), round(40 + 130 * share), 40)
