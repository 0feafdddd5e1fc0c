"""What is around the table of a casual photo: a room far off, a wall close by, books and boxes; and its light."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import trimesh

from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.synthetic.rendering.lighting import Lights, place_lights
from zeroshop_steps.synthetic.rendering.textures import LINEAR_OF_BYTE
from zeroshop_steps.synthetic.scenes.camera_rings import ObjectBounds
from zeroshop_steps.synthetic.scenes.distractors import map_as_boxes
from zeroshop_steps.synthetic.scenes.scene_meshes import make_noise

WALL_CELL_MM = 400.0  # of the wall's mesh: the light is baked on a lattice in each triangle
LAMP_HALF_SIDE_MM, LAMP_DISTANCE_MM, LAMP_ELEVATION_DEG = 35.0, (550.0, 900.0), (30.0, 60.0)
LAMP_LEVEL, LAMP_SKY = 0.75, 0.17  # of white that faces the lamp, and of the light from all around beside it
WINDOW_FACTORS, WINDOW_SKY, WINDOW_HALF_SIDE = (3.6, 0.08, 0.2, 0.08, 0.2, 0.1), 0.7, 0.6  # beside those of the captures' lights
ROOM_FACTORS, ROOM_HALF_SIDE = (0.5, 0.2, 0.3, 0.2, 1.6, 0.2), 0.35


@dataclass(frozen=True)
class Panorama:
    """A room at infinity.

    Attributes:
        linear: (height, width, 3) float32 linear light; columns are azimuths from 0 on, rows elevations from +90 degrees down.
    """

    linear: np.ndarray

    def sample(self, directions: np.ndarray) -> np.ndarray:
        """(N, 3) light from (N, 3) directions."""
        x, y, z = (directions[:, axis].astype(np.float64) for axis in range(3))
        height, width = self.linear.shape[:2]
        column = np.arctan2(y, x) / (2 * np.pi) % 1.0 * width
        row = (0.5 - np.arctan2(z, np.hypot(x, y)) / np.pi) * height
        left, up = np.floor(column - 0.5).astype(int), np.clip(np.floor(row - 0.5).astype(int), 0, height - 2)
        share_x, share_y = (column - 0.5 - left)[:, None], np.clip(row - 0.5 - up, 0, 1)[:, None]
        upper = (1 - share_x) * self.linear[up, left % width] + share_x * self.linear[up, (left + 1) % width]
        lower = (1 - share_x) * self.linear[up + 1, left % width] + share_x * self.linear[up + 1, (left + 1) % width]
        return ((1 - share_y) * upper + share_y * lower).astype(np.float32)


def choose_color(rng: np.random.Generator, darkest: float = 30.0, brightest: float = 225.0, chroma: float = 0.16) -> np.ndarray:
    """(3,) sRGB, 0 to 255, of a thing at home: seldom garish."""
    color = rng.uniform(darkest, brightest) * np.exp(chroma * rng.normal(size=3))
    return np.clip(color, 8, 248)


def make_panorama(rng: np.random.Generator) -> Panorama:
    """A room: walls, a floor, a window, shelves with books, pictures and furniture, all drawn and out of focus."""
    width, height = (2048, 1024)
    wall, floor = choose_color(rng, 130, 225, 0.08), rng.uniform(60, 150) * np.array([1.0, 0.85, 0.7])
    image = np.empty((height, width, 3), np.float32)
    skirting = int(height * rng.uniform(0.56, 0.64))
    image[:skirting], image[skirting:] = wall, floor
    image[skirting : skirting + 8] = 225
    image[skirting + 8 :] *= 0.8 + 0.4 * make_noise(rng, 256, 16, 256)[:1, :1].item()
    for _ in range(int(rng.integers(10, 18))):
        left, kind = int(rng.integers(0, width)), rng.uniform()
        if kind < 0.2:
            _shelf(image, rng, left, skirting)
        elif kind < 0.35:
            low, tall, wide = int(height * 0.25), int(height * 0.22), int(rng.integers(120, 260))
            _box(image, left, low, wide, tall, [252, 252, 250])
            _box(image, left + wide // 2 - 4, low, 8, tall, [150, 140, 130])
        elif kind < 0.55:
            wide, tall, low = (int(rng.integers(40, 140)), int(rng.integers(40, 120)), int(height * rng.uniform(0.32, 0.44)))
            _box(image, left, low, wide, tall, choose_color(rng, 20, 90))
            _box(image, left + 6, low + 6, wide - 12, tall - 12, choose_color(rng))
        else:
            wide, tall = int(rng.integers(90, 320)), int(rng.integers(60, 260))
            _box(image, left, skirting + 30 - tall, wide, tall, choose_color(rng))
            _box(image, left + wide // 6, skirting + 30 - tall + 10, wide // 3, max(tall // 3, 4), choose_color(rng))
    image = np.asarray(cv2.GaussianBlur(image, (0, 0), 2.0, borderType=cv2.BORDER_REPLICATE), np.float32)
    return Panorama(LINEAR_OF_BYTE[np.rint(np.clip(image, 0, 255)).astype(np.uint8)])


def _shelf(image: np.ndarray, rng: np.random.Generator, left: int, skirting: int) -> None:
    """A shelf with rows of books."""
    wide = int(rng.integers(160, 320))
    top = skirting - int(rng.integers(180, 340))
    _box(image, left, top, wide, skirting - top + 30, rng.uniform(60, 150) * np.array([1.0, 0.8, 0.6]))
    for row in range(top + 8, skirting - 40, 62):
        at = left + 6
        while at < left + wide - 20:
            thick, tall = int(rng.integers(5, 16)), int(rng.integers(34, 54))
            _box(image, at, row + 54 - tall, thick, tall, choose_color(rng))
            at += thick + 1


def _box(image: np.ndarray, left: int, top: int, width: int, height: int, color: np.ndarray | list[float]) -> None:
    columns = np.arange(left, left + width) % image.shape[1]
    image[max(top, 0) : top + height, columns] = color


def make_wall(bounds: ObjectBounds, azimuth_rad: float, distance_mm: float, rng: np.random.Generator) -> Mesh:
    """A papered or painted wall that stands on the table's level, `distance_mm` from the middle of `bounds` in a direction."""
    width, height = 1600.0, 1200.0
    x, z = np.arange(0, width + 1, WALL_CELL_MM), np.arange(0, height + 1, WALL_CELL_MM)
    grid = np.stack(np.meshgrid(x - width / 2, z), -1)
    outward = np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.0])
    along = np.array([-outward[1], outward[0], 0.0])
    foot = np.array([*bounds.centre_mm[:2], bounds.bottom_mm]) + distance_mm * outward
    vertices = (foot - grid[..., :1] * along + grid[..., 1:] * [0.0, 0.0, 1.0]).reshape(-1, 3)
    columns, rows = len(x), len(z)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    quads = [corner, corner + 1, corner + columns + 1, corner + columns]
    faces = np.concatenate([np.stack([quads[0], quads[1], quads[2]], 1), np.stack([quads[0], quads[2], quads[3]], 1)])
    uv = (grid / [width, height] + [0.5, 0.0]).reshape(-1, 2)
    normals = np.repeat(-outward[None], len(vertices), 0)
    if np.cross(vertices[faces[0, 1]] - vertices[faces[0, 0]], vertices[faces[0, 2]] - vertices[faces[0, 0]]) @ outward > 0:
        faces = faces[:, ::-1]
    return Mesh(vertices, faces, normals, uv, _draw_wall(rng))


