"""A table with objects and distractors on it, photographed as RGB-D images from around."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.geometry.cameras.viewpoints import direction_at, look_at
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.open3d_loader import ray_caster
from zeroshop_steps.synthetic.rendering.depth_sensor import take_depth_image
from zeroshop_steps.synthetic.rendering.lighting import SURFACE_CELLS, Lights, place_lights
from zeroshop_steps.synthetic.rendering.renderer import SceneRenderer, expose
from zeroshop_steps.synthetic.scenes.camera_rings import ObjectBounds
from zeroshop_steps.synthetic.scenes.clutter import RigidBody
from zeroshop_steps.synthetic.scenes.scene_meshes import make_object_mesh, make_surface_mesh

TILE_PX, MARGIN_PX = 768, 8  # of each texture in the common one, and around it
TABLE_SIZE_MM = 150.0  # tables are laid out for an object of at least this size
MERGED_MM = 1.5  # samples of light closer than this that face the same way share theirs
FOCAL_IN_WIDTHS = 1066.8 / 640.0  # YCB-Video's camera
ELEVATIONS_DEG = (25.0, 65.0)  # of the cameras
DISTANCES = (0.7, 1.0)  # 1 where the clutter's radius fills half of the image's height
LIGHT_CHANGES, TINTS = (0.25, 1.75), (0.9, 1.1)  # factors of each light, and of each colour of a photo
BRIGHT_LEVELS = (0.55, 0.85)  # linear light of the 90th percentile of a photo
AIM_DEVIATION = 0.08  # of what a camera aims at, in radii of the clutter
PRINCIPAL_POINT = (0.489, 0.503)  # in widths and heights of the image, a little off its middle as in real cameras


@dataclass(frozen=True)
class RgbdImage:
    """One image of a scene.

    Attributes:
        camera: where it was taken from; world frame: the table's, mm.
        image: (height, width, 3) uint8.
        exact_mm: (height, width) exact depth, 0 where there is nothing.
        measured_mm: (height, width) depth as a sensor gives it.
    """

    camera: Camera
    image: np.ndarray
    exact_mm: np.ndarray
    measured_mm: np.ndarray


class TableScene:
    """Objects on a table under lights of its own.

    Attributes:
        world: all that stands on the table, as one mesh.
        table: the table's top.
        bounds: what lights are placed by.
        lights: six area lights and the sky.
        seed: of the table's texture and of what renders it.
    """

    def __init__(
        self,
        things: Sequence[Mesh],
        world_from_models: Sequence[np.ndarray],
        rng: np.random.Generator,
        plain: bool,
        least_radius_mm: float = 0.0,
    ) -> None:
        """`plain` chooses a nearly uniform table, else it is richly textured. It is as large as for things within `least_radius_mm`."""
        self.world = merge_meshes([transform_mesh(mesh, pose) for mesh, pose in zip(things, world_from_models, strict=True)])
        low, high = self.world.vertices.min(0), self.world.vertices.max(0)
        self._radius_mm = max(least_radius_mm, float(np.linalg.norm(self.world.vertices[:, :2], axis=1).max()))
        self._middle = np.array([0.0, 0.0, (low[2] + high[2]) / 3])
        self.bounds = ObjectBounds((low + high) / 2, 1.5 * self._radius_mm, 0.0, float(rng.uniform(0, 360)))
        self.seed = int(rng.integers(2**31))
        table = make_surface_mesh("su_l" if plain else "su_h", self.bounds, self.seed)
        assert table is not None, "these scenes have a surface"
        self.table = table
        self.lights = vary_lights(self.bounds, rng)
        self._scene = ray_caster((self.world.vertices, self.world.faces), (self.table.vertices, self.table.faces))

    def photograph(self, camera: Camera, linear: np.ndarray, rng: np.random.Generator) -> RgbdImage:
        """The photo of (height, width, 3) linear light, its exposure and white balance off a little, and the depth."""
        linear = linear * rng.uniform(*TINTS, 3).astype(np.float32)
        linear *= rng.uniform(*BRIGHT_LEVELS) / max(float(np.percentile(linear, 90)), 1e-6)
        depth, measured = take_depth_image(self._scene, camera, rng)
        return RgbdImage(camera, expose(linear, rng), depth, measured)

    def sample_camera(self, width_px: int, height_px: int, name: str, rng: np.random.Generator) -> Camera:
        """A camera on a random side."""
        focal_px = FOCAL_IN_WIDTHS * width_px
        elevation, azimuth = np.radians(rng.uniform(*ELEVATIONS_DEG)), rng.uniform(0, 2 * np.pi)
        distance_mm = rng.uniform(*DISTANCES) * self._radius_mm * focal_px / (height_px / 2)
        direction = direction_at(azimuth, elevation)
        target = self._middle + rng.normal(0, AIM_DEVIATION * self._radius_mm, 3)
        roll = np.eye(4)
        angle = rng.normal(0, np.radians(4.0))
        roll[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        intrinsics = np.array([[focal_px, 0, width_px * PRINCIPAL_POINT[0]], [0, focal_px, height_px * PRINCIPAL_POINT[1]], [0, 0, 1]])
        return Camera(name, width_px, height_px, intrinsics, roll @ look_at(target + distance_mm * direction, target))


@dataclass(frozen=True)
class TableBackend:
    """What differs between the renderers of tables.

    Attributes:
        settle: gives bodies that are to be at rest on the table `scene_id` their (4, 4) table_from_model.
        render: gives each camera of the table `scene_id` its linear light.
        clear: removes what the renderer kept for the case of an interruption.
    """

    settle: Callable[[int, Sequence[RigidBody], np.random.Generator], list[np.ndarray]]
    render: Callable[[int, TableScene, Iterable[Camera]], Iterator[tuple[Camera, np.ndarray]]]
    clear: Callable[[], None] = lambda: None


def render_raycast(
    scene: TableScene, cameras: Iterable[Camera], merged_mm: float = MERGED_MM, surface_cells: int = SURFACE_CELLS
) -> Iterator[tuple[Camera, np.ndarray]]:
    """Each camera and the (height, width, 3) linear light that the embedded ray caster gives it; a camera is taken when it is due.

    For `merged_mm` and `surface_cells` see `lighting.bake_light`.
    """
    parts = [make_object_mesh(scene.world), scene.table]
    renderer = SceneRenderer(parts, scene.bounds, scene.seed, scene.lights, merged_mm, surface_cells=surface_cells)
    for camera in cameras:
        yield camera, renderer.render(camera).linear


def vary_lights(bounds: ObjectBounds, rng: np.random.Generator) -> Lights:
    """The captures' six area lights, each stronger or weaker at random, and so the sky."""
    lights = place_lights(bounds, on_surface=True)
    factors = rng.uniform(*LIGHT_CHANGES, 7)
    return replace(lights, radiances=lights.radiances * factors[:6], sky=lights.sky * float(factors[6]))


