"""Where several things stand on a table, so that their silhouettes in the HSR's image touch, or do not."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.bop.formats.bop_scenes import HALF_PX
from zeroshop_steps.bop.scoring.depth_render import DepthRenderer
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.simulate.camera import HEIGHT_PX, WIDTH_PX, hsr_camera
from zeroshop_steps.synthetic.scenes.clutter import RigidBody, place_bodies

CLEAR_GAP_MM, CLOSE_GAP_MM = 20.0, 3.0  # between convex hulls, at least: room for a finger, and hardly any
CLEAR_PX = 6  # between silhouettes, at least, where things are to be clear of one another
TRIES = 5  # whole tables that are drawn before it is given up


@dataclass(frozen=True)
class Layout:
    """The things of one table.

    Attributes:
        bodies: their shapes.
        renderers: of the same models, in the same order.
    """

    bodies: Sequence[RigidBody]
    renderers: Sequence[DepthRenderer]

    def draw(self, rng: np.random.Generator, clear: bool) -> list[np.ndarray]:
        """(4, 4) table_from_model of each thing, mm, all wholly in the image.

        Args:
            rng: of the places and of how things lie.
            clear: whether no silhouette touches another; otherwise each touches one.

        Raises:
            StepError: there is no such place for a thing, mostly because all are too large together.
        """
        for attempt in range(TRIES):
            try:
                return self._draw_once(rng, clear)
            except StepError:
                if attempt == TRIES - 1:
                    raise
        raise AssertionError("the last try returns or raises")

    def _draw_once(self, rng: np.random.Generator, clear: bool) -> list[np.ndarray]:
        taken = np.zeros((HEIGHT_PX, WIDTH_PX), bool)
        margin = np.ones((2 * CLEAR_PX + 1,) * 2, np.uint8) if clear else np.ones((3, 3), np.uint8)

        def accept(index: int, table_from_model: np.ndarray) -> bool:
            if not is_inside(transform_points(self.bodies[index].hull, table_from_model)):
                return False
            seen = self._silhouette(index, table_from_model)
            touches = bool((cv2.dilate(seen.astype(np.uint8), margin).astype(bool) & taken).any())
            if taken.any() and touches == clear:
                return False
            taken[seen] = True
            return True

        return place_bodies(self.bodies, rng, CLEAR_GAP_MM if clear else CLOSE_GAP_MM, accept)

    def _silhouette(self, index: int, table_from_model: np.ndarray) -> np.ndarray:
        camera = hsr_camera()
        patch = self.renderers[index].render(camera.camera_from_world @ table_from_model, camera.intrinsics - HALF_PX, WIDTH_PX, HEIGHT_PX)
        return patch.image(WIDTH_PX, HEIGHT_PX) > 0


def is_inside(points_mm: np.ndarray) -> bool:
    """Whether (P, 3) points above the table are all in the image, a pixel from its border at least."""
    camera = hsr_camera()
    seen = transform_points(points_mm, camera.camera_from_world)
    if seen[:, 2].min() <= 0.0:
        return False
    pixels = (seen @ camera.intrinsics.T)[:, :2] / seen[:, 2:]
    return bool((pixels >= 1.0).all() and (pixels <= (WIDTH_PX - 1.0, HEIGHT_PX - 1.0)).all())
