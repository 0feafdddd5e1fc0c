"""Grow the selected object into what the photos see in front of the room behind the ground.

The ground tells what stands on it only where it is seen behind the object. From low down, the upper part of a tall object stands before
the room in nearly all photos, of which nothing is known. There the object's own colours tell it: learned on what the ground told, and
voted on in space, since a place that shows them from all sides is the object, and the room behind differs from photo to photo.
"""

import numpy as np
from scipy import ndimage

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.segment.color_model import ColorModel
from zeroshop_steps.segment.voxel_carving import VoxelGrid, count_votes, render_silhouettes

# Set by hand on frames of a vinyl figure on a stone table (docs/results.md).
BACKED_SHARE = 0.4  # of the views that see a voxel; where fewer have the ground behind it, the ground does not tell it
MOST_VIEWS = 24  # that vote by colour, evenly spread: they are enough, and all of them take time
LEAST_VIEWS = 5  # that must see a voxel
SURE_ODDS = 1.0  # a colour votes from here on: one that is e times as frequent on the object as around it
FULL_SHARE = 0.5  # of the views that see a voxel must show the object's colours
EMPTY_SHARE = 0.2  # of the votes; more than for the ground's, since a label or a highlight has other colours than what is known
ROUNDS = 6  # each learns the colours of what the last one added
RIM_PX, AROUND_PX = 2, 4  # of the silhouette: its colours are learned this far inside and outside of it
LEAST_GROWTH, MOST_GROWTH = 1.1, 8.0  # times the volume: less is the slack of the hull, and what grows more has the room's colours
COLOR_MOST = 1.5  # log odds of a colour, at most


def grow_beyond_ground(
    grid: VoxelGrid,
    own: np.ndarray,
    others: np.ndarray,
    lowest: int,
    cameras: list[Camera],
    images: list[np.ndarray],
    evidence: list[np.ndarray],
    sure: float,
) -> np.ndarray:
    """The object with what hangs together with it and has its colours, where the ground is not seen behind it.

    Args:
        grid: a block of voxels.
        own, others: (X, Y, Z) bool: the voxels of the object, and of other things on the ground.
        lowest: height of the first voxel above the ground.
        cameras, images: of all views, (H, W, 3) float32 RGB, 0 to 255.
        evidence: (H, W) log odds of an object in every view; none where their size is below `sure`.

    Returns:
        (X, Y, Z) bool, with all of `own`; `own` itself where hardly anything is added, or what grows has the room's colours.
    """
    chosen = np.unique(np.linspace(0, len(cameras) - 1, MOST_VIEWS).round().astype(int))
    cameras, images, evidence = ([part[index] for index in chosen] for part in (cameras, images, evidence))
    index, seen = _find_unbacked(grid, lowest, cameras, evidence, sure)
    unbacked = np.zeros(grid.shape, bool)
    unbacked[tuple(index.T)] = True
    # Above another thing on the ground is that thing.
    unbacked &= ~np.asarray((others & ~unbacked).any(axis=2))[:, :, None]
    index, seen = index[unbacked[tuple(index.T)]], seen[unbacked[tuple(index.T)]]
    grown = own
    for _ in range(ROUNDS):
        if not (ndimage.binary_dilation(grown) & ~grown & unbacked).any():
            break
        colors = _learn_colors(grid, grown, cameras, images, evidence)
        if colors is None:
            break
        odds = [
            np.where(np.abs(known) < sure, np.clip(colors.of(image), -COLOR_MOST, COLOR_MOST), 0.0).astype(np.float32)
            for image, known in zip(images, evidence, strict=True)
        ]
        full, empty = count_votes(grid, index, cameras, odds, SURE_ODDS)
        kept = (full >= FULL_SHARE * seen) & (empty <= EMPTY_SHARE * (full + empty))
        candidates = grown.copy()
        candidates[tuple(index[kept].T)] = True
        labels, _ = ndimage.label(candidates, np.ones((3, 3, 3)))
        larger = np.isin(labels, np.unique(labels[grown]))
        if larger.sum() > MOST_GROWTH * own.sum():
            return own
        if larger.sum() == grown.sum():
            break
        grown = larger
    return grown if grown.sum() > LEAST_GROWTH * own.sum() else own


def _find_unbacked(
    grid: VoxelGrid, lowest: int, cameras: list[Camera], evidence: list[np.ndarray], sure: float
) -> tuple[np.ndarray, np.ndarray]:
    """The voxels (P, 3) above the ground that few views have the ground behind, and (P,) how many views see each."""
    index = np.argwhere(np.ones(grid.shape, bool))
    index = index[index[:, 2] >= lowest]
    full, empty = count_votes(grid, index, cameras, evidence, sure)
    centres = grid.centres(index).astype(np.float32)
    seen = np.sum([camera.find_pixels(centres)[3] for camera in cameras], axis=0)
    unbacked = (full + empty < BACKED_SHARE * seen) & (seen >= LEAST_VIEWS)
    return index[unbacked], seen[unbacked]


def _learn_colors(
    grid: VoxelGrid, own: np.ndarray, cameras: list[Camera], images: list[np.ndarray], evidence: list[np.ndarray]
) -> ColorModel | None:
    """The colours of the object against all others; None where nothing is left on one side."""
    inside, outside = [], []
    for shown, image, odds in zip(render_silhouettes(grid, own, cameras), images, evidence, strict=True):
        inside.append(image[ndimage.binary_erosion(shown, iterations=RIM_PX) & (odds >= 0.0)][::2])
        outside.append(image[~ndimage.binary_dilation(shown, iterations=AROUND_PX) & (odds <= 0.0)][::4])
    samples = np.concatenate(inside), np.concatenate(outside)
    return ColorModel(*samples) if len(samples[0]) and len(samples[1]) else None
