"""Objects whose sides look alike, made by code, and photos all around them: what gives models with duplicate structure.

A wall of some cross section has the same print two, three or four times around it. As on real packages, the repeats are equal, or small
print beside the large shapes tells them apart.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.pinhole import Camera, write_cameras
from zeroshop_steps.geometry.cameras.viewpoints import direction_at, look_at, make_intrinsics
from zeroshop_steps.geometry.imaging.images import write_image, write_mask
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.runtime.files import atomic_directory, write_json
from zeroshop_steps.runtime.open3d_loader import o3d, ray_caster
from zeroshop_steps.synthetic.rendering.renderer import expose

WIDTH_PX, HEIGHT_PX, FOCAL_PX, SAMPLES = 480, 360, 400.0, 2  # of a photo, which is rendered at so many times its resolution
DISTANCE_IN_DIAGONALS = 1.7
AROUND, UP = 96, 24  # corners of the wall
TEXTURE_PX = (1152, 576)  # around and up
SMALL_PRINT_LEVELS = 40  # of 255, by which small print differs where the repeats are not equal


@dataclass(frozen=True)
class AlikeObject:
    """An object of one cross section all the way up.

    Attributes:
        sides: of the cross section, a rounded polygon; 0 for an ellipse.
        axes_mm: half its extent along x and y.
        height_mm: of the object.
        waist: how much narrower it is at the top, as a share.
        repeats: how often its print is there.
        equal: whether the repeats are equal, or differ in small print.
        words: blots of large print in one repeat.
    """

    sides: int
    axes_mm: tuple[float, float]
    height_mm: float
    waist: float
    repeats: int
    equal: bool
    words: int


ALIKE_OBJECTS = {
    "tin": AlikeObject(0, (36, 36), 104, 0.0, 2, True, 26),
    "drum": AlikeObject(0, (45, 45), 90, 0.0, 2, False, 34),
    "jar": AlikeObject(0, (40, 40), 95, 0.15, 3, True, 22),
    "carton": AlikeObject(4, (45, 25), 130, 0.0, 2, True, 40),
    "tea_box": AlikeObject(4, (38, 38), 90, 0.0, 4, True, 20),
    "milk_box": AlikeObject(4, (36, 36), 140, 0.0, 2, True, 36),
    "soap_box": AlikeObject(4, (48, 30), 70, 0.0, 2, False, 30),
    "hexagon_tin": AlikeObject(6, (42, 42), 100, 0.0, 3, True, 24),
    "hexagon_jar": AlikeObject(6, (40, 40), 110, 0.1, 2, True, 34),
    "flask": AlikeObject(0, (48, 26), 130, 0.35, 2, True, 40),
    "shampoo": AlikeObject(0, (40, 24), 150, 0.2, 2, False, 40),
    "pot": AlikeObject(0, (46, 46), 85, -0.2, 4, True, 18),
    "candle": AlikeObject(0, (34, 34), 110, 0.0, 4, False, 18),
    "spice_box": AlikeObject(4, (32, 24), 100, 0.0, 2, True, 30),
}


def make_mesh(kind: AlikeObject, seed: int) -> Mesh:
    """A closed wall with its print, and plain ends."""
    turns = np.linspace(0, 2 * np.pi, AROUND + 1)
    radius = np.ones_like(turns)
    if kind.sides:  # the 8-norm of the distances to the sides rounds the edges
        looks = 2 * np.pi * np.arange(kind.sides) / kind.sides
        radius = 1 / (np.maximum(np.cos(turns[:, None] - looks), 0) ** 8).sum(1) ** (1 / 8)
    section = np.column_stack([kind.axes_mm[0] * radius * np.cos(turns), kind.axes_mm[1] * radius * np.sin(turns)])
    levels = np.linspace(0, 1, UP + 1)
    narrower = 1 - kind.waist * levels**2
    rows = np.tile(section, (UP + 1, 1)) * np.repeat(narrower, AROUND + 1)[:, None]
    wall = np.column_stack([rows, np.repeat(kind.height_mm * levels, AROUND + 1)])
    lengths = np.append(0, np.cumsum(np.linalg.norm(np.diff(section, axis=0), axis=1)))
    uv = np.column_stack([np.tile(lengths / lengths[-1], UP + 1), np.repeat(0.02 + 0.96 * levels, AROUND + 1)])
    row, column = (part.ravel() for part in np.meshgrid(np.arange(UP), np.arange(AROUND), indexing="ij"))
    corner = row * (AROUND + 1) + column
    beyond = corner + AROUND + 1
    faces = [np.column_stack([corner, corner + 1, beyond + 1]), np.column_stack([corner, beyond + 1, beyond])]
    ends = np.array([[0, 0, 0], [0, 0, kind.height_mm]], float)
    first, top = np.arange(AROUND), UP * (AROUND + 1)
    low, high = len(wall), len(wall) + 1
    rims = np.concatenate([wall[: AROUND + 1], wall[top:]])
    start = len(wall) + 2
    faces += [np.column_stack([np.full(AROUND, low), start + first + 1, start + first])]
    faces += [np.column_stack([np.full(AROUND, high), start + AROUND + 1 + first, start + AROUND + 2 + first])]
    end_uv = np.concatenate([[[0.5, 0.005], [0.5, 0.995]], np.full((AROUND + 1, 2), (0.5, 0.005)), np.full((AROUND + 1, 2), (0.5, 0.995))])
    vertices, triangles = np.concatenate([wall, ends, rims]), np.concatenate(faces)
    normals = np.array(trimesh.Trimesh(vertices, triangles, process=False).vertex_normals)
    seam = np.arange(UP + 1) * (AROUND + 1)
    normals[seam] = normals[seam + AROUND] = normals[seam] + normals[seam + AROUND]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Mesh(vertices, triangles, normals, np.concatenate([uv, end_uv]), paint(kind, seed))


def paint(kind: AlikeObject, seed: int) -> np.ndarray:
    """(height, width, 3) uint8: large print, repeated around, and small print that is repeated, too, or not."""
    rng = np.random.default_rng(seed)
    width_px, height_px = TEXTURE_PX[0] // kind.repeats, TEXTURE_PX[1]
    ground = rng.integers(110, 200, 3).tolist()
    sheet = np.full((height_px, width_px, 3), ground, np.uint8)
    for _ in range(kind.words):
        place = (int(rng.integers(width_px)), int(rng.integers(30, height_px - 30)))
        color, size = rng.integers(0, 160, 3).tolist(), rng.integers(12, 70, 2)
        for shift in (-width_px, 0, width_px):  # over the seam
            at = (place[0] + shift, place[1])
            if place[0] % 3 == 0:
                cv2.ellipse(sheet, at, tuple(map(int, size)), float(place[1]), 0, 360, color, -1, cv2.LINE_AA)
            elif place[0] % 3 == 1:
                cv2.rectangle(sheet, at, (at[0] + int(size[0]), at[1] + int(size[1])), color, -1)
            else:
                letters = chr(65 + place[0] % 26) + chr(65 + place[1] % 26) + chr(48 + place[0] % 10)
                cv2.putText(sheet, letters, at, cv2.FONT_HERSHEY_DUPLEX, float(size[0]) / 24, color, 5, cv2.LINE_AA)
    small = rng.integers(0, SMALL_PRINT_LEVELS, (height_px // 6, (width_px if kind.equal else TEXTURE_PX[0]) // 6, 3), dtype=np.uint8)
    whole = np.tile(sheet, (1, kind.repeats, 1))
    small = np.tile(small, (1, kind.repeats, 1)) if kind.equal else small
    whole = cv2.subtract(whole, cv2.resize(small, (whole.shape[1], height_px), interpolation=cv2.INTER_NEAREST))
    whole[: height_px // 60], whole[-height_px // 60 :] = ground, ground
    return whole


def write_alike_capture(name: str, number: int, out: Path, photos: int, printed: bool) -> None:
    """Write model/ and capture/ of one of them, as rendered captures have it.

    Args:
        name: of `ALIKE_OBJECTS`.
        number: of the capture, which is the seed of all that is random but the print.
        out: the folder.
        photos: all around.
        printed: whether there is print below the object, which tells its sides apart.
    """
    kind, rng = ALIKE_OBJECTS[name], np.random.default_rng([number, *name.encode()])
    mesh = make_mesh(kind, sum(name.encode()))
    diameter_mm = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    cameras = place_around(kind.height_mm / 2, diameter_mm, photos, rng)
    spots = rng.normal(0.5, 0.2 if printed else 0.004, (200, 200)).astype(np.float32)
    ground = cv2.resize(spots, (1000, 1000), interpolation=cv2.INTER_CUBIC)
    with atomic_directory(out) as folder:
        write_image(folder / "model" / "model.png", mesh.texture_image)
        write_ply(folder / "model" / "model.ply", mesh, "model.png")
        write_json(folder / "model" / "model_info.json", {"name": name, "diameter": diameter_mm})
        scene = ray_caster((mesh.vertices, mesh.faces))
        for camera in cameras:
            light, mask = render(scene, mesh, ground, 4 * diameter_mm, camera)
            write_image(folder / "capture" / "images" / camera.name, expose(light * rng.uniform(0.8, 1.2), rng))
            write_mask(folder / "capture" / "truth" / "masks" / camera.name, mask)
        write_cameras(folder / "capture" / "truth", cameras)
        write_json(folder / "capture" / "capture.json", {"virtual": True, "images": len(cameras)})


def place_around(height_mm: float, diameter_mm: float, photos: int, rng: np.random.Generator) -> list[Camera]:
    """Cameras all around a point at this height, as a hand holds them, in the order of a film."""
    cameras, base_deg = [], rng.uniform(15, 40)
    intrinsics = make_intrinsics(FOCAL_PX, WIDTH_PX, HEIGHT_PX)
    for number in range(photos):
        azimuth = 2 * np.pi * (number + 0.2 * rng.normal()) / photos
        distance_mm = DISTANCE_IN_DIAGONALS * diameter_mm * np.exp(0.06 * rng.normal())
        place = np.array([0, 0, height_mm]) + distance_mm * direction_at(azimuth, np.radians(base_deg + 5 * rng.normal()))
        aim = np.eye(4)
        aim[:3, :3] = Rotation.from_rotvec(0.03 * rng.normal(size=3)).as_matrix()
        cameras.append(Camera(f"{number:06d}.png", WIDTH_PX, HEIGHT_PX, intrinsics, aim @ look_at(place, np.array([0, 0, height_mm]))))
    return cameras


def render(
    scene: o3d.t.geometry.RaycastingScene, mesh: Mesh, ground: np.ndarray, side_mm: float, camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """(height, width, 3) float32 light, and (height, width) bool, of the object on a ground of this side, by daylight from one side."""
    fine = camera.resized(WIDTH_PX * SAMPLES, HEIGHT_PX * SAMPLES)
    world_from_camera = np.linalg.inv(fine.camera_from_world)
    x, y = np.meshgrid(np.arange(fine.width_px) + 0.5, np.arange(fine.height_px) + 0.5)
    pixels = np.stack([x, y, np.ones_like(x)], -1)
    ways = pixels @ np.linalg.inv(fine.intrinsics).T @ world_from_camera[:3, :3].T
    start = np.broadcast_to(world_from_camera[:3, 3], ways.shape)
    hits = scene.cast_rays(o3d.core.Tensor(np.concatenate([start, ways], -1).astype(np.float32)))
    seen = np.isfinite(hits["t_hit"].numpy())
    corners = mesh.faces[hits["primitive_ids"].numpy()[seen]]
    shares = hits["primitive_uvs"].numpy()[seen]
    weights = np.column_stack([1 - shares.sum(1), shares])[..., None]
    texels = np.flipud(mesh.texture_image).astype(np.float32) / 255
    normals = (mesh.normals[corners] * weights).sum(1)
    bright = 0.55 + 0.45 * np.maximum(normals @ np.array([0.5, 0.3, 0.81]), 0)
    light = np.full((*seen.shape, 3), 0.6, np.float32)
    light[seen] = look_up(texels, (mesh.uv[corners] * weights).sum(1) * TEXTURE_PX, seen) ** 2.2 * bright[:, None]
    below = ~seen & (ways[..., 2] < 0)
    spots = start[below][:, :2] - ways[below][:, :2] * (start[below][:, 2] / ways[below][:, 2])[:, None]
    light[below] = look_up(np.dstack([ground] * 3), (spots / side_mm + 0.5) % 1 * len(ground), below)
    size = (WIDTH_PX, HEIGHT_PX)
    light, shown = (cv2.resize(values, size, interpolation=cv2.INTER_AREA) for values in (light, seen.astype(np.float32)))
    return light, shown >= 0.5


def look_up(texture: np.ndarray, places: np.ndarray, where: np.ndarray) -> np.ndarray:
    """(K, 3) colours of a texture at (K, 2) of its pixels, which are the (height, width) `where` of an image."""
    maps = np.zeros((*where.shape, 2), np.float32)
    maps[where] = places
    return np.asarray(cv2.remap(texture, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[where])
