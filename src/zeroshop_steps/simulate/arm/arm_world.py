"""An arm in MuJoCo that carries the gripper and a camera, on a table with a thing before it: driven by joint servos, read by its joints.

Metres, radians, seconds; z is up, the table's top is z = 0, and the arm's base stands at the world's origin.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
import scipy.constants

from zeroshop_steps.geometry.cameras.pinhole import make_transform
from zeroshop_steps.grasp.gripper import Gripper
from zeroshop_steps.scan.arm.arm_reach import CameraHand
from zeroshop_steps.scan.arm.kinematics import JOINTS, Arm, Capsule
from zeroshop_steps.simulate.dynamics.mujoco_world import FINGERS, TABLE, add_hand, add_servo, quaternion
from zeroshop_steps.simulate.dynamics.physics import USUAL, Physics

THING, CAMERA, FLANGE = "thing", "camera", "flange"
STIFFNESS_NM_RAD, MOST_TORQUE_NM = 20000.0, 330.0  # of the servos: stiff as industrial ones; a UR10e's largest torque
ARMATURE_KG_M2 = 1.0  # of a joint: its rotor's inertia times the square of the gear's ratio of about 100
SPEED_SHARE = 0.5  # of full speed: what cells with people allow, and the camera swings less
STILL_RAD_S, MOST_SETTLE_S, SETTLE_STEP_S = 1e-4, 3.0, 0.05  # a slower arm is at rest; it is waited for as long
MOUNT_M = np.array([0.075, 0.0, 0.03])  # where the camera is on the flange: beside the palm, behind the fingertips
CAMERA_HALF_M = (0.018, 0.045, 0.0125)  # half the sides of the camera's housing, of a RealSense's size


def hand_with_camera(gripper: Gripper) -> CameraHand:
    """A gripper behind whose fingers, beside the palm, a camera looks along the hand's z; fingers stay below its image."""
    flange_from_camera = make_transform([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], MOUNT_M)
    x, y, z = MOUNT_M.tolist()
    radius_m = max(gripper.palm_size_m[:2]) / 2
    tip_m = float(flange_from_gripper(gripper)[2, 3]) + gripper.tip_m
    body = (
        Capsule(JOINTS, (0.0, 0.0, 0.0), (0.0, 0.0, tip_m - radius_m), radius_m),
        Capsule(JOINTS, (x, y - CAMERA_HALF_M[1], z), (x, y + CAMERA_HALF_M[1], z), 1.5 * CAMERA_HALF_M[0]),
    )
    return CameraHand(flange_from_camera, body)


def flange_from_gripper(gripper: Gripper) -> np.ndarray:
    """(4, 4) m: the back of the palm is on the flange."""
    return make_transform(np.eye(3), [0.0, 0.0, gripper.palm_size_m[2] - gripper.palm_front_m])


