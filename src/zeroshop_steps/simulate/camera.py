"""What the HSR's head camera sees of a table: a photo by our renderer and depth with a sensor's noise and holes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeroshop_steps.bop.formats.bop_scenes import HALF_PX, Frame
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.viewpoints import look_at
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.robot.recognition import LiveFrame
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.synthetic.scenes.table_scene import RgbdImage, TableScene, render_raycast

WIDTH_PX, HEIGHT_PX = 640, 480
INTRINSICS = np.array([[538.391, 0.0, 315.307], [0.0, 538.085, 233.048], [0.0, 0.0, 1.0]])  # BOP's K of the HSR's camera
CENTRE_MM, TARGET_MM = np.array([-500.0, 0.0, 500.0]), np.array([0.0, 0.0, 40.0])  # the head looks down at the table from 0.7 m
MERGED_MM, SURFACE_CELLS = 3.0, 120  # of the baked light: half as fine as test sets have it, since here every image has its own


@dataclass(frozen=True)
class SensedFrame(LiveFrame):
    """An image of the simulated camera, as detectors take it."""

    @property
    def camera_from_table(self) -> np.ndarray:
        """(4, 4) mm; the robot knows it. Raises StepError where it is not on record."""
        if self.camera_from_world is None:
            raise StepError(f"{self.folder / 'scene_camera.json'} does not say where the camera is; delete the folder and make it again")
        return self.camera_from_world


def hsr_camera() -> Camera:
    """The camera above the table; world frame: the table's, mm, z up. It looks along +x."""
    return Camera("000000.png", WIDTH_PX, HEIGHT_PX, INTRINSICS + HALF_PX, look_at(CENTRE_MM, TARGET_MM))


def photograph(things: Sequence[Mesh], world_from_models: Sequence[np.ndarray], seed: Sequence[int], plain: bool = True) -> RgbdImage:
    """One image of things on a table.

    Args:
        things: true models, textured, mm.
        world_from_models: (4, 4) mm each.
        seed: of the table, the lights and the noise.
        plain: whether the table is nearly uniform, or richly textured.
    """
    rng = np.random.default_rng(seed)
    # The table then fills the image: 1.65 m wide.
    scene = TableScene(things, world_from_models, rng, plain, 110.0)
    ((camera, linear),) = render_raycast(scene, [hsr_camera()], MERGED_MM, SURFACE_CELLS)
    return scene.photograph(camera, linear, rng)


def in_memory(frame: Frame) -> SensedFrame:
    """An image from files."""
    photo = frame.color()
    if photo is None:
        raise StepError(f"{frame.folder / 'rgb'} has no image {frame.image_id:06d}; delete the folder and make it again")
    return SensedFrame(
        frame.scene_id, frame.image_id, frame.intrinsics, frame.depth_scale, frame.camera_from_world, frame.instances, frame.folder,
        photo=photo, measured_mm=frame.depth_mm(),
    )  # fmt: skip
