"""A scene as people photograph things at home: an object among others on a desk, in a room, by the light that there is.

A style is drawn from a difficulty: at 1 an easy table, at 2 one thing that makes masks hard, at 3 three of them at once.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import manifold3d
import numpy as np

from casual_captures.room import Panorama, light_by, make_book, make_packing, make_panorama, make_wall
from casual_captures.tops import TOPS, lay_paper, make_bare, make_newspaper, make_sheet
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.open3d_loader import o3d
from zeroshop_steps.synthetic.demo_objects import CATALOGUE
from zeroshop_steps.synthetic.products.assemble import make_textured_mesh
from zeroshop_steps.synthetic.rendering import shading
from zeroshop_steps.synthetic.rendering.lighting import Lights
from zeroshop_steps.synthetic.rendering.renderer import SceneRenderer
from zeroshop_steps.synthetic.scenes.camera_rings import ObjectBounds
from zeroshop_steps.synthetic.scenes.clutter import choose_rest, make_body
from zeroshop_steps.synthetic.scenes.film_scene import find_object_pixels
from zeroshop_steps.synthetic.scenes.scene_meshes import SURFACE_SIDE_IN_SIZES, make_object_mesh, make_surface_mesh
from zeroshop_steps.synthetic.scenes.table_scene import MERGED_MM, TABLE_SIZE_MM, TILE_PX, merge_meshes, transform_mesh

DIFFICULTIES = (1, 2, 3)
HARD = ("lamp", "own_color", "glossy_table", "wall", "cut_off", "short_arc", "crowded", "glossy_object", "exposure")
"""What makes masks hard: one small lamp; a bare table of the object's own colour; a table, or an object, that mirrors; a wall close
behind; photos that cut the object off; an arc of 60 to 80 degrees; things close to the object; exposure that varies, noise and blur."""
HARD_COUNTS = {1: 0, 2: 1, 3: 3}
EASY_LIGHTS = ("room", "window")
PAPERS = {"newspaper": make_newspaper, "sheet": make_sheet}
THINGS, CROWD = (1, 4), (4, 7)  # how many other things there are, and where it is crowded
GAPS_MM, CROWD_GAPS_MM = (45.0, 220.0), (10.0, 90.0)  # between the object and another thing
FULL_ROUND_DEG = 360.0


@dataclass(frozen=True)
class Style:
    """What a casual capture is like.

    Attributes:
        hard: of `HARD`, what makes its masks hard.
        arc_deg: how far the camera goes around.
        photos: how many there are.
        top: of the table: one of `TOPS`, or "bare".
        paper: what lies below the object: one of `PAPERS`, or "".
        light: room, window or lamp.
        portrait: whether the camera was held upright.
    """

    hard: tuple[str, ...]
    arc_deg: float
    photos: int
    top: str
    paper: str
    light: str
    portrait: bool


def choose_style(difficulty: int, rng: np.random.Generator) -> Style:
    """Draw a style for a difficulty."""
    hard = tuple(sorted(rng.choice(HARD, HARD_COUNTS[difficulty], replace=False).tolist()))
    arc_deg = float(rng.uniform(60, 80) if "short_arc" in hard else rng.uniform(90, 150))
    if "short_arc" not in hard and "wall" not in hard and rng.uniform() < 0.25:
        arc_deg = FULL_ROUND_DEG
    top = str(rng.choice(["desk", "desk", "desk", "cloth", "print", "bare"]))
    if "own_color" in hard:
        top = "bare"
    elif "glossy_table" in hard:
        top = str(rng.choice(["desk", "bare"]))
    paper = "" if {"own_color", "glossy_table"} & set(hard) else str(rng.choice(["", "", "newspaper", "sheet"]))
    light = "lamp" if "lamp" in hard else str(rng.choice(EASY_LIGHTS))
    photos = int(rng.integers(12, 15) if arc_deg == FULL_ROUND_DEG else rng.integers(8, 13))
    return Style(hard, arc_deg, photos, top, paper, light, bool(rng.uniform() < 0.4))


@dataclass(frozen=True)
class CasualScene:
    """What there is to photograph, mm, z up.

    Attributes:
        mesh: the object.
        others: all else that stands around.
        bounds: the object's middle and a size that is not too small, which the table and the light are laid out for.
        texture: (texels, texels, 3) uint8 of the table, with what lies on it.
        room: what is far off.
        lights: of the scene.
        mirror, gloss: reflectances at normal incidence of the table and of the object; 0 for matt ones.
        seed: of what bakes the light.
    """

    mesh: Mesh
    others: Sequence[Mesh]
    bounds: ObjectBounds
    texture: np.ndarray
    room: Panorama
    lights: Lights
    mirror: float
    gloss: float
    seed: int


def lay_scene(mesh: Mesh, bounds: ObjectBounds, style: Style, cameras: Sequence[Camera], rng: np.random.Generator) -> CasualScene:
    """Lay a scene of a style around an object, so that its cameras, which stand at the object's front, see it."""
    wide = ObjectBounds(bounds.centre_mm, max(bounds.largest_mm, TABLE_SIZE_MM), bounds.bottom_mm, bounds.front_azimuth_deg)
    front = np.radians(bounds.front_azimuth_deg)
    reach_mm = float(np.linalg.norm((mesh.vertices - bounds.centre_mm)[:, :2], axis=1).max())
    others: list[Mesh] = []
    walled = "wall" in style.hard
    wall_mm = reach_mm + rng.uniform(15.0, 130.0)
    if walled:
        others.append(make_wall(wide, front + np.pi + rng.normal(0, 0.12), wall_mm, rng))
    room_mm = wall_mm if walled else np.inf
    others += _scatter(mesh, wide, reach_mm, room_mm, "crowded" in style.hard, cameras, rng)
    light_azimuth = front + rng.uniform(-1.0, 1.0) * np.pi * (0.5 if walled else 1.0)
    return CasualScene(
        mesh,
        others,
        wide,
        _make_ground(mesh, wide, style, rng),
        make_panorama(rng),
        light_by(style.light, wide, light_azimuth, rng),
        0.06 if "glossy_table" in style.hard else 0.0,
        # The reflectance of a glossy object at normal incidence.
        0.07 if "glossy_object" in style.hard else 0.0,
        int(rng.integers(2**31)),
    )


