"""Check cameras by the order of a film: between two frames that follow each other, the camera does not jump to another side.

Views of different sides that were laid onto each other agree in all else. The order of photos says nothing, that of frames does.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pycolmap

JUMP_DEG = 75.0
JUMP_RATIO = 3.0
"""Between neighbours, the camera turns by less than this angle, or less than this many times what it turns in the median: up to 61 degrees
in right models of 20 frames in two rounds, 94 and more in wrong ones."""


def find_jump(model: pycolmap.Reconstruction, cuts: Sequence[int] = ()) -> tuple[str | None, tuple[str, ...]]:
    """Where the camera turns too far between two neighbours: the reason for the user, and the image to blame, if it is one.

    Args:
        model: the cameras; its images are named by their place in the film, 000000.png and so on.
        cuts: places of the frames before which the film was cut: there, the camera may be anywhere.
    """
    images = sorted((model.images[image_id] for image_id in model.reg_image_ids()), key=lambda image: image.name)
    names = [image.name for image in images]
    rotations = [image.cam_from_world().rotation.matrix() for image in images]
    turns = np.array([measure_turn_deg(one, other) for one, other in zip(rotations, rotations[1:], strict=False)])
    places = np.array([int(Path(name).stem) for name in names])
    next_to = (np.diff(places) == 1) & ~np.isin(places[1:], cuts)
    if not next_to.any():
        return None, ()
    limit_deg = max(JUMP_DEG, JUMP_RATIO * float(np.median(turns[next_to])))
    jumps = np.flatnonzero(next_to & (turns > limit_deg))
    if not len(jumps):
        return None, ()
    first = int(jumps[0])
    reason = (
        f"the reconstruction hangs together but is wrong: between {names[first]} and {names[first + 1]}, which follow each other in the"
        f" film, the camera would turn by {turns[first]:.0f} degrees; put the object on a surface with more print, film more"
        " slowly, or take more of the film's frames (picture_count in the table of objects)"
    )
    alone = [index + 1 for index in jumps[:-1] if index + 1 in jumps]
    return reason, (names[alone[0]],) if alone else ()


def measure_turn_deg(one: np.ndarray, other: np.ndarray) -> float:
    """Angle between two (3, 3) rotations, in degrees."""
    return float(np.degrees(np.arccos(np.clip((np.trace(other @ one.T) - 1) / 2, -1, 1))))
