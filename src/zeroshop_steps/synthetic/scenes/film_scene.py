"""A table with an object and things that nobody asks for strewn around it, well apart, as films show it."""

from dataclasses import dataclass

import manifold3d
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.open3d_loader import o3d
from zeroshop_steps.synthetic.board_scene import BOARD, compute_surface_from_board, paint_board
from zeroshop_steps.synthetic.rendering import shading
from zeroshop_steps.synthetic.rendering.lighting import Lights
from zeroshop_steps.synthetic.rendering.renderer import SceneRenderer
from zeroshop_steps.synthetic.scenes.camera_rings import ObjectBounds
from zeroshop_steps.synthetic.scenes.clutter import RigidBody, choose_rest, make_body
from zeroshop_steps.synthetic.scenes.distractors import make_distractor
from zeroshop_steps.synthetic.scenes.scene_meshes import make_object_mesh, make_surface_mesh
from zeroshop_steps.synthetic.scenes.table_scene import MERGED_MM, TABLE_SIZE_MM, merge_meshes, transform_mesh, vary_lights
from zeroshop_steps.synthetic.scenes.table_tops import TABLE_TOPS, TableTop

LEAST_GAP_MM, GAP_BETWEEN_MM = 50.0, 12.0  # from the object to a distractor, and between two of them
CLEAR_VIEW_DEG = 22.0
"""Seen from this high or higher, nothing hides the object."""
SPREAD_MM = 260.0  # how much farther than that a distractor may lie
BOARD_GAP_MM = 30.0  # from the object to the board's squares
SCENE = "su_h"


@dataclass(frozen=True)
class FilmTable:
    """What stands and lies on the table.

    Attributes:
        mesh: the object, mm, upright.
        clutter: the other things, where they lie.
        bounds: what the table is laid out for: the object's middle, and a size that is not too small.
        board_pose: (4, 4) model frame from the printed board's place.
        lights: of the room.
        seed: of the surface.
        top: what the surface looks like.
    """

    mesh: Mesh
    clutter: list[Mesh]
    bounds: ObjectBounds
    board_pose: np.ndarray
    lights: Lights
    seed: int
    top: TableTop


def lay_table(mesh: Mesh, bounds: ObjectBounds, seed: int, rng: np.random.Generator, top: str = "print") -> FilmTable:
    """Lay a table around an object: `bounds` is its middle, its size and its front."""
    wide = ObjectBounds(bounds.centre_mm, max(bounds.largest_mm, TABLE_SIZE_MM), bounds.bottom_mm, bounds.front_azimuth_deg)
    pose = compute_surface_from_board(mesh, bounds, BOARD, BOARD_GAP_MM)
    clutter = scatter_distractors(mesh, bounds, pose, TABLE_TOPS[top].things, rng)
    return FilmTable(mesh, clutter, wide, pose, vary_lights(wide, rng), seed, TABLE_TOPS[top])


def scatter_distractors(mesh: Mesh, bounds: ObjectBounds, board_pose: np.ndarray, count: int, rng: np.random.Generator) -> list[Mesh]:
    """At most `count` distractors, apart from the object, from the board's place and from each other, that hide nothing of the object."""
    thing = manifold3d.Manifold.hull_points(make_body(mesh.vertices).hull)
    width, height = BOARD.size_mm
    corners = np.array([[x, y, z, 1.0] for x in (0, width) for y in (0, height) for z in (-1, 1)])
    placed = [manifold3d.Manifold.hull_points((corners @ board_pose.T)[:, :3])]
    foot = np.array([*bounds.centre_mm[:2], bounds.bottom_mm])
    reach_mm = float(np.linalg.norm((mesh.vertices - foot)[:, :2], axis=1).max())
    found = []
    for _ in range(count):
        other = make_distractor(rng)
        body = make_body(other.vertices)
        # Without a place it is left out.
        for _ in range(400):
            pose = _choose_pose(body, foot, reach_mm, rng)
            shape = manifold3d.Manifold.hull_points(transform_points(body.hull, pose))
            tall_mm = float((body.vertices @ pose[2, :3] + pose[2, 3]).max() - foot[2])
            gap_mm = max(LEAST_GAP_MM, tall_mm / np.tan(np.radians(CLEAR_VIEW_DEG)))
            if shape.min_gap(thing, gap_mm) >= gap_mm and all(shape.min_gap(one, GAP_BETWEEN_MM) >= GAP_BETWEEN_MM for one in placed):
                placed.append(shape)
                found.append(transform_mesh(other, pose))
                break
    return found


def _choose_pose(body: RigidBody, foot: np.ndarray, reach_mm: float, rng: np.random.Generator) -> np.ndarray:
    """(4, 4) model_from_distractor: at rest somewhere around the object."""
    pose = choose_rest(body, rng)
    radius_mm, angle = reach_mm + LEAST_GAP_MM + SPREAD_MM * rng.uniform(), rng.uniform(0, 2 * np.pi)
    pose[:3, 3] += foot + [radius_mm * np.cos(angle), radius_mm * np.sin(angle), 0.0]
    return pose


class FilmRenderer:
    """Renders a table, with or without the object and the board."""

    def __init__(self, table: FilmTable, with_object: bool, with_board: bool) -> None:
        def lay(texture: np.ndarray) -> None:
            paint_board(texture, BOARD, table.board_pose, table.bounds)

        things = [table.mesh, *table.clutter] if with_object else table.clutter
        surface = make_surface_mesh(SCENE, table.bounds, table.seed, lay if with_board else None, table.top.make_texture)
        assert surface is not None, "this scene has a surface"
        self._renderer = SceneRenderer(
            [make_object_mesh(merge_meshes(things)), surface], table.bounds, table.seed, table.lights, MERGED_MM, table.top.mirror
        )
        self._object_faces = len(table.mesh.faces) if with_object else 0
        self._vertices = table.mesh.vertices
        low, high = self._vertices.min(0), self._vertices.max(0)
        self.landmarks_mm = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        """(8, 3) the corners of the object's box."""

    def render(self, camera: Camera) -> np.ndarray:
        """(height, width, 3) float32 linear light."""
        return self._renderer.render(camera).linear

    def render_mask(self, camera: Camera) -> np.ndarray:
        """(height, width) bool: pixels whose middle shows the object."""
        return find_object_pixels(self._renderer.scene, camera, self._vertices, self._object_faces)


def find_object_pixels(scene: o3d.t.geometry.RaycastingScene, camera: Camera, vertices: np.ndarray, faces: int) -> np.ndarray:
    """(height, width) bool: pixels whose middle shows the object, which has the (V, 3) vertices and the first `faces` of geometry 0."""
    mask = np.zeros((camera.height_px, camera.width_px), bool)
    pixels, _ = camera.project(vertices)
    low = np.clip(np.floor(pixels.min(0)).astype(int), 0, mask.shape[::-1])
    high = np.clip(np.ceil(pixels.max(0)).astype(int) + 1, 0, mask.shape[::-1])
    if (high <= low).any():
        return mask
    grid = np.stack(np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5), -1)
    rays = shading.make_camera_rays(grid.reshape(-1, 2), camera.intrinsics, np.linalg.inv(camera.camera_from_world))
    hits = scene.cast_rays(o3d.core.Tensor(rays))
    own = (hits["geometry_ids"].numpy() == 0) & (hits["primitive_ids"].numpy() < faces)
    mask[low[1] : high[1], low[0] : high[0]] = own.reshape(grid.shape[:2])
    return mask