def _make_ground(mesh: Mesh, bounds: ObjectBounds, style: Style, rng: np.random.Generator) -> np.ndarray:
    """(texels, texels, 3) uint8: the table's top with what lies on it."""
    if style.top == "bare":
        own = "own_color" in style.hard
        color = mean_color(mesh) * rng.uniform(0.85, 1.15) if own else rng.uniform(40, 220) * rng.uniform(0.9, 1.1, 3)
        texture = make_bare(rng, np.clip(color, 18, 240))
    else:
        texture = TOPS[style.top](rng)
    if style.paper:
        paper = PAPERS[style.paper](rng)
        side_mm = SURFACE_SIDE_IN_SIZES * bounds.largest_mm
        lay_paper(texture, paper, side_mm / texture.shape[0], rng.normal(0, 60.0, 2), rng.uniform(0, 2 * np.pi))
    return texture


def mean_color(mesh: Mesh) -> np.ndarray:
    """(3,) sRGB 0 to 255: mean of a textured mesh, by area."""
    corners = mesh.vertices[mesh.faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    height, width = mesh.texture_image.shape[:2]
    middle = np.clip(mesh.texture_coordinates[mesh.faces].mean(1), 0, 1)
    rows, columns = ((1 - middle[:, 1]) * (height - 1)).astype(int), (middle[:, 0] * (width - 1)).astype(int)
    return np.average(mesh.texture_image[rows, columns].astype(float), axis=0, weights=areas)


def _scatter(
    mesh: Mesh, bounds: ObjectBounds, reach_mm: float, room_mm: float, crowded: bool, cameras: Sequence[Camera], rng: np.random.Generator
) -> list[Mesh]:
    """Other things around the object: boxes, cans, balls and books; farther behind, large boxes as furniture. None hides it."""
    foot = np.array([*bounds.centre_mm[:2], bounds.bottom_mm])
    front = np.radians(bounds.front_azimuth_deg)
    placed = [manifold3d.Manifold.hull_points(make_body(mesh.vertices).hull)]
    centres = np.array([camera.centre_in_world for camera in cameras])
    found: list[Mesh] = []
    count = int(rng.integers(*(CROWD if crowded else THINGS)))
    large = 0 if np.isfinite(room_mm) else int(rng.integers(0, 3))
    for number in range(count + large):
        big = number >= count
        other = _choose_thing(rng)
        body = make_body(other.vertices)
        # Without a place it is left out.
        for _ in range(200):
            pose = choose_rest(body, rng)
            if big:
                pose[:3] *= rng.uniform(1.8, 3.5)
            turned = body.hull @ pose[:3, :3].T
            own_mm = float(np.linalg.norm(turned[:, :2], axis=1).max())
            away_mm = 700.0 * rng.uniform(0.6, 1.0) if big else reach_mm + own_mm + rng.uniform(*(CROWD_GAPS_MM if crowded else GAPS_MM))
            azimuth = front + np.pi + rng.normal(0, 0.6) if big else rng.uniform(0, 2 * np.pi)
            offset = away_mm * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
            pose[:3, 3] += foot + offset
            if -offset @ [np.cos(front), np.sin(front), 0.0] + own_mm > room_mm - 5.0:
                continue
            shape = manifold3d.Manifold.hull_points(transform_points(body.hull, pose))
            if any(shape.min_gap(one, 4.0) < 4.0 for one in placed) or _hides(transform_points(body.hull, pose), mesh, cameras, centres):
                continue
            placed.append(shape)
            found.append(transform_mesh(other, pose))
            break
    return found


def _choose_thing(rng: np.random.Generator) -> Mesh:
    """Something that stands or lies around at home."""
    kind = rng.uniform()
    if kind < 0.35:
        return make_book(rng)
    return make_packing(rng) if kind < 0.65 else _make_product(int(rng.integers(len(CATALOGUE))))


@functools.cache
def _make_product(number: int) -> Mesh:
    """A demo object, with a texture that is fine enough for something beside the object."""
    return make_textured_mesh(CATALOGUE[number](), TILE_PX)


def _hides(hull: np.ndarray, mesh: Mesh, cameras: Sequence[Camera], centres: np.ndarray) -> bool:
    """Whether a body, (H, 3), hides a part of the object's box in any photo, or is so near a camera that it fills the photo."""
    if np.linalg.norm(hull[:, None] - centres[None], axis=2).min() < 0.5 * np.linalg.norm(centres - hull.mean(0), axis=1).mean():
        return True
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    middle = (low + high) / 2
    for camera in cameras:
        own, _ = camera.project(mesh.vertices[:: max(len(mesh.vertices) // 200, 1)])
        other, other_depth = camera.project(hull)
        if other_depth.min() <= 0:
            return True
        nearer = other_depth.mean() < camera.project(middle[None])[1][0]
        if nearer and (other.min(0) < own.max(0)).all() and (own.min(0) < other.max(0)).all():
            return True
    return False


class CasualRenderer(SceneRenderer):
    """Renders a casual scene: the room beyond the table, and what a glossy object mirrors."""

    def __init__(self, scene: CasualScene) -> None:
        def make_texture(_: np.random.Generator) -> np.ndarray:
            return scene.texture

        surface = make_surface_mesh("su_h", scene.bounds, 0, None, make_texture)
        assert surface is not None, "this scene has a surface"
        parts = [make_object_mesh(merge_meshes([scene.mesh, *scene.others])), surface]
        super().__init__(parts, scene.bounds, scene.seed, scene.lights, MERGED_MM, scene.mirror)
        self._casual, self._own_faces = scene, len(scene.mesh.faces)

    def render_mask(self, camera: Camera) -> np.ndarray:
        """(height, width) bool: pixels whose middle shows the object."""
        return find_object_pixels(self.scene, camera, self._casual.mesh.vertices, self._own_faces)

    def _shade(self, rays: np.ndarray, hits: dict, step_x: np.ndarray, step_y: np.ndarray, footprint: float) -> np.ndarray:
        color = self._shade_once(rays, hits, step_x, step_y, footprint)
        if self._casual.gloss:
            own = np.flatnonzero((hits["geometry_ids"].numpy() == 0) & (hits["primitive_ids"].numpy() < self._own_faces))
            if len(own):
                color[own] += self._find_gloss(rays, hits, own, step_x, step_y, footprint)
        return color

    def _shade_once(self, rays: np.ndarray, hits: dict, step_x: np.ndarray, step_y: np.ndarray, footprint: float) -> np.ndarray:
        color = super()._shade(rays, hits, step_x, step_y, footprint)
        beyond = np.flatnonzero(hits["geometry_ids"].numpy() == shading.MISS)
        color[beyond] = self._casual.room.sample(rays[beyond, 3:])
        return color

    def _find_gloss(
        self, rays: np.ndarray, hits: dict, own: np.ndarray, step_x: np.ndarray, step_y: np.ndarray, footprint: float
    ) -> np.ndarray:
        """(N, 3) light that `own` hits mirror: the scene, the room and the lights, by Schlick's approximation of Fresnel's equations."""
        faces, shares = hits["primitive_ids"].numpy()[own], hits["primitive_uvs"].numpy()[own]
        weights = np.column_stack([1 - shares.sum(1), shares])
        normals = np.einsum("nk,nkc->nc", weights, self._arrays[0].normals[faces])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        forward = rays[own, 3:] / np.linalg.norm(rays[own, 3:], axis=1, keepdims=True)
        cosine = np.clip(-(forward * normals).sum(1), 0.0, 1.0)[:, None]
        mirrored = (forward + 2 * cosine * normals).astype(np.float32)
        start = rays[own, :3] + hits["t_hit"].numpy()[own, None] * rays[own, 3:] + 0.05 * normals
        second = np.concatenate([start, mirrored], 1).astype(np.float32)
        found = self.scene.cast_rays(o3d.core.Tensor(second))
        seen = self._shade_once(second, found, step_x, step_y, footprint) + self._find_lights(second, found["t_hit"].numpy())[:, None]
        share = self._casual.gloss + (1 - self._casual.gloss) * (1 - cosine) ** 5
        return (share * seen).astype(np.float32)

    def _find_lights(self, rays: np.ndarray, reach: np.ndarray) -> np.ndarray:
        """(N,) radiance of the lights that (N, 6) rays meet before something stands in their way."""
        lights, total = self._casual.lights, np.zeros(len(rays))
        for centre, (side, up, facing), radiance in zip(lights.centres, lights.axes, lights.radiances, strict=True):
            towards = -(rays[:, 3:] @ facing)
            with np.errstate(divide="ignore", invalid="ignore"):
                t = -((centre - rays[:, :3]) @ facing) / towards
                offset = rays[:, :3] + t[:, None] * rays[:, 3:] - centre
            inside = (np.abs(offset @ side) < lights.half_side_mm) & (np.abs(offset @ up) < lights.half_side_mm)
            total += np.where(inside & (towards > 0) & (t > 0) & (t < reach), radiance, 0.0)
        return total
