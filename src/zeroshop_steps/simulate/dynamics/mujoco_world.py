"""The world in MuJoCo: a table, one object, and a parallel gripper that a compliant arm moves without turning it.

Metres, kilograms, seconds; z is up and the table's top is z = 0. The gripper has no arm below it: it reaches every place.
"""

from collections.abc import Iterator

import mujoco
import numpy as np
import scipy.constants
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.pinhole import make_transform
from zeroshop_steps.grasp.gripper import Gripper
from zeroshop_steps.simulate.dynamics.physical_body import PhysicalBody
from zeroshop_steps.simulate.dynamics.physics import Physics

# Contacts are stiff and springs of the servos are damped critically: a choice of the solver, not of the robot.
SOLREF, SOLIMP = (0.005, 1.0), (0.95, 0.99, 0.001, 0.5, 2.0)
SERVO_STIFFNESS = 2000.0  # N/m of each finger's servo, before its force is limited
ARMATURE_KG = 0.2  # of a finger: what its motor's rotor adds
CARRIAGE_AXES = ("carriage_x", "carriage_y", "carriage_z")
FINGERS = ("left", "right")  # towards +y and -y of the gripper
OBJECT, PALM, TABLE = "object", "palm", "table"


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """(4,) w, x, y, z of a (3, 3) rotation."""
    return Rotation.from_matrix(rotation).as_quat()[[3, 0, 1, 2]]


def build_model(
    body: PhysicalBody, world_from_object: np.ndarray, gripper: Gripper, world_from_gripper: np.ndarray, physics: Physics
) -> mujoco.MjModel:
    """The world with the object at its place and the open gripper at its own, (4, 4) each in metres."""
    spec = mujoco.MjSpec()
    spec.option.timestep = physics.step_s
    spec.option.gravity = [0.0, 0.0, -scipy.constants.g]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0
    table = spec.worldbody.add_geom(name=TABLE, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1.0, 1.0, 0.1])
    _set_contact(table, physics)
    _add_object(spec, body, world_from_object, physics)
    _add_gripper(spec, gripper, world_from_gripper, physics)
    return spec.compile()


def _set_contact(geom: mujoco.MjsGeom, physics: Physics) -> None:
    geom.condim = 6
    geom.friction = [physics.friction, physics.torsion_m, physics.rolling_m]
    geom.solref, geom.solimp = SOLREF, SOLIMP


def _add_object(spec: mujoco.MjSpec, body: PhysicalBody, world_from_object: np.ndarray, physics: Physics) -> None:
    placed = spec.worldbody.add_body(name=OBJECT, pos=world_from_object[:3, 3], quat=quaternion(world_from_object[:3, :3]))
    placed.add_freejoint(name=OBJECT)
    placed.explicitinertial = True
    placed.mass, placed.ipos = body.mass_kg, body.centre_m
    inertia = body.inertia
    placed.fullinertia = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    for number, part in enumerate(body.parts):
        spec.add_mesh(name=f"part_{number}", uservert=part.ravel().tolist(), inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
        geom = placed.add_geom(name=f"part_{number}", type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"part_{number}", mass=0.0)
        _set_contact(geom, physics)


def _add_gripper(spec: mujoco.MjSpec, gripper: Gripper, world_from_gripper: np.ndarray, physics: Physics) -> None:
    """The carriage slides along the world's axes; the palm is fixed to it, turned as the grasp says; the fingers slide along its y."""
    carriage = spec.worldbody.add_body(name="carriage", pos=world_from_gripper[:3, 3], gravcomp=1.0)
    damping = 2.0 * np.sqrt(physics.arm_stiffness_n_m * (physics.hand_mass_kg + 2 * physics.finger_mass_kg))
    for name, axis in zip(CARRIAGE_AXES, np.eye(3), strict=True):
        carriage.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        add_servo(spec, name, physics.arm_stiffness_n_m, float(damping), physics.arm_force_n)
    turned = make_transform(world_from_gripper[:3, :3], np.zeros(3))
    add_hand(spec, carriage, gripper, turned, physics)
    for finger in FINGERS:
        spec.add_exclude(bodyname1="carriage", bodyname2=finger)


def add_hand(
    spec: mujoco.MjSpec, carrier: mujoco.MjsBody, gripper: Gripper, carrier_from_gripper: np.ndarray, physics: Physics
) -> mujoco.MjsBody:
    """Fix a gripper to what carries it, (4, 4) in metres; its fingers slide along its y. Returns the palm."""
    palm = carrier.add_body(name=PALM, pos=carrier_from_gripper[:3, 3], quat=quaternion(carrier_from_gripper[:3, :3]), gravcomp=1.0)
    palm.explicitinertial = True
    palm.mass, palm.inertia = physics.hand_mass_kg, [0.001] * 3
    boxes = gripper.boxes(np.zeros(1))[0]
    _set_contact(_add_box(palm, PALM, boxes[2]), physics)
    most = gripper.max_opening_m / 2
    for name, box, sign in zip(FINGERS, boxes[:2], (1.0, -1.0), strict=True):
        finger = palm.add_body(name=name, gravcomp=1.0)
        finger.explicitinertial = True
        finger.mass, finger.inertia = physics.finger_mass_kg, [0.0001] * 3
        joint = finger.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0.0, sign, 0.0])
        joint.limited, joint.range, joint.armature = True, [0.0, most], ARMATURE_KG
        geom = _add_box(finger, name, box)
        _set_contact(geom, physics)
        moved = physics.finger_mass_kg + ARMATURE_KG
        add_servo(spec, name, SERVO_STIFFNESS, 2.0 * float(np.sqrt(SERVO_STIFFNESS * moved)), physics.finger_force_n)
    spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT, name1="left", name2="right", data=[0, 1] + [0] * 10)
    for one, other in (("left", "right"), (PALM, "left"), (PALM, "right")):
        spec.add_exclude(bodyname1=one, bodyname2=other)
    return palm


