"""A simulated arm that scans: it drives to a view, reads its joints, takes a photo and depth; by proposals, or around rings."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.pinhole import Camera, make_transform
from zeroshop_steps.geometry.cameras.viewpoints import make_intrinsics
from zeroshop_steps.grasp.gripper import Gripper
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.scan.arm.arm_reach import ArmReach
from zeroshop_steps.scan.arm.kinematics import Arm
from zeroshop_steps.scan.reach import Move
from zeroshop_steps.scan.viewpoints import ViewSphere
from zeroshop_steps.simulate.arm.arm_world import ArmWorld, hand_with_camera
from zeroshop_steps.simulate.arm.scan_scene import ScanScene

FOCAL_IN_WIDTHS = 615.0 / 640.0  # of a RealSense D435's colour camera at 640 x 480
REACHED_RAD = 0.001  # by which each joint may be off at the end
RINGS_DEG = {"ring": (35.0,), "two_rings": (20.0, 55.0)}
"""Elevations of the fixed rings that proposals are compared with."""


@dataclass(frozen=True)
class Stop:
    """Where the arm stopped.

    Attributes:
        camera: true, in the world, metres.
        world_from_camera: (4, 4) as it is read: by the joints and the calibration of the hand, which are off a little.
        touched: whether anything was touched on the way.
    """

    camera: Camera
    world_from_camera: np.ndarray
    touched: bool


class ScanRobot:
    """The arm before a scene.

    Args:
        arm, gripper: what moves.
        scene: before it.
        width_px, height_px: of the images.
        position_deviation_m, rotation_deviation_deg: of the poses that are read.
        seed: of these.
    """

    def __init__(
        self,
        arm: Arm,
        gripper: Gripper,
        scene: ScanScene,
        width_px: int,
        height_px: int,
        position_deviation_m: float = 0.0,
        rotation_deviation_deg: float = 0.0,
        seed: int = 0,
    ) -> None:
        hand = hand_with_camera(gripper)
        self.scene, self.world = scene, ArmWorld(arm, hand, gripper, scene.points_m)
        self.reach = ArmReach(arm, hand, np.eye(4), 0.0, scene.box, self.world.joints_rad)
        intrinsics = make_intrinsics(FOCAL_IN_WIDTHS * width_px, width_px, height_px)
        self.sphere = ViewSphere(Camera("", width_px, height_px, intrinsics, np.eye(4)))
        self._deviations = (position_deviation_m, np.radians(rotation_deviation_deg))
        self._rng = np.random.default_rng(seed)

    def go(self, move: Move) -> Stop:
        """Drive to a view. Raises StepError where the arm does not get there."""
        off_rad = self.world.follow(move.waypoints_rad)
        self.reach.joints_rad = self.world.joints_rad
        if off_rad > REACHED_RAD:
            raise StepError(
                f"the arm was blocked {np.degrees(off_rad):.1f} degrees before its goal; is the box around the object too small?"
            )
        shift, turn = (self._rng.normal(0.0, deviation, 3) for deviation in self._deviations)
        off = make_transform(Rotation.from_rotvec(turn).as_matrix(), shift)
        read = self.reach.find_camera(self.world.joints_rad) @ off
        return Stop(self.sphere.camera_at(self.world.camera_pose()), read, self.world.touched)

    def reachable_views(self) -> list[np.ndarray]:
        """(4, 4) world_from_camera of all viewpoints of the sphere around the box that the arm reaches from home."""
        self.reach.joints_rad = np.array(self.reach.arm.home_rad)
        moves = self.reach.plan(self.sphere.place(self.scene.box))
        self.reach.joints_rad = self.world.joints_rad
        return [move.world_from_camera for move in moves if move is not None]

    def drive_ring(self, count: int, elevations_deg: tuple[float, ...]) -> Iterator[Stop]:
        """Stops of `count` views in all, on rings that are half a step apart; what the arm does not reach is left out."""
        each = [count // len(elevations_deg) + (index < count % len(elevations_deg)) for index in range(len(elevations_deg))]
        for index, (elevation_deg, views) in enumerate(zip(elevations_deg, each, strict=True)):
            # The arm is in its own way towards the side that faces it, most of all low: no view of the first ring is there.
            first_deg = 180.0 + (180.0 / views * (1 + index) if views else 0.0)
            for view in self.sphere.ring(self.scene.box, views, elevation_deg, first_deg) if views else ():
                (move,) = self.reach.plan(view[None])
                if move is not None:
                    yield self.go(move)
