"""Pictures of a run and its cells: contact sheets, masks over photos, depth and normals, photos beside renderings."""

from pathlib import Path

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.registered_views import View, read_views
from zeroshop_steps.geometry.cameras.transforms import crop_to_mask, transform_camera
from zeroshop_steps.geometry.imaging.contact_sheets import arrange_in_rows, tile_size_px
from zeroshop_steps.geometry.imaging.images import list_images, read_image, read_mask
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.report.site.results_index import Cell, Run
from zeroshop_steps.report.site.thumbnails import fit_width, write_webp
from zeroshop_steps.report.site.viewer_data import VIEW_PX
from zeroshop_steps.report.site.viewer_meshes import compute_truth_from_object, read_object_frame
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import read_failure

MISSING, MISSING_EDGE_PX = (196, 60, 48), 6
"""Frame of a photo without a camera: the report's red, wide enough to stand out."""
FADED, PALE_LEVEL = 0.25, 170
"""A background keeps this share of its contrast and becomes at least so bright, of 255: the object stands out, its place is still known."""


def write_sheets(run: Run, folder: Path) -> dict[str, str]:
    """Write contact sheets of a run's photos, plain and with the background dimmed; photos without a camera have a red frame.

    Returns the names of the written files by what they show; none where there are no photos yet.
    """
    source = run.folder / "cameras" if (run.folder / "cameras/images").is_dir() else run.capture
    if not (source / "images").is_dir():
        return {}
    registered = {path.stem for path in (run.folder / "cameras/images").glob("*")} if source != run.capture else set()
    photos = list_images(run.capture / "images")[:40] if (run.capture / "images").is_dir() else list_images(source / "images")
    plain, masked = [], []
    for path in photos:
        there = path.stem in registered
        image = read_image(source / "images" / path.name) if there and (source / "images" / path.name).is_file() else read_image(path)
        tile = cv2.resize(image, tile_size_px(image), interpolation=cv2.INTER_AREA)
        if registered and not there:
            cv2.rectangle(tile, (0, 0), (tile.shape[1] - 1, tile.shape[0] - 1), MISSING, MISSING_EDGE_PX)
        plain.append(tile)
        mask = next((mask for base in (source, run.capture) if (mask := base / "masks" / f"{path.stem}.png").is_file()), None)
        if mask is not None:
            masked.append(dim_background(tile, read_mask(mask)))
    write_webp(folder / f"photos-{run.key}.webp", arrange_in_rows(plain))
    names = {"photos": f"photos-{run.key}.webp"}
    if masked:
        write_webp(folder / f"masks-{run.key}.webp", arrange_in_rows(masked))
        names["masks"] = f"masks-{run.key}.webp"
    return names


def dim_background(tile: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """A photo with a faded background and the outline of the mask."""
    small = cv2.resize(mask.astype(np.uint8), (tile.shape[1], tile.shape[0]), interpolation=cv2.INTER_AREA)
    faded = np.where(small[..., None] > 0, tile, (tile * FADED + PALE_LEVEL).astype(np.uint8))
    outline = cv2.morphologyEx(small, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0
    faded[outline] = (232, 80, 40)
    return faded


def write_views(cell: Cell, run: Run, folder: Path) -> dict[str, str]:
    """Write pictures of a finished mesh: depth and normals beside the first photo, photos beside renderings, the atlas."""
    try:
        mesh = read_ply(cell.folder / "mesh.ply")
        views, _ = read_views(run.folder / "cameras")
    except StepError:
        return {}
    renderer, frame = MeshRenderer(mesh), read_object_frame(cell)
    names = {"shape": f"shape-{cell.key}.webp", "compared": f"compared-{cell.key}.webp"}
    write_webp(folder / names["shape"], draw_shape_strip(renderer, views[0], frame))
    if (run.capture / "held_out/truth").is_dir():
        held_out, _ = read_views(run.capture / "held_out", sparse="truth")
        strips = [draw_comparison_strip(renderer, view, np.linalg.inv(compute_truth_from_object(cell, run))) for view in held_out[:2]]
    else:
        strips = [draw_comparison_strip(renderer, view, frame) for view in (views[0], views[len(views) // 2])]
    write_webp(folder / names["compared"], np.concatenate(strips))
    if mesh.texture is not None:
        names["atlas"] = f"atlas-{cell.key}.webp"
        write_webp(folder / names["atlas"], fit_width(mesh.texture, 2 * VIEW_PX))
    grasps = cell.folder / "grasps.png"
    if grasps.is_file() and not read_failure(grasps):
        names["grasps"] = f"grasps-{cell.key}.webp"
        write_webp(folder / names["grasps"], read_image(grasps))
    return names


def draw_shape_strip(renderer: MeshRenderer, view: View, frame: np.ndarray) -> np.ndarray:
    """A photo beside the depth of the mesh (near is bright) and its normals (red right, green up, blue towards the camera)."""
    camera, photo, _ = cut_tile(view, frame)
    hits = renderer.cast_rays(camera)
    depth = np.full((VIEW_PX, VIEW_PX, 3), 255, np.uint8)
    normals = depth.copy()
    if hits.mask.any():
        near, far = np.percentile(hits.depth[hits.mask], (1, 99))
        level = np.clip((far - hits.depth) / max(far - near, 1e-9), 0, 1)
        depth[hits.mask] = cv2.applyColorMap((level * 255).astype(np.uint8), cv2.COLORMAP_CIVIDIS)[..., ::-1][hits.mask]
        corners = renderer.mesh.vertices[renderer.mesh.faces[hits.face[hits.mask]]]
        direction = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ camera.camera_from_world[:3, :3].T
        direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-30)
        normals[hits.mask] = np.rint(127.5 + 127.5 * direction * (1, -1, -1))
    return np.concatenate([photo, depth, normals], 1)


def draw_comparison_strip(renderer: MeshRenderer, view: View, frame: np.ndarray) -> np.ndarray:
    """A photo, masked, beside the textured mesh from the same camera and their difference, amplified four times."""
    camera, photo, mask = cut_tile(view, frame)
    photo = np.where(mask[..., None], photo, 255)
    render = renderer.render_color(camera)
    # Differences are amplified.
    difference = np.clip(255 - 4.0 * np.abs(photo.astype(int) - render), 0, 255).astype(np.uint8)
    return np.concatenate([photo, render, difference], 1)


def cut_tile(view: View, frame: np.ndarray) -> tuple[Camera, np.ndarray, np.ndarray]:
    """A square crop around the object: its camera in the object frame, (300, 300, 3) photo and (300, 300) mask."""
    mask = view.mask()
    camera, left, top = crop_to_mask(transform_camera(view.camera, frame), mask)
    rows = np.clip(np.arange(top, top + camera.height_px), 0, mask.shape[0] - 1)
    columns = np.clip(np.arange(left, left + camera.width_px), 0, mask.shape[1] - 1)
    photo = cv2.resize(view.image()[np.ix_(rows, columns)], (VIEW_PX, VIEW_PX), interpolation=cv2.INTER_AREA)
    small = cv2.resize(mask[np.ix_(rows, columns)].astype(np.float32), (VIEW_PX, VIEW_PX), interpolation=cv2.INTER_AREA)
    return camera.resized(VIEW_PX, VIEW_PX), photo, small >= 0.5
