"""Open a vessel whose inside is plain, where photos agree on a wall of about one thickness and disagree on what is there.

Neither stereo nor an outline finds a plain inside, and what the surface method leaves in its place, a lid or a filled part, agrees with
all masks. But it mixes places of different shading, so that the photos show different colours there (colour_consistency.py). The inside
is searched among those that the outside allows (vessel.py): the thickness of the wall at the rim, whether it grows thicker towards the
floor, and the height of the floor. Cavities that swallow points which stereo confirmed are left out. Colours alone might allow a plug
halfway down, whose middle is plain, too (the photo hull is the largest shape that agrees with the photos); therefore the lowest floor
counts that is about as good as the best.

The mesh is only changed where the photos then agree clearly better than before, about as well as on the outside, and worse with other
walls. The new surface is inferred: `classify_surface_support` calls it measured only where stereo confirmed it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from zeroshop_steps.finish.closing.vessel import Vessel, measure_vessel
from zeroshop_steps.finish.texturing.colour_consistency import Photos, Pixels, see
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.meshes.triangle_meshes import FACING_COSINE, Mesh
from zeroshop_steps.geometry.observation.vertex_support import NEAR_DIAMETERS
from zeroshop_steps.runtime.open3d_loader import o3d, ray_caster

# Lengths in diagonals of the mesh, deviations of colours in grey levels of 255. All were set on the demo mug and bowl.
CHANGED_DIAGONALS = 0.004
"""Pixels that see at least this much farther into the widest cavity look into it."""
LID_SHARE = 0.15
"""Of the surface that faces up, seen from above: with less of it unconfirmed, there is no lid."""
THINNEST_VOXELS, WALL_STEP, FINE_STEP = 0.75, 1.4, 1.12
"""Walls that are tried: the thinnest, the factor between them, and that of a second search around the best."""
TAPERS, TAPER_GAIN = (0.05, 0.1, 0.15), 0.05
"""Growth of the wall per length below the rim that is tried, and the share by which the colours must deviate less for it to count."""
FLOOR_WALLS = 1.5
"""Thickness of a floor that no photo shows, in walls, from the lowest point: floors are thicker than walls, and often stand on a foot."""
FLOORS = 5
"""Floors that are tried, evenly spaced up to the rim."""
AS_GOOD = 1.1
"""A floor is about as good as the best if the colours deviate by no more than this factor."""
SWALLOWED_DIAGONALS, SWALLOWED_SHARE, STRAY_SHARE = 0.007, 0.05, 0.001
"""Confirmed points this deep in a cavity are swallowed. So many may be wrong: a share of those near its surface, and of all."""
STEP_SHARE = 1 / 90
"""Pixels are taken this far apart, in square roots of the area of the mask."""
PIXELS = 300
"""In each photo, at most."""
LEAST_PIXELS, LEAST_PHOTOS, LEAST_KNOWN = 200, 3, 0.5
"""Pixels and photos that must look into a cavity, and the share of the pixels whose place other photos must show."""
BELOW_RIM_VOXELS = 3.0
"""Once the wall at the rim is known, pixels count that see the inside this far below the rim: lips shine, and pixels there mix."""
CLIP = 12.0
"""Larger deviations count as this one: they are edges and highlights."""
BETTER, AS_OUTSIDE = 0.5, 1.5
"""The photos agree on a cavity if the mean deviation is at most this share of that before, and this many times that outside."""
OTHER_WALL, DETERMINED = 1.7, 1.03
"""With a wall thicker or thinner by the first factor, the mean deviation must be larger by the second."""


@dataclass(frozen=True)
class Hollow:
    """A mesh whose hollow was opened.

    Attributes:
        mesh: closed, facing outwards.
        origin: (F,) the face of the mesh before that each face is a part of; -1 for those of the hollow.
        wall, floor: thickness of the wall at the rim, and height of the floor above the lowest point, in the unit of the mesh.
        taper: how much thicker the wall is one unit of length below the rim.
        before, after, outside: mean deviation of the colours of pixels that look into the hollow, before and after, and of others.
    """

    mesh: Mesh
    origin: np.ndarray
    wall: float
    floor: float
    taper: float
    before: float
    after: float
    outside: float


def open_hollow(mesh: Mesh, views: Sequence[View], confirmed: np.ndarray, up: np.ndarray) -> Hollow | None:
    """Open the plain hollow of a vessel; None where there is none, or photos do not tell it clearly.

    Args:
        mesh: closed, facing outwards, with room for a mouth (`has_room_for_mouth`), in the frame of the views' cameras.
        views: registered photos with masks.
        confirmed: (N, 3) points that stereo confirmed.
        up: (3,) unit vector.
    """
    return _Search(measure_vessel(mesh, up), views, confirmed).run() if _may_have_lid(mesh, confirmed, up) else None


def _may_have_lid(mesh: Mesh, confirmed: np.ndarray, up: np.ndarray) -> bool:
    """Whether enough of the surface that faces up was not confirmed."""
    flat = mesh.face_areas() * (mesh.face_normals() @ up)
    top = np.flatnonzero(mesh.face_normals() @ up > FACING_COSINE)
    if not len(confirmed) or not len(top):
        return bool(len(top))
    reach = NEAR_DIAMETERS * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    alone = np.isinf(cKDTree(confirmed).query(mesh.vertices[mesh.faces[top]].mean(1), distance_upper_bound=reach)[0])
    return bool(flat[top][alone].sum() > LID_SHARE * flat[top].sum())


class _Search:
    """The search for the wall and the floor of one vessel."""

    def __init__(self, vessel: Vessel, views: Sequence[View], confirmed: np.ndarray) -> None:
        self.vessel = vessel
        self.surface = ray_caster((vessel.mesh.vertices, vessel.mesh.faces))
        self.photos = Photos(views, vessel.mesh)
        self.looking: Pixels
        self.rates: dict[tuple[float, float, float], float] = {}
        place = confirmed @ vessel.upright_from_registration.T
        self.point_heights = place[:, 2] - vessel.bottom
        self.point_depths = map_coordinates(vessel.depth, ((place - vessel.first) / vessel.side).T, order=1, mode="nearest")

    def run(self) -> Hollow | None:
        """The opened mesh, or None."""
        vessel = self.vessel
        walls = vessel.side * THINNEST_VOXELS * WALL_STEP ** np.arange(12)
        walls = walls[walls < vessel.thickest]
        widest = self._open(walls[0], 0.0, FLOOR_WALLS * walls[0]) if len(walls) else None
        if widest is None:
            return None
        looking, others = self._find_pixels(widest)
        if len(looking.photo) < LEAST_PIXELS or len(np.unique(looking.photo)) < LEAST_PHOTOS:
            return None
        self.looking = looking
        self.photos.adapt(looking, vessel.mesh)
        wall = float(min(walls, key=self.rate))
        wall = float(min(wall * FINE_STEP ** np.array([0.0, -2.0, -1.0, 1.0, 2.0]), key=self.rate))
        inner = self._find_inner(wall)
        if len(inner.photo) < LEAST_PIXELS:
            return None
        self.looking, self.rates = inner, {}
        taper = min(TAPERS, key=lambda taper: self.rate(wall, taper))
        taper = taper if self.rate(wall, taper) < (1 - TAPER_GAIN) * self.rate(wall) else 0.0
        floor = self._find_floor(wall, taper)
        found = self._open(wall, taper, floor)
        if found is None or not self._is_determined(wall, taper, floor):
            return None
        before, after = self._compare(found)
        outside = _mean(self.photos.deviations(self.surface, others))
        if not (after <= BETTER * before and after <= AS_OUTSIDE * outside):
            return None
        cavity = vessel.cavity(wall, floor, taper)
        cut = None if cavity is None else vessel.without(vessel.simplified(cavity))
        return None if cut is None else Hollow(*cut, wall, floor, taper, before, after, outside)

    def rate(self, wall: float, taper: float = 0.0, floor: float | None = None) -> float:
        """Mean deviation of the pixels that look into the hollow; infinite for a cavity that cannot be."""
        wall, floor = float(wall), FLOOR_WALLS * float(wall) if floor is None else floor
        tried = wall, taper, floor
        if tried not in self.rates:
            scene = self._open(*tried) if self._swallows_little(*tried) else None
            self.rates[tried] = np.inf if scene is None else _mean(self.photos.deviations(scene, self.looking))
        return self.rates[tried]

    def _open(self, wall: float, taper: float, floor: float) -> o3d.t.geometry.RaycastingScene | None:
        """The mesh with a cavity, for rays."""
        cavity = self.vessel.cavity(wall, floor, taper)
        cut = None if cavity is None else self.vessel.without(cavity)
        return None if cut is None else ray_caster((cut[0].vertices, cut[0].faces))

    def _find_floor(self, wall: float, taper: float) -> float:
        """The lowest floor that is about as good as the best."""
        floors = np.linspace(FLOOR_WALLS * wall, self.vessel.rim - self.vessel.bottom, FLOORS + 1)[:-1]
        rates = np.array([self.rate(wall, taper, float(floor)) for floor in floors])
        return float(floors[np.flatnonzero(rates <= AS_GOOD * rates.min())[0]])

    def _is_determined(self, wall: float, taper: float, floor: float) -> bool:
        """Whether photos agree less on walls that are far thicker or thinner."""
        rivals = [self.rate(other, taper, max(floor, FLOOR_WALLS * other)) for other in (OTHER_WALL * wall, wall / OTHER_WALL)]
        return min(rivals) > DETERMINED * self.rate(wall, taper, floor)

    def _find_inner(self, wall: float) -> Pixels:
        """Those of the pixels that see the inside well below the rim."""
        opened = self._open(wall, 0.0, FLOOR_WALLS * wall)
        if opened is None:
            return self.looking.chosen(np.zeros(0, int))
        sight = see(opened, self.photos.cameras, self.looking)
        heights = sight.place @ self.vessel.upright_from_registration[2]
        return self.looking.chosen(sight.hit & (self.vessel.rim - heights > BELOW_RIM_VOXELS * self.vessel.side))

    def _compare(self, opened: o3d.t.geometry.RaycastingScene) -> tuple[float, float]:
        """Mean deviation of the inner pixels before and after; both infinite where the photos tell of too few of them."""
        before, after = (self.photos.deviations(scene, self.looking) for scene in (self.surface, opened))
        known = np.isfinite(before) & np.isfinite(after)
        if known.sum() < max(LEAST_PIXELS, LEAST_KNOWN * len(known)):
            return np.inf, np.inf
        return _mean(before[known]), _mean(after[known])

    def _swallows_little(self, wall: float, taper: float, floor: float) -> bool:
        """Whether nearly all confirmed points lie outside of a cavity."""
        below_rim = np.maximum(self.vessel.rim - self.vessel.bottom - self.point_heights, 0.0)
        inwards = np.minimum(self.point_depths - wall - taper * below_rim, self.point_heights - floor)
        margin = SWALLOWED_DIAGONALS * self.vessel.diagonal
        near = np.count_nonzero(np.abs(inwards) <= margin)
        return bool(np.count_nonzero(inwards > margin) <= SWALLOWED_SHARE * near + STRAY_SHARE * len(inwards))

    def _find_pixels(self, widest: o3d.t.geometry.RaycastingScene) -> tuple[Pixels, Pixels]:
        """Pixels that look into the widest cavity, and others, to compare with."""
        pixels = self.photos.pixels(STEP_SHARE)
        now, then = (see(scene, self.photos.cameras, pixels) for scene in (self.surface, widest))
        farther = now.hit & (np.linalg.norm(then.place - now.place, axis=1) > CHANGED_DIAGONALS * self.vessel.diagonal)
        return _thin_out(pixels.chosen(farther)), _thin_out(pixels.chosen(now.hit & ~farther))


def _thin_out(pixels: Pixels) -> Pixels:
    """At most PIXELS of each photo, at random."""
    order = np.random.default_rng(0).permutation(len(pixels.photo))
    rank = np.zeros(len(order), int)
    for photo in np.unique(pixels.photo):
        at = order[pixels.photo[order] == photo]
        rank[at] = np.arange(len(at))
    return pixels.chosen(rank < PIXELS)


def _mean(deviations: np.ndarray) -> float:
    """Mean of the clipped deviations that are known; infinite if none is."""
    known = deviations[np.isfinite(deviations)]
    return float(np.minimum(known, CLIP).mean()) if len(known) else np.inf