def transform_mesh(mesh: Mesh, pose: np.ndarray) -> Mesh:
    """A mesh moved by a rigid (4, 4) transform."""
    return replace(mesh, vertices=transform_points(mesh.vertices, pose), normals=mesh.vertex_normals @ pose[:3, :3].T)


def merge_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """Textured meshes as one, their textures on the tiles of one picture."""
    columns = int(np.ceil(np.sqrt(len(meshes))))
    rows = int(np.ceil(len(meshes) / columns))
    inner = TILE_PX - 2 * MARGIN_PX
    texture = np.zeros((rows * TILE_PX, columns * TILE_PX, 3), np.uint8)
    uvs = []
    for index, mesh in enumerate(meshes):
        row, column = divmod(index, columns)
        tile = cv2.resize(mesh.texture_image, (inner, inner), interpolation=cv2.INTER_AREA)
        tile = cv2.copyMakeBorder(tile, MARGIN_PX, MARGIN_PX, MARGIN_PX, MARGIN_PX, cv2.BORDER_REPLICATE)
        texture[row * TILE_PX : (row + 1) * TILE_PX, column * TILE_PX : (column + 1) * TILE_PX] = tile
        inside = np.clip(mesh.texture_coordinates, 0, 1) * inner + MARGIN_PX
        uvs.append((inside + [column * TILE_PX, (rows - 1 - row) * TILE_PX]) / [columns * TILE_PX, rows * TILE_PX])
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts[:-1], strict=True)])
    vertices, normals = (np.concatenate([getattr(mesh, name) for mesh in meshes]) for name in ("vertices", "normals"))
    return Mesh(vertices, faces, normals, np.concatenate(uvs), texture)
