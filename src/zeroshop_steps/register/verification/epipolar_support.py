"""Count the matches of every image pair that support or contradict a model. They were verified without any model.

Incremental mapping silently drops matches that do not agree with the cameras found so far. Here they are counted: cameras that
were registered by a few false matches have many true matches against them, or few matches that connect them with the rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from zeroshop_steps.register.matching.verified_matches import MAX_ERROR_PX
from zeroshop_steps.register.scene.database import read_matches, read_places


@dataclass(frozen=True)
class EpipolarSupport:
    """Verified matches of the registered images, pair by pair.

    Attributes:
        names: image names.
        supporting: (N, N) symmetric number of matches that the model explains.
        contradicting: (N, N) symmetric number of those that it does not.
    """

    names: tuple[str, ...]
    supporting: np.ndarray
    contradicting: np.ndarray

    @property
    def contradicted_share(self) -> np.ndarray:
        """(N,) share of each image's verified matches that contradict the model."""
        total = (self.supporting + self.contradicting).sum(1)
        return self.contradicting.sum(1) / np.maximum(total, 1)

    def take(self, names: Sequence[str]) -> "EpipolarSupport":
        """The matches of these images alone, in the order of the names that are there."""
        kept = np.isin(self.names, names)
        chosen = tuple(np.array(self.names)[kept].tolist())
        return EpipolarSupport(chosen, self.supporting[kept][:, kept], self.contradicting[kept][:, kept])

    def weakest_cut(self) -> tuple[int, tuple[str, ...]]:
        """The fewest supporting matches that hold two groups of images together, and the names of the smaller group."""
        count = len(self.names)
        best, group = np.iinfo(np.int64).max, np.zeros(count, bool)
        graph = csr_matrix(self.supporting.astype(np.int32))
        for sink in range(1, count):  # the smallest cut separates image 0 from at least one other image
            flow = maximum_flow(graph, 0, sink)
            if flow.flow_value < best:
                best, group = int(flow.flow_value), np.zeros(count, bool)
                group[breadth_first_order(csr_matrix(self.supporting - flow.flow.toarray() > 0), 0, return_predecessors=False)] = True
        if group.sum() > count / 2:
            group = ~group
        return best, tuple(name for name, inside in zip(self.names, group, strict=True) if inside)


def count_epipolar_support(model: pycolmap.Reconstruction, database: Path, max_error_px: float = MAX_ERROR_PX) -> EpipolarSupport:
    """Test the verified matches of all registered pairs against the model's cameras.

    A match supports the model when its Sampson distance to the model's epipolar geometry is at most `max_error_px` and the
    point lies in front of both cameras.
    """
    images = sorted((model.images[image_id] for image_id in model.reg_image_ids()), key=lambda image: image.name)
    row = {image.image_id: index for index, image in enumerate(images)}
    supporting, contradicting = np.zeros((2, len(images), len(images)), dtype=np.int64)
    with pycolmap.Database.open(database) as opened:
        places, pairs = read_places(opened), read_matches(opened)
    rays = {image.image_id: model.cameras[image.camera_id].cam_from_img(places[image.image_id]) for image in images}
    for (first, second), matches in pairs:
        if first not in row or second not in row or not len(matches):
            continue
        a, b = model.images[first], model.images[second]
        focal = model.cameras[a.camera_id].mean_focal_length(), model.cameras[b.camera_id].mean_focal_length()
        second_from_first = (b.cam_from_world() * a.cam_from_world().inverse()).matrix()
        points_a, points_b = rays[first][matches[:, 0]], rays[second][matches[:, 1]]
        good = find_explained(points_a, points_b, second_from_first, max_error_px / (0.5 * sum(focal)))
        i, j = row[first], row[second]
        supporting[i, j] = supporting[j, i] = good.sum()
        contradicting[i, j] = contradicting[j, i] = (~good).sum()
    return EpipolarSupport(tuple(image.name for image in images), supporting, contradicting)


def find_explained(first: np.ndarray, second: np.ndarray, second_from_first: np.ndarray, max_error: float) -> np.ndarray:
    """(M,) bool: does a relative pose explain matches of normalised image points?

    Args:
        first, second: (M, 2) points on the cameras' unit planes.
        second_from_first: (3, 4) rigid transform.
        max_error: largest Sampson distance (Hartley and Zisserman 2004, eq. 11.9), on the unit planes.
    """
    rotation, translation = second_from_first[:, :3], second_from_first[:, 3]
    essential = np.cross(np.eye(3), translation) @ rotation
    a, b = np.column_stack([first, np.ones(len(first))]), np.column_stack([second, np.ones(len(second))])
    lines_b, lines_a = a @ essential.T, b @ essential
    distance = (b * lines_b).sum(1) ** 2 / np.maximum((lines_b[:, :2] ** 2).sum(1) + (lines_a[:, :2] ** 2).sum(1), 1e-30)
    # Depths from depth_b b = depth_a R a + t, each by eliminating the other with a cross product.
    turned = a @ rotation.T
    normal = np.cross(b, turned)
    depth_a = (normal * np.cross(translation, b)).sum(1)
    depth_b = (normal * np.cross(translation, turned)).sum(1)
    return (distance <= max_error**2) & (depth_a > 0) & (depth_b > 0)