def _draw_wall(rng: np.random.Generator) -> np.ndarray:
    """(1024, 1024, 3) uint8: plaster, stripes or a repeated ornament."""
    side, kind = 1024, int(rng.integers(3))
    base = choose_color(rng, 120, 235, 0.1)
    image = np.tile(base.astype(np.float32), (side, side, 1))
    if kind == 1:
        stripe = (np.arange(side) * int(rng.integers(10, 28)) // side % 2).astype(bool)
        image[:, stripe] = np.clip(base * rng.uniform(0.75, 1.2, 3), 0, 250)
    elif kind == 2:
        ink, step = np.clip(base + rng.uniform(-70, 40) + rng.uniform(-20, 20, 3), 10, 245).tolist(), int(rng.integers(40, 90))
        for row in range(0, side + step, step):
            for column in range((row // step % 2) * step // 2, side + step, step):
                cv2.ellipse(image, (column, row), (step // 6, step // 3), 30.0, 0, 360, ink, -1, cv2.LINE_AA)
                cv2.ellipse(image, (column, row), (step // 3, step // 8), -30.0, 0, 360, ink, 2, cv2.LINE_AA)
    image *= (1.0 + 0.16 * (make_noise(rng, side, 4, side, 0.8) - 0.5))[..., None]
    return np.rint(np.clip(image, 0, 250)).astype(np.uint8)


def make_book(rng: np.random.Generator) -> Mesh:
    """A closed book, its middle at the origin, the cover up."""
    return map_as_boxes(trimesh.creation.box(rng.uniform([110, 160, 12], [190, 260, 45])), _draw_cover(rng, 3))


def make_packing(rng: np.random.Generator) -> Mesh:
    """A box or a can with some print, its middle at the origin."""
    if rng.uniform() < 0.6:
        solid = trimesh.creation.box(rng.uniform([40, 50, 30], [110, 160, 150]))
    else:
        solid = trimesh.creation.cylinder(rng.uniform(18, 42), rng.uniform(50, 150), sections=64)
    return map_as_boxes(solid, _draw_cover(rng, int(rng.integers(3))))


def _draw_cover(rng: np.random.Generator, lines: int) -> np.ndarray:
    """(384, 384, 3) uint8: a colour, a few fields, a picture and lines of print."""
    side = 384
    base = choose_color(rng)
    cover = np.tile(np.rint(base).astype(np.uint8), (side, side, 1))
    for _ in range(int(rng.integers(0, 4))):
        corner, extent = rng.integers(0, side - 40, 2), rng.integers(30, 220, 2)
        cv2.rectangle(cover, corner.tolist(), (corner + extent).tolist(), choose_color(rng).tolist(), -1)
    if rng.uniform() < 0.5:
        left, top, wide = (int(value) for value in rng.integers([20, 20, 90], [180, 180, 190]))
        picture = np.stack([make_noise(rng, wide, 4, 64) for _ in range(3)], -1) * 150 + choose_color(rng, 20, 120)
        cover[top : top + wide, left : left + wide] = np.clip(picture, 0, 250)
    for _ in range(lines):
        letters = "".join(chr(int(letter)) for letter in rng.integers(65, 91, rng.integers(4, 12)))
        ink = choose_color(rng, 10, 60) if base.mean() > 110 else choose_color(rng, 190, 240, 0.1)
        place, scale = rng.integers([10, 50], [120, side]).tolist(), float(rng.uniform(0.5, 1.8))
        cv2.putText(cover, letters, place, cv2.FONT_HERSHEY_TRIPLEX, scale, ink.tolist(), 2, cv2.LINE_AA)
    return cover


def light_by_lamp(bounds: ObjectBounds, azimuth_rad: float, rng: np.random.Generator) -> Lights:
    """One small lamp in about this direction, and a little light from all around: shadows are dark and their edges narrow."""
    lights = place_lights(bounds, on_surface=True)
    elevation, distance_mm = np.radians(rng.uniform(*LAMP_ELEVATION_DEG)), rng.uniform(*LAMP_DISTANCE_MM)
    towards = np.array([np.cos(elevation) * np.cos(azimuth_rad), np.cos(elevation) * np.sin(azimuth_rad), np.sin(elevation)])
    side = np.array([-np.sin(azimuth_rad), np.cos(azimuth_rad), 0.0])
    centres, axes = lights.centres.copy(), lights.axes.copy()
    centres[0] = bounds.centre_mm + distance_mm * towards
    axes[0] = [side, np.cross(-towards, side), -towards]
    radiances = np.zeros(6)
    radiances[0] = LAMP_LEVEL * np.pi * distance_mm**2 / ((2 * LAMP_HALF_SIDE_MM) ** 2 * np.sin(elevation))
    return Lights(centres, axes, LAMP_HALF_SIDE_MM, radiances, LAMP_SKY)


def light_by_area(
    bounds: ObjectBounds, azimuth_rad: float, factors: tuple[float, ...], half_side: float, sky: float, rng: np.random.Generator
) -> Lights:
    """The captures' six lights, turned to a direction, with other strengths and smaller, so that their shadows are seen."""
    lights = place_lights(replace(bounds, front_azimuth_deg=float(np.degrees(azimuth_rad))), on_surface=True)
    radiances = lights.radiances * np.array(factors) * rng.uniform(0.7, 1.3, 6) / half_side**2
    return replace(lights, radiances=radiances, sky=lights.sky * sky, half_side_mm=lights.half_side_mm * half_side)


def light_by(kind: str, bounds: ObjectBounds, azimuth_rad: float, rng: np.random.Generator) -> Lights:
    """The light of a lamp, of a window (soft shadows) or of a room with a lamp above; the azimuth is where the first two are."""
    if kind == "lamp":
        return light_by_lamp(bounds, azimuth_rad, rng)
    if kind == "window":
        return light_by_area(bounds, azimuth_rad, WINDOW_FACTORS, WINDOW_HALF_SIDE, WINDOW_SKY, rng)
    return light_by_area(bounds, azimuth_rad, ROOM_FACTORS, ROOM_HALF_SIDE, 1.0, rng)
