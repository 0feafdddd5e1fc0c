"""Pictures for the page: photos with the outlines of their masks, and a mesh from six sides."""

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.viewpoints import direction_at, look_at, make_intrinsics
from zeroshop_steps.geometry.imaging.contact_sheets import GREEN, RED, arrange_in_rows, tile_size_px, write_label
from zeroshop_steps.geometry.imaging.images import list_images, read_image, read_mask
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer

MOST_PHOTOS = 15  # in a picture; the worst and others evenly spread
SIDE_PX, FOCAL_IN_SIDES, DISTANCE_IN_DIAMETERS = 320, 2.4, 2.6
SIDES_DEG = ((0, 15), (90, 15), (180, 15), (270, 15), (45, 65), (225, -35))
"""Azimuth and elevation of each look at a mesh: the four sides, from above, and from below."""


def draw_masks(scene: Path, cameras: Path | None, references: Mapping[str, np.ndarray], overlaps: Mapping[str, float]) -> np.ndarray:
    """(H, W, 3) uint8: photos with the outline of the mask in red over that of the reference in green; without a mask they are dark.

    Args:
        scene: the registered photos.
        cameras: what the segmentation wrote; None if it refused.
        references: (H, W) bool reference masks by stem.
        overlaps: intersections over unions by stem, for the labels.
    """
    photos = _choose(list_images(scene / "images"), references, overlaps)
    return arrange_in_rows([_draw_photo(path, cameras, references.get(path.stem), overlaps.get(path.stem)) for path in photos])


def _choose(photos: list[Path], references: Mapping[str, np.ndarray], overlaps: Mapping[str, float]) -> list[Path]:
    """At most `MOST_PHOTOS`: first those with a reference, the worst of them before all, then others, in the order of their names."""
    if len(photos) <= MOST_PHOTOS:
        return photos
    ranked = sorted(photos, key=lambda path: (path.stem not in references, overlaps.get(path.stem, 2.0)))
    judged = [path for path in ranked if path.stem in references][:MOST_PHOTOS]
    others = [path for path in photos if path not in judged]
    places = np.unique(np.linspace(0, len(others) - 1, MOST_PHOTOS - len(judged)).astype(int)) if len(judged) < MOST_PHOTOS else []
    return sorted([*judged, *(others[place] for place in places)])


def _draw_photo(path: Path, cameras: Path | None, reference: np.ndarray | None, overlap: float | None) -> np.ndarray:
    image = read_image(path)
    size = tile_size_px(image)
    tile = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    found = cameras / "masks" / f"{path.stem}.png" if cameras else None
    if found is None or not found.is_file():
        tile = tile // 2
    if reference is not None:
        _outline(tile, reference, GREEN)
    if found is not None and found.is_file():
        _outline(tile, read_mask(found), RED)
    write_label(tile, path.stem if overlap is None else f"{path.stem} {overlap:.3f}")
    return tile


def _outline(tile: np.ndarray, mask: np.ndarray, color: tuple[int, int, int]) -> None:
    """Draw a mask's outline onto a tile in place."""
    small = cv2.resize(mask.astype(np.float32), tile.shape[1::-1], interpolation=cv2.INTER_AREA) > 0.5
    contours, _ = cv2.findContours(small.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(tile, contours, -1, color, 1)


def draw_six_sides(mesh: Mesh) -> np.ndarray:
    """(H, W, 3) uint8: a mesh, z up, from six sides, in its colours and below shaded as if of clay."""
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    middle, distance = (low + high) / 2, DISTANCE_IN_DIAMETERS * float(np.linalg.norm(high - low))
    renderer = MeshRenderer(mesh)
    intrinsics = make_intrinsics(FOCAL_IN_SIDES * SIDE_PX, SIDE_PX, SIDE_PX)
    rows: list[list[np.ndarray]] = [[], []]
    for azimuth_deg, elevation_deg in SIDES_DEG:
        pose = look_at(middle + distance * direction_at(*np.radians([azimuth_deg, elevation_deg])), middle)
        camera = Camera("", SIDE_PX, SIDE_PX, intrinsics, pose)
        rows[0].append(renderer.render_color(camera, (255, 255, 255)))
        rows[1].append(renderer.render_shaded(camera))
    return np.vstack([np.hstack(row) for row in rows])
