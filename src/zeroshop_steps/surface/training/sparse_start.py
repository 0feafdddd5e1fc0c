"""The start without stereo, as in the papers: nothing is known but the masks and the registration's sparse points."""

from pathlib import Path

import numpy as np

from zeroshop_steps.geometry.cameras.object_crops import ObjectSphere
from zeroshop_steps.geometry.cameras.sparse_files import read_reconstruction
from zeroshop_steps.surface.mvs.seeds import Seeds, carve_hull
from zeroshop_steps.surface.rendering.training_views import TrainingView, make_grid_view


def make_sparse_seeds(cameras: Path, sphere: ObjectSphere, views: list[TrainingView]) -> Seeds:
    """What stereo would leave if it found nothing, with the depths of the sparse points in the masks of the images that see them.

    Args:
        cameras: folder of the registration.
        sphere: the object's, which normalizes points.
        views: those that stereo would use.

    Returns:
        No seed; a hull that only the masks carve.
    """
    grid = [make_grid_view(view) for view in views]
    reconstruction = read_reconstruction(cameras / "sparse")
    seen = {image.name: image for image in reconstruction.images.values()}
    depth_maps = {}
    for view in grid:
        depth: np.ndarray = np.zeros((view.camera.height_px, view.camera.width_px), np.float32)
        ids = [point.point3D_id for point in seen[view.camera.name].points2D if point.has_point3D()]
        points = np.array([reconstruction.points3D[index].xyz for index in ids]).reshape(-1, 3)
        rows, columns, z, inside = view.camera.find_pixels((points - sphere.centre) / sphere.radius)
        inside[inside] = view.mask.numpy()[rows[inside], columns[inside]] > 0.5
        depth[rows[inside], columns[inside]] = z[inside]
        depth_maps[view.camera.name] = depth
    nothing = np.zeros((0, 3))
    return Seeds(nothing, nothing, nothing, depth_maps, carve_hull(grid))