def _add_box(body: mujoco.MjsBody, name: str, box: np.ndarray) -> mujoco.MjsGeom:
    low, high = box
    return body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, pos=(low + high) / 2, size=(high - low) / 2, mass=0.0)


def add_servo(spec: mujoco.MjSpec, joint: str, stiffness: float, damping: float, most: float) -> None:
    """Drive a joint to a position, with a spring and damper of at most this force or torque."""
    servo = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.gaintype, servo.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    servo.gainprm[0], servo.biasprm[1], servo.biasprm[2] = stiffness, -stiffness, -damping
    servo.forcelimited, servo.forcerange = True, [-most, most]


class World:
    """The world in motion. Transforms are (4, 4) in metres."""

    def __init__(
        self, body: PhysicalBody, world_from_object: np.ndarray, gripper: Gripper, world_from_gripper: np.ndarray, physics: Physics
    ) -> None:
        """The gripper starts fully open at `world_from_gripper`."""
        self.physics = physics
        self.model = build_model(body, world_from_object, gripper, world_from_gripper, physics)
        self.data = mujoco.MjData(self.model)
        self._start = world_from_gripper
        self._ranges = {OBJECT: self._geoms_of(OBJECT), **{name: self._geoms_of(name) for name in FINGERS}}
        self.set_opening(gripper.max_opening_m)
        mujoco.mj_forward(self.model, self.data)

    def set_opening(self, opening_m: float) -> None:
        """Put the fingers there at once, and have their servos keep them there."""
        for name in FINGERS:
            self.data.joint(name).qpos[0] = opening_m / 2
            self.data.actuator(name).ctrl[0] = opening_m / 2

    def object_pose(self) -> np.ndarray:
        """world_from_object."""
        return self._pose(OBJECT)

    def gripper_pose(self) -> np.ndarray:
        """world_from_gripper."""
        return self._pose(PALM)

    def opening_m(self) -> float:
        """The distance between the pads."""
        return float(sum(self.data.joint(name).qpos[0] for name in FINGERS))

    def object_speed(self) -> float:
        """Of its centre in m/s plus that of its turning in rad/s times 5 cm."""
        velocity = self.data.joint(OBJECT).qvel
        return float(np.linalg.norm(velocity[:3]) + 0.05 * np.linalg.norm(velocity[3:]))

    def both_pads_touch(self) -> bool:
        """Whether both fingers touch the object."""
        touching = {name: False for name in FINGERS}
        for pair in self.data.contact.geom:
            for name in FINGERS:
                touching[name] |= any(pair[i] in self._ranges[name] and pair[1 - i] in self._ranges[OBJECT] for i in (0, 1))
        return all(touching.values())

    def run(self, seconds: float) -> None:
        """Let time pass."""
        for _ in range(round(seconds / self.physics.step_s)):
            mujoco.mj_step(self.model, self.data)

    def move_hand(self, target_m: np.ndarray, speed_m_s: float) -> float:
        """Move the gripper's origin straight to a place in the world, then wait a little. Returns how far off it ends, in metres."""
        start = self.hand_target_m()
        for share in self._shares(float(np.linalg.norm(target_m - start)) / speed_m_s):
            self.set_hand_target(start + share * (target_m - start))
            mujoco.mj_step(self.model, self.data)
        self.run(0.2)
        return float(np.linalg.norm(self.gripper_pose()[:3, 3] - target_m))

    def close_fingers(self) -> None:
        """Close until the fingers push with their full force, or meet."""
        start, deep = self.opening_m() / 2, -2.0 * self.physics.finger_force_n / SERVO_STIFFNESS
        for share in self._shares((start - deep) / self.physics.closing_m_s):
            for name in FINGERS:
                self.data.actuator(name).ctrl[0] = start + share * (deep - start)
            mujoco.mj_step(self.model, self.data)
        self.run(0.2)

    def hand_target_m(self) -> np.ndarray:
        """(3,) where the servos want the gripper's origin."""
        return self._start[:3, 3] + np.array([self.data.actuator(name).ctrl[0] for name in CARRIAGE_AXES])

    def set_hand_target(self, target_m: np.ndarray) -> None:
        """Have the servos move the gripper's origin to a place in the world."""
        for name, value in zip(CARRIAGE_AXES, target_m - self._start[:3, 3], strict=True):
            self.data.actuator(name).ctrl[0] = value

    def _shares(self, seconds: float) -> Iterator[float]:
        count = max(1, round(seconds / self.physics.step_s))
        return ((step + 1) / count for step in range(count))

    def _pose(self, name: str) -> np.ndarray:
        return make_transform(self.data.body(name).xmat.reshape(3, 3), self.data.body(name).xpos)

    def _geoms_of(self, name: str) -> set[int]:
        number = self.model.body(name).id
        return {geom for geom in range(self.model.ngeom) if self.model.geom_bodyid[geom] == number}
