"""The simulated world obeys what is known of it: rest, friction, force, and a hand that can be blocked."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.constants

from zeroshop_steps.grasp.gripper import GRIPPERS
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.simulate.dynamics.lifting import lift, settle
from zeroshop_steps.simulate.dynamics.physical_body import PhysicalBody, read_body, write_body
from zeroshop_steps.simulate.dynamics.physics import USUAL, Physics

pytest.importorskip("mujoco", reason="needs zeroshop[robot]")
HSR = GRIPPERS["hsr"]
SIZE_M = np.array([0.06, 0.05, 0.1])


def box(mass_kg: float, size_m: np.ndarray = SIZE_M) -> PhysicalBody:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size_m / 2
    inertia = mass_kg / 12 * np.diag((size_m**2).sum() - size_m**2)
    return PhysicalBody((corners,), mass_kg, np.zeros(3), inertia)


def standing(height_m: float = SIZE_M[2], above_m: float = 0.0) -> np.ndarray:
    pose = np.eye(4)
    pose[2, 3] = height_m / 2 + above_m
    return pose


def from_above(height_m: float, aside_m: float = 0.0) -> np.ndarray:
    """world_from_gripper with the middle of the pads at this height."""
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = [0.0, aside_m, height_m + HSR.tcp_m]
    return pose


def grasp(body: PhysicalBody, height_m: float, opening_m: float, physics: Physics = USUAL, aside_m: float = 0.0) -> str:
    return lift(body, standing(), HSR, from_above(height_m, aside_m), opening_m, physics).result


def test_what_is_at_rest_stays() -> None:
    rest = settle(box(0.5), standing(), HSR, USUAL)
    assert np.abs(rest - standing()).max() < 1e-4


def test_what_is_let_go_comes_to_rest_on_the_table() -> None:
    rest = settle(box(0.5), standing(above_m=0.02), HSR, USUAL)
    assert rest[2, 3] == pytest.approx(SIZE_M[2] / 2, abs=2e-4)
    assert rest[2, 2] > 0.9999


def test_a_grasp_through_the_centre_holds() -> None:
    done = lift(box(0.5), standing(), HSR, from_above(0.06), 0.08, USUAL)
    assert done.result == "success"
    assert done.slip_mm < 1.0
    assert [one.stage for one in done.snapshots] == ["approach", "close", "lift", "hold", "shake"]
    assert done.snapshots[2].world_from_object[2, 3] == pytest.approx(0.05 + USUAL.lift_m, abs=0.005)
    assert done.world_from_object[2, 3] == pytest.approx(0.05, abs=0.002)  # it is put back


@pytest.mark.parametrize(
    ("height_m", "opening_m", "aside_m", "failed"),
    [(0.15, 0.08, 0.0, "close"), (0.06, 0.045, 0.0, "approach"), (0.06, 0.135, 0.06, "approach")],
    ids=["above", "too_narrow", "aside"],
)
def test_a_wrong_grasp_fails_where_it_must(height_m: float, opening_m: float, aside_m: float, failed: str) -> None:
    assert grasp(box(0.5), height_m, opening_m, aside_m=aside_m) == failed


def test_friction_and_force_decide_what_can_be_lifted() -> None:
    most_kg = 2 * USUAL.finger_force_n * USUAL.friction / scipy.constants.g
    assert grasp(box(0.8 * most_kg), 0.05, 0.08, replace(USUAL, shake_m=0.0)) == "success"
    assert grasp(box(1.2 * most_kg), 0.05, 0.08, replace(USUAL, shake_m=0.0)) == "lift"
    assert grasp(box(0.8 * most_kg), 0.05, 0.08, replace(USUAL, friction=USUAL.friction / 2)) == "lift"


def test_the_same_attempt_has_the_same_numbers() -> None:
    first, second = (lift(box(0.5), standing(), HSR, from_above(0.06), 0.08, USUAL) for _ in range(2))
    assert np.array_equal(first.snapshots[-1].world_from_object, second.snapshots[-1].world_from_object)


def test_a_body_is_written_and_read(tmp_path) -> None:
    body = PhysicalBody((*box(0.5).parts, np.eye(3)), 0.5, np.array([0.0, 0.0, 0.01]), np.eye(3) * 1e-3)
    write_body(tmp_path / "body.npz", body)
    read = read_body(tmp_path / "body.npz")
    assert [len(part) for part in read.parts] == [8, 3]
    assert np.array_equal(read.inertia, body.inertia)
    (tmp_path / "body.npz").write_bytes(b"PK")
    with pytest.raises(StepError, match="holds no physical body"):
        read_body(tmp_path / "body.npz")
