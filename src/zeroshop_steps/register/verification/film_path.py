"""Check cameras by the order of a film: between two frames that follow each other, the camera does not jump to another side.

Views of different sides that were laid onto each other agree in all else. The order of photos says nothing, that of frames does.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.transforms import measure_turn_deg
from zeroshop_steps.register.scene.record import Finding

JUMP_DEG = 75.0
JUMP_RATIO = 3.0
"""Between neighbours, the camera turns by less than this angle, or less than this many times what it turns in the median: up to 61 degrees
in right models of 20 frames in two rounds, 94 and more in wrong ones."""


def find_jump(model: pycolmap.Reconstruction, cuts: Sequence[int] = ()) -> Finding | None:
    """Where the camera turns most between two neighbours; None where no two frames follow each other.

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
        return None
    limit_deg = max(JUMP_DEG, JUMP_RATIO * float(np.median(turns[next_to])))
    jumps = np.flatnonzero(next_to & (turns > limit_deg))
    worst = int(np.where(next_to, turns, 0.0).argmax())
    pair = f"{names[worst]} and {names[worst + 1]}, which follow each other in the film"
    found = f"between {pair}, the camera would turn by {turns[worst]:.0f} degrees"
    alone = [index + 1 for index in jumps[:-1] if index + 1 in jumps]
    return Finding("jump", float(turns[worst] / limit_deg), found, (names[alone[0]],) if alone else ())
