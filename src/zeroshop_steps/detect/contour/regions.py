"""Propose regions that may be objects: basins between edges are merged step by step (as Arbelaez et al. 2011 do).

Every region of every hierarchy is a proposal: parts of an object, the object, and groups of objects. Hierarchies that weight depth
and colour edges differently merge in different orders, so that one of them is likely to have the whole object.
"""

import heapq
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import find_objects
from skimage.segmentation import watershed

from zeroshop_steps.detect.contour.depth_surface import DepthSurface
from zeroshop_steps.detect.contour.edges import Edges

# Chosen on six virtual tables of the demo objects, the test set with seed 1 (docs/results.md, "Detection and poses").
MARKER_SPACING_PX = 9  # side of the window in which a basin's marker is the lowest pixel; smaller windows give more basins
TRUSTS = ((1.0, 0.0), (1.0, 0.35), (1.0, 0.7), (0.4, 1.0))  # weights of shape edges and of colour edges in each hierarchy
LEAST_BORDER = 0.4  # mean strength of the edges around a region; those with less are parts of something larger
CONVEX_TRUST = 0.3  # weight of convex creases beside concave ones: most are edges within an object, such as those of a box
CREASE, STEEPEST = 0.6, 1.4  # differences of unit normals: an edge of strength 1, and the largest difference that still counts
CONVEX_RELIEF, COLOR_RELIEF = 0.5, 0.5  # weights of convex creases and of colour in the relief that the watershed floods
HOLE_JUMP, HOLE_COLOR = 0.8, 0.8  # the weights of jumps and colour where nothing was measured
SMALL_PX, SMALLEST_PX = 60, 120  # basins below the first merge earlier than their borders ask; regions below the second are dropped
UNKNOWN_SHARE = 0.2  # of measured pixels; a basin with less is unknown, and the ground may take it in
GROUND = 0  # label
SAME_IOU = 0.92  # two regions that overlap more are the same


@dataclass(frozen=True)
class RegionProposal:
    """A region that may be an object.

    Attributes:
        left, top: its upper left pixel in the image.
        mask: (rows, columns) bool.
        border, inside: 0..1, mean strengths of the edges around it and within it.
    """

    left: int
    top: int
    mask: np.ndarray
    border: float
    inside: float

    @property
    def window(self) -> tuple[slice, slice]:
        """The slices of the image that it covers."""
        return np.s_[self.top : self.top + self.mask.shape[0], self.left : self.left + self.mask.shape[1]]


def propose_regions(surface: DepthSurface, edges: Edges) -> list[RegionProposal]:
    """The regions of one image that do not belong to the ground; none is nearly equal to another."""
    labels = _label_basins(surface, edges)
    count = int(labels.max()) + 1
    sizes = np.bincount(labels.ravel(), minlength=count)
    unknown = np.bincount(labels[surface.measured], minlength=count) < UNKNOWN_SHARE * sizes
    pairs, strengths, lengths = _measure_borders(labels, surface, edges)
    members: dict[bytes, np.ndarray] = {}
    for index in range(len(TRUSTS)):
        for region in _merge_basins(pairs, strengths[:, index], lengths, sizes, unknown):
            if sizes[region].sum() >= SMALLEST_PX and not unknown[region].all():
                members.setdefault(np.sort(region).tobytes(), np.sort(region))
    groups = list(members.values())
    border, inside = _mean_strengths(groups, count, pairs, strengths[:, 1] * lengths, lengths)
    kept = np.flatnonzero(border >= LEAST_BORDER)
    kept = kept[_drop_near_duplicates([groups[index] for index in kept], sizes)]
    return _cut_out_masks([groups[index] for index in kept], labels, border[kept], inside[kept])


