"""The numbers of the simulated robot and its world. They were chosen before the first table and are not tuned on one.

docs/stages/simulate.md says where each is from.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Physics:
    """The world, the arm and the hand.

    Attributes:
        friction: coefficient of Coulomb friction of the object with the pads and with the table.
        torsion_m: of friction about a contact's normal: the radius of a soft pad's contact times the coefficient.
        rolling_m: of friction against rolling.
        finger_force_n: with which each finger closes. 2 x 25 N x 0.5 hold twice the HSR's payload of 1.2 kg.
        arm_stiffness_n_m, arm_force_n: of the arm that holds the hand: it gives way, and never pushes harder.
        hand_mass_kg, finger_mass_kg: what the arm and the fingers move.
        closing_m_s: speed of each finger.
        approach_m_s, lift_m_s: speeds of the hand.
        standoff_m: how far before the grasp the straight approach begins.
        lift_m: how high the object is lifted.
        hold_s: how long it is held still, and how long it is shaken along each axis.
        shake_m, shake_hz: amplitude and frequency: 2.4 m/s2 at most.
        step_s: of the integrator.
    """

    friction: float = 0.5
    torsion_m: float = 0.005
    rolling_m: float = 0.0001
    finger_force_n: float = 25.0
    arm_stiffness_n_m: float = 3000.0
    arm_force_n: float = 60.0
    hand_mass_kg: float = 1.0
    finger_mass_kg: float = 0.1
    closing_m_s: float = 0.05
    approach_m_s: float = 0.15
    lift_m_s: float = 0.15
    standoff_m: float = 0.10
    lift_m: float = 0.20
    hold_s: float = 1.0
    shake_m: float = 0.015
    shake_hz: float = 2.0
    step_s: float = 0.002


USUAL = Physics()