class ArmWorld:
    """The arm in motion.

    Args:
        arm: its kinematics and limits.
        hand: where the camera is.
        gripper: that it carries, closed.
        thing: (V, 3) points in the world whose convex hull the arm must not touch; none where it is None.
        joints_rad: (6,) where it starts; home by default.
    """

    def __init__(
        self,
        arm: Arm,
        hand: CameraHand,
        gripper: Gripper,
        thing: np.ndarray | None = None,
        joints_rad: np.ndarray | None = None,
        physics: Physics = USUAL,
    ) -> None:
        self.arm, self.hand, self.physics = arm, hand, physics
        self._names = [f"joint_{joint + 1}" for joint in range(JOINTS)]
        self.model = self._build(gripper, thing)
        self.data = mujoco.MjData(self.model)
        start = np.array(arm.home_rad if joints_rad is None else joints_rad, float)
        for name, angle in zip(self._names, start, strict=True):
            self.data.joint(name).qpos[0] = angle
            self.data.actuator(name).ctrl[0] = angle
        self.touched = False
        mujoco.mj_forward(self.model, self.data)

    @property
    def joints_rad(self) -> np.ndarray:
        """(6,) what the encoders read."""
        return np.array([self.data.joint(name).qpos[0] for name in self._names])

    def camera_pose(self) -> np.ndarray:
        """(4, 4) world_from_camera where it truly is, with OpenCV's axes."""
        return make_transform(self.data.body(CAMERA).xmat.reshape(3, 3), self.data.body(CAMERA).xpos)

    def follow(self, waypoints_rad: Sequence[np.ndarray]) -> float:
        """Move through postures, and wait until the arm is at rest. Returns how far the joints are then off the last one, at most, rad.

        `touched` tells whether the arm touched the table, the thing or itself on the way.
        """
        self.touched = False
        for waypoint in waypoints_rad:
            start = np.array([self.data.actuator(name).ctrl[0] for name in self._names])
            seconds = float(self.arm.seconds_between(start, waypoint[None])[0]) / SPEED_SHARE
            count = max(1, round(seconds / self.physics.step_s))
            for step in range(count):
                # Smooth at both ends: the arm swings less than after a sudden stop.
                share = 0.5 - 0.5 * np.cos(np.pi * (step + 1) / count)
                self._drive(start + share * (waypoint - start))
                self._step(1)
        for _ in range(round(MOST_SETTLE_S / SETTLE_STEP_S)):
            self._step(round(SETTLE_STEP_S / self.physics.step_s))
            if np.abs([self.data.joint(name).qvel[0] for name in self._names]).max() < STILL_RAD_S:
                break
        return float(np.abs(self.joints_rad - waypoints_rad[-1]).max()) if len(waypoints_rad) else 0.0

    def _drive(self, joints_rad: np.ndarray) -> None:
        for name, angle in zip(self._names, joints_rad, strict=True):
            self.data.actuator(name).ctrl[0] = angle

    def _step(self, count: int) -> None:
        for _ in range(count):
            mujoco.mj_step(self.model, self.data)
            self.touched |= self.data.ncon > 0

    def _build(self, gripper: Gripper, thing: np.ndarray | None) -> mujoco.MjModel:
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        spec.option.timestep = self.physics.step_s
        spec.option.gravity = [0.0, 0.0, -scipy.constants.g]
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.worldbody.add_geom(name=TABLE, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[2.0, 2.0, 0.1])
        if thing is not None:
            spec.add_mesh(
                name=THING, uservert=np.asarray(thing, float).ravel().tolist(), inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            )
            placed = spec.worldbody.add_body(name=THING)
            placed.add_geom(name=THING, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=THING)
        bodies = [spec.worldbody.add_body(name="base")]
        step = np.eye(4)
        for joint, name in enumerate(self._names):
            body = bodies[-1].add_body(name=f"link_{joint + 1}", pos=step[:3, 3], quat=quaternion(step[:3, :3]), gravcomp=1.0)
            hinge = body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0.0, 0.0, 1.0])
            hinge.limited, hinge.range, hinge.armature = True, [self.arm.low_rad[joint], self.arm.high_rad[joint]], ARMATURE_KG_M2
            add_servo(spec, name, STIFFNESS_NM_RAD, 2.0 * float(np.sqrt(STIFFNESS_NM_RAD * (ARMATURE_KG_M2 + 4.0))), MOST_TORQUE_NM)
            step = self.arm.fixed_steps[joint]
            bodies.append(body)
        # The first link's tube stands still with the base; what turns is inside.
        bodies[1].explicitinertial = True
        bodies[1].mass, bodies[1].inertia = 1.0, [0.01] * 3
        for number, part in enumerate(self.arm.capsules):
            _add_capsule(bodies[part.frame], part, self.arm.fixed_steps[part.frame - 1] if part.frame else np.eye(4), f"part_{number}")
        flange = bodies[-1].add_body(name=FLANGE, pos=step[:3, 3], quat=quaternion(step[:3, :3]), gravcomp=1.0)
        add_hand(spec, flange, gripper, flange_from_gripper(gripper), self.physics)
        camera = self.hand.flange_from_camera
        housing = flange.add_body(name=CAMERA, pos=camera[:3, 3], quat=quaternion(camera[:3, :3]), gravcomp=1.0)
        # Along the camera's axes: wide along x.
        half = [CAMERA_HALF_M[1], CAMERA_HALF_M[0], CAMERA_HALF_M[2]]
        housing.add_geom(name=CAMERA, type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=[0.0, 0.0, -half[2]], mass=0.1)
        _exclude_neighbours(spec, [body.name for body in bodies])
        return spec.compile()


def _add_capsule(body: mujoco.MjsBody, part: Capsule, body_from_frame: np.ndarray, name: str) -> None:
    ends = np.array([part.start_m, part.end_m]) @ body_from_frame[:3, :3].T + body_from_frame[:3, 3]
    # With the density of water, about that of such arms.
    body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=ends.ravel().tolist(), size=[part.radius_m, 0.0, 0.0])


def _exclude_neighbours(spec: mujoco.MjSpec, names: list[str]) -> None:
    """Links that meet at joints, as `clearance.MEETING` says, do not touch; neither do the base and the table."""
    wrist = [*names, FLANGE, "palm", CAMERA, *FINGERS]
    places = {name: min(place, JOINTS) for place, name in enumerate(wrist)}
    for first, one in enumerate(wrist):
        for other in wrist[first + 1 :]:
            if places[other] - places[one] <= 2 and {one, other} != set(FINGERS) and not {one, other} <= {"palm", *FINGERS}:
                spec.add_exclude(bodyname1=one, bodyname2=other)
    spec.add_exclude(bodyname1="world", bodyname2="base")
    spec.add_exclude(bodyname1="world", bodyname2="link_1")
