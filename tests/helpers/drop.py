"""Drop the body of an MJCF file onto a plane in MuJoCo."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

HEIGHT_M, DURATION_S, STEP_S = 0.05, 4.0, 0.002


@dataclass(frozen=True)
class Rest:
    """How a drop ended.

    Attributes:
        place_m: (3,) of the centre of mass.
        speed_m_s, turn_rad_s: how fast it still moves.
        lowest_m: height of the lowest corner of what collides; below 0 it has sunk in.
        highest_speed_m_s: on the way; a body that explodes is much faster than one that falls.
    """

    place_m: np.ndarray
    speed_m_s: float
    turn_rad_s: float
    lowest_m: float
    highest_speed_m_s: float


def drop(path: Path, seed: int, duration_s: float = DURATION_S) -> Rest:
    """Let it fall from 5 cm, turned at random."""
    import mujoco

    spec = mujoco.MjSpec.from_file(str(path))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1], condim=4)
    spec.option.timestep = STEP_S
    model = spec.compile()
    data = mujoco.MjData(model)
    x, y, z, w = Rotation.random(random_state=seed).as_quat()
    data.qpos[3:7] = w, x, y, z
    mujoco.mj_forward(model, data)
    data.qpos[2] += HEIGHT_M - _lowest(model, data)
    fastest = 0.0
    for _ in range(round(duration_s / STEP_S)):
        mujoco.mj_step(model, data)
        fastest = max(fastest, float(np.linalg.norm(data.qvel[:3])))
    mujoco.mj_forward(model, data)
    return Rest(
        data.xipos[1].copy(), float(np.linalg.norm(data.qvel[:3])), float(np.linalg.norm(data.qvel[3:6])), _lowest(model, data), fastest
    )


def _lowest(model: Any, data: Any) -> float:
    """Height of the lowest corner of the parts that collide."""
    heights = []
    for geom in range(model.ngeom):
        if model.geom_contype[geom] and model.geom_bodyid[geom] == 1:
            first, count = model.mesh_vertadr[model.geom_dataid[geom]], model.mesh_vertnum[model.geom_dataid[geom]]
            vertices = model.mesh_vert[first : first + count] @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
            heights.append(vertices[:, 2].min())
    return float(min(heights))
