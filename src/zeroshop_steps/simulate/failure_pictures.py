"""A picture of a failed attempt: what the robot saw and believed, and the world from the side when it grasped and when it failed."""

import cv2
import numpy as np
import trimesh

from zeroshop_steps.bop.scoring.depth_render import DepthRenderer
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.geometry.cameras.viewpoints import look_at, make_intrinsics
from zeroshop_steps.geometry.imaging.contact_sheets import GREEN, RED, write_label
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.meshes.units import MM_PER_M
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.grasp.gripper import Gripper
from zeroshop_steps.simulate.camera import SensedFrame
from zeroshop_steps.simulate.dynamics.lifting import Lift, Snapshot
from zeroshop_steps.simulate.robot import Plan, Robot
from zeroshop_steps.simulate.true_object import TrueObject, in_mm

CROP_SIDE_PX, PANEL_PX = 240, 320  # of the image around the object, and of each panel
SIDE_CENTRE_MM, SIDE_TARGET_MM, SIDE_FOCAL_PX = np.array([-330.0, -560.0, 330.0]), np.array([0.0, 0.0, 90.0]), 420.0


def draw_failure(
    true: TrueObject, robot: Robot, frame: SensedFrame, plan: Plan, world_from_object: np.ndarray, lifted: Lift | None
) -> np.ndarray:
    """The picture, (PANEL_PX, N x PANEL_PX, 3) uint8.

    Left: the image, the detected mask in blue, the true outline in green, the robot's mesh in its estimated pose in red. Then the true
    object and the gripper at the end of closing, and at the end of the stage that failed.

    Args:
        true: the object; world_from_object: (4, 4) m, where it truly was.
        robot: whose mesh and gripper are drawn.
        frame, plan: what it saw and planned.
        lifted: what then happened; None where it had no grasp.
    """
    panels = [_draw_belief(true, robot, frame, plan, world_from_object)]
    if lifted:
        shown = {snapshot.stage: snapshot for snapshot in (*lifted.snapshots[:1], *lifted.snapshots[1:2], lifted.snapshots[-1])}
        panels += [_draw_world(true, robot.gripper, snapshot) for snapshot in shown.values()]
    return np.concatenate(panels, 1)


def _draw_belief(true: TrueObject, robot: Robot, frame: SensedFrame, plan: Plan, world_from_object: np.ndarray) -> np.ndarray:
    picture = frame.photo.copy()
    camera_from_model = frame.camera_from_table @ in_mm(world_from_object)
    draw_outline(picture, silhouette(true.mesh, camera_from_model, frame.intrinsics, picture.shape), GREEN)
    label = plan.result or "grasp chosen"
    if plan.sighting:
        draw_outline(picture, plan.sighting.mask, (60, 120, 255))
        if plan.sighting.camera_from_model is not None:
            mesh = robot.perception.models[robot.object_id].mesh
            draw_outline(picture, silhouette(mesh, plan.sighting.camera_from_model, frame.intrinsics, picture.shape), RED)
    middle = frame.intrinsics @ camera_from_model[:3, 3]
    corner = (middle[:2] / middle[2] - CROP_SIDE_PX / 2).astype(int)
    left, top = np.clip(corner, 0, np.array([picture.shape[1], picture.shape[0]]) - CROP_SIDE_PX)
    cut = picture[top : top + CROP_SIDE_PX, left : left + CROP_SIDE_PX]
    panel = cv2.resize(cut, (PANEL_PX, PANEL_PX), interpolation=cv2.INTER_LINEAR)
    write_label(panel, label)
    return panel


def silhouette(mesh: Mesh, camera_from_model: np.ndarray, intrinsics: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """(height, width) bool: a mesh in its (4, 4) pose, mm, in an image of this shape."""
    return DepthRenderer(mesh).render(camera_from_model, intrinsics, shape[1], shape[0]).image(shape[1], shape[0]) > 0


def draw_outline(picture: np.ndarray, mask: np.ndarray, color: tuple[int, int, int]) -> None:
    """Draw the outline of a (height, width) bool mask into a picture, in place."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(picture, contours, -1, color, 1)


def _draw_world(true: TrueObject, gripper: Gripper, snapshot: Snapshot) -> np.ndarray:
    """The world from the side, shaded, at the end of a stage."""
    boxes = [
        _box(low * MM_PER_M, high * MM_PER_M, in_mm(snapshot.world_from_gripper))
        for low, high in gripper.boxes(np.array([snapshot.opening_m]))[0]
    ]
    half = np.array([500.0, 500.0, 4.0]) / 2
    table = _box(np.array([-half[0], -half[1], -2 * half[2]]), np.array([half[0], half[1], 0.0]), np.eye(4))
    thing = Mesh(transform_points(true.mesh.vertices, in_mm(snapshot.world_from_object)), true.mesh.faces)
    world = _join([thing, *boxes, table])
    intrinsics = make_intrinsics(SIDE_FOCAL_PX, PANEL_PX, PANEL_PX)
    camera = Camera("side.png", PANEL_PX, PANEL_PX, intrinsics, look_at(SIDE_CENTRE_MM, SIDE_TARGET_MM))
    panel = np.ascontiguousarray(MeshRenderer(world).render_shaded(camera))
    cv2.rectangle(panel, (0, 0), (110, 24), (0, 0, 0), -1)
    write_label(panel, snapshot.stage)
    return panel


def _box(low: np.ndarray, high: np.ndarray, pose: np.ndarray) -> Mesh:
    solid = trimesh.creation.box(bounds=np.stack([low, high]))
    return Mesh(transform_points(np.asarray(solid.vertices, float), pose), np.asarray(solid.faces, np.int64))


def _join(meshes: list[Mesh]) -> Mesh:
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)])
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), faces)
