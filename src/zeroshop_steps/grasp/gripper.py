"""Parallel grippers as boxes: two fingers that close along y, and the palm behind them.

The gripper frame is that of the grasps of v4r's grasping pipeline, the HSR's `hand_palm_link`: its z axis is the approach, from the
palm to the fingertips, the fingers close along its y axis, and x completes the right-handed frame. Its origin lies in the palm's
front for the HSR, and at the mount for the Robotiq.
"""

from dataclasses import dataclass

import numpy as np

from zeroshop_steps.runtime.errors import StepError


@dataclass(frozen=True)
class Gripper:
    """A parallel gripper, in metres.

    Attributes:
        name: how options call it.
        max_opening_m: the largest distance between the pads.
        finger_length_m: from the palm's front to the fingertips, along z.
        finger_width_m: along x.
        finger_thickness_m: along y, of one finger with its pad.
        pad_length_m: of the pads along z; their middle is the tool centre point (TCP).
        palm_size_m: (x, y, z) of the palm, whose front is at `palm_front_m`.
        palm_front_m: z of the palm's front in the gripper frame.
    """

    name: str
    max_opening_m: float
    finger_length_m: float
    finger_width_m: float
    finger_thickness_m: float
    pad_length_m: float
    palm_size_m: tuple[float, float, float]
    palm_front_m: float

    @property
    def tip_m(self) -> float:
        """z of the fingertips in the gripper frame."""
        return self.palm_front_m + self.finger_length_m

    @property
    def tcp_m(self) -> float:
        """z of the tool centre point, the middle between the pads, in the gripper frame."""
        return self.tip_m - self.pad_length_m / 2

    def boxes(self, openings_m: np.ndarray, behind_m: float = 0.0) -> np.ndarray:
        """(N, 3, 2, 3) lowest and highest corners, in the gripper frame, of both fingers and the palm.

        Args:
            openings_m: (N,) distances between the pads.
            behind_m: how far the boxes reach further back, along -z: what they sweep on a straight approach of that length.
        """
        half, inner = self.finger_width_m / 2, np.asarray(openings_m, float) / 2
        outer, back = inner + self.finger_thickness_m, self.palm_front_m - behind_m
        wide, tall, deep = self.palm_size_m
        boxes = np.empty((len(inner), 3, 2, 3))
        boxes[:, :2, 0, 0], boxes[:, :2, 1, 0] = -half, half
        boxes[:, :2, 0, 2], boxes[:, :2, 1, 2] = back, self.tip_m
        boxes[:, 0, 0, 1], boxes[:, 0, 1, 1] = inner, outer
        boxes[:, 1, 0, 1], boxes[:, 1, 1, 1] = -outer, -inner
        boxes[:, 2, 0], boxes[:, 2, 1] = (-wide / 2, -tall / 2, back - deep), (wide / 2, tall / 2, self.palm_front_m)
        return boxes


GRIPPERS = {
    # Toyota HSR, from its URDF and meshes (ToyotaResearchInstitute/hsr_description, hsr_meshes): at 60 mm between the pads the tips are
    # 82 mm in front of the palm, closed 88 mm, at 104 mm 67 mm; the pads are 30 x 26 mm, the palm's plate is 36 x 60 x 48 mm.
    # The fingers of this model stay where they are at 60 mm.
    "hsr": Gripper("hsr", 0.135, 0.082, 0.030, 0.012, 0.026, (0.036, 0.060, 0.048), 0.0),
    # Robotiq 2F-85, from its model in MuJoCo Menagerie: open, the pads of 22 x 37.5 mm reach from 123 to 160 mm in front of the mount.
    "robotiq_2f85": Gripper("robotiq_2f85", 0.085, 0.066, 0.022, 0.010, 0.0375, (0.075, 0.075, 0.094), 0.094),
}
"""The grippers that options name. The frame of the HSR's is `hand_palm_link`, that of Robotiq's its mount."""


def find_gripper(name: str) -> Gripper:
    """The gripper of this name. Raises StepError, which lists those that there are."""
    if name not in GRIPPERS:
        raise StepError(f"there is no gripper {name}; those that there are: {', '.join(GRIPPERS)}")
    return GRIPPERS[name]