def _label_basins(surface: DepthSurface, edges: Edges) -> np.ndarray:
    """(height, width) int labels by the watershed of all edges, 0 on the ground; where nothing was measured, of jumps and colour."""
    ground = cv2.morphologyEx(surface.ground.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
    shape = np.maximum(np.maximum(edges.jump, edges.concave / STEEPEST), CONVEX_RELIEF * edges.convex / STEEPEST)
    relief = np.maximum(
        np.where(surface.measured, shape, HOLE_JUMP * edges.jump), np.where(surface.measured, COLOR_RELIEF, HOLE_COLOR) * edges.color
    )
    # Of the relief, for the markers only.
    smooth = cv2.GaussianBlur(relief.astype(np.float32), (0, 0), 1.5)
    lowest = cv2.erode(smooth, np.ones((MARKER_SPACING_PX, MARKER_SPACING_PX), np.uint8))
    _, markers = cv2.connectedComponents(((smooth <= lowest) & ~ground).astype(np.uint8))
    return watershed(relief, markers, mask=~ground)


def _measure_borders(labels: np.ndarray, surface: DepthSurface, edges: Edges) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N, 2) neighbouring basins, (N, hierarchies) mean strengths of their common border, (N,) its length in px."""
    depth_tells = np.maximum(edges.jump, np.minimum(np.maximum(edges.concave, CONVEX_TRUST * edges.convex) / CREASE, 1))
    codes, values = [], []
    count = int(labels.max()) + 1
    for one, other in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        between = labels[one] != labels[other]
        first, second = labels[one][between], labels[other][between]
        codes.append(np.minimum(first, second).astype(np.int64) * count + np.maximum(first, second))
        shape, jump, color, measured = (
            choose(picture[one][between], picture[other][between])
            for choose, picture in (
                (np.maximum, depth_tells),
                (np.maximum, edges.jump),
                (np.maximum, edges.color),
                (np.minimum, surface.measured),
            )
        )
        for_holes = np.maximum(jump, 0.5 * color), color
        mixed = [
            np.where(measured, np.maximum(trust_shape * shape, trust_color * color), for_holes[index % 2])
            for index, (trust_shape, trust_color) in enumerate(TRUSTS)
        ]
        values.append(np.stack(mixed, 1))
    unique, index = np.unique(np.concatenate(codes), return_inverse=True)
    lengths, stacked = np.bincount(index), np.concatenate(values)
    sums = np.stack([np.bincount(index, stacked[:, column]) for column in range(len(TRUSTS))], 1)
    return np.stack(np.divmod(unique, count), 1), sums / lengths[:, None], lengths


def _merge_basins(
    pairs: np.ndarray, strengths: np.ndarray, lengths: np.ndarray, sizes: np.ndarray, unknown: np.ndarray
) -> list[np.ndarray]:
    """The basins of every region that arises when basins are merged across the weakest border first.

    Only `unknown` basins, where hardly anything was measured, can merge with the ground.
    """
    links: dict[int, dict[int, tuple[float, int]]] = {}
    members = {basin: [basin] for basin in range(GROUND + 1, len(sizes))}
    size, lost = dict(enumerate(sizes.tolist())), set(np.flatnonzero(unknown).tolist())
    queue: list[tuple[float, int, int]] = []

    def connect(one: int, other: int, total: float, length: int) -> None:
        if GROUND in (one, other) and max(one, other) not in lost:
            return
        links.setdefault(one, {})[other] = links.setdefault(other, {})[one] = (total, length)
        # Small basins merge first, however strong their borders are.
        tiny = min(1.0, (min(size[one], size[other]) / SMALL_PX) ** 0.5)
        heapq.heappush(queue, (total / length * tiny, min(one, other), max(one, other)))

    for (one, other), strength, length in zip(pairs.tolist(), strengths.tolist(), lengths.tolist(), strict=True):
        connect(one, other, strength * length, length)
    alive, following = {GROUND, *members}, len(sizes)
    found = [np.array(group) for group in members.values()]
    while queue:
        _, one, other = heapq.heappop(queue)
        if one not in alive or other not in alive:
            continue
        if one == GROUND:
            merged = GROUND
            parts: tuple[int, ...] = (other,)
        else:
            merged, following, parts = following, following + 1, (one, other)
            members[merged] = members.pop(one) + members.pop(other)
            size[merged] = size[one] + size[other]
            found.append(np.array(members[merged]))
            if lost.issuperset(parts):
                lost.add(merged)
            alive.add(merged)
        alive.difference_update(parts)
        around: dict[int, tuple[float, int]] = {}
        for part in parts:
            for neighbour, (total, length) in links.pop(part, {}).items():
                if neighbour in alive and neighbour != merged:
                    before = around.get(neighbour, (0.0, 0))
                    around[neighbour] = (before[0] + total, before[1] + length)
        for neighbour, (total, length) in around.items():
            if merged == GROUND and neighbour in links[GROUND]:
                total, length = total + links[GROUND][neighbour][0], length + links[GROUND][neighbour][1]
            connect(merged, neighbour, total, length)
    return found


def _drop_near_duplicates(groups: list[np.ndarray], sizes: np.ndarray) -> list[int]:
    """Indices of the groups that are not nearly the same as an earlier one, by IoU."""
    kept: list[int] = []
    inside, areas = np.zeros((len(groups), len(sizes)), bool), np.zeros(len(groups))
    for index, group in enumerate(groups):
        area, count = sizes[group].sum(), len(kept)
        common = inside[:count, group] @ sizes[group]
        if not count or (common / (areas[:count] + area - common)).max() <= SAME_IOU:
            inside[count, group], areas[count] = True, area
            kept.append(index)
    return kept


def _mean_strengths(
    groups: list[np.ndarray], count: int, pairs: np.ndarray, totals: np.ndarray, lengths: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean strengths of the edges around each group of basins and within it; 0 within a single basin."""
    chosen = np.zeros((len(groups), count), bool)
    for row, group in zip(chosen, groups, strict=True):
        row[group] = True
    one, other = chosen[:, pairs[:, 0]], chosen[:, pairs[:, 1]]
    around, within = one ^ other, one & other
    return tuple((edges @ totals) / np.maximum(edges @ lengths, 1) for edges in (around, within))


def _cut_out_masks(groups: list[np.ndarray], labels: np.ndarray, border: np.ndarray, inside: np.ndarray) -> list[RegionProposal]:
    """The proposals of groups of basins."""
    boxes = find_objects(labels)
    found = []
    for group, *strengths in zip(groups, border.tolist(), inside.tolist(), strict=True):
        top = min(boxes[basin - 1][0].start for basin in group)
        bottom = max(boxes[basin - 1][0].stop for basin in group)
        left = min(boxes[basin - 1][1].start for basin in group)
        right = max(boxes[basin - 1][1].stop for basin in group)
        chosen = np.zeros(int(labels.max()) + 1, bool)
        chosen[group] = True
        found.append(RegionProposal(left, top, chosen[labels[top:bottom, left:right]], *strengths))
    return found
