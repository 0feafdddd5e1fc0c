"""Adjust cameras by the object's outlines and its matches together.

Where the object alone gave the matches, they hold cameras loosely: its points lie in a small part of the image, and few of them are seen
from both sides of an edge. Its outlines hold them all around. Every ray through a mask's rim touches the object, so it must pass through
the masks of all other views (silhouette coherence; Hernandez et al., Silhouette Coherence for Camera Calibration under Circular Motion,
PAMI 2007). How far rays miss is minimized by Levenberg and Marquardt's method together with the reprojection errors of the tracks,
whose points are eliminated (Triggs et al., Bundle Adjustment: A Modern Synthesis, 1999).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix

from zeroshop_steps.geometry.cameras.pinhole import Camera, make_transform
from zeroshop_steps.geometry.cameras.transforms import make_cross_matrices
from zeroshop_steps.register.scene.image_set import REFERENCE_PX
from zeroshop_steps.register.silhouettes.coherence import bound_object
from zeroshop_steps.register.silhouettes.least_squares import Noise, SilhouetteRows, TrackBlocks, find_information, solve_step
from zeroshop_steps.register.silhouettes.rays import RimRays, look_up_many, make_outline_distance, measure_slope
from zeroshop_steps.register.silhouettes.state import State, TrackKind, Tracks

ROUNDS, TRIALS = 20, 7  # of the adjustment, and damping factors that are tried in each
CONVERGED = 0.02
"""Share by which a step must lower the cost. Less is the noise of rims that run along pixels: with rendered masks of seven objects, the
first two to five rounds found cameras as good as twenty did, and of few views better ones."""
LEAST_DAMPING = 1e-8
EXACT_MISS_PX = 0.15  # of exact masks, in the mean, per 1000 px of the image: rims that run along pixels leave 0.04 to 0.06
EXACT_RIMS_PX, ROUGH_RIMS_PX, LEAST_TRACKS_PX, FOUND_RIMS_PX, GUIDED_TRACKS_PX = 0.5, 2.0, 0.1, 1.0, 0.3
"""Noise of the rims of exact masks, of others, and the least of tracks, likewise. A rim's rays lie side by side and err together: each by
itself has 0.3 px, and 1 px where a network found the masks. The pictures align points to a tenth of a pixel. Those that the hull leads to
are found within a few tenths: rims that a network found count a third of them, exact ones as much."""
STANDS_OUT, STANDS_OUT_PX = 2.0, 0.5
"""Views stand out whose masks miss by so many times what the median one does, and by more than this: rays of their own and of others, in
the mean of a view's rays. In registrations of seven objects, one view stood 11 mm off, and had 2.1 times; others had 1.6, and where a mask
was wrong 1.9 to 3.0."""


class SilhouetteAdjustment:
    """Cameras of an object, its outlines and its tracks."""

    def __init__(self, cameras: Sequence[Camera], masks: dict[str, np.ndarray], tracks: Tracks) -> None:
        """Take cameras as they are.

        Args:
            cameras: N registered pinhole cameras.
            masks: {image name: (height, width) bool}, of the cameras' sizes; cameras without one are held by their tracks alone.
            tracks: what they see; may be empty.
        """
        chosen = [masks.get(camera.name) for camera in cameras]
        self.cameras, self.tracks = list(cameras), tracks
        known = [(camera, mask) for camera, mask in zip(cameras, chosen, strict=True) if mask is not None]
        self.centre, self.radius = bound_object([camera for camera, _ in known], [mask for _, mask in known])
        self.focal_px = np.array([camera.intrinsics[0, 0] for camera in cameras])
        self.middle_px = np.array([camera.intrinsics[:2, 2] for camera in cameras])
        self.unit_px = np.array([max(camera.width_px, camera.height_px) / REFERENCE_PX for camera in cameras])
        self.distance = [
            None if mask is None else make_outline_distance(mask) / unit for mask, unit in zip(chosen, self.unit_px, strict=True)
        ]
        self.rays = RimRays.choose(chosen, self.distance)
        rotation = np.array([camera.camera_from_world[:3, :3] for camera in cameras])
        translation = np.array([(camera.camera_from_world @ [*self.centre, 1.0])[:3] / self.radius for camera in cameras])
        self.state = State(rotation, translation, 0.0, np.zeros((tracks.count, 3)))
        self.state = replace(self.state, points=self._triangulate())

    def adjust(self, kind: TrackKind = TrackKind.MATCHED, found: bool = False) -> None:
        """Minimize the robust sum of the outlines' misses and the tracks' reprojection errors, in px per 1000 px of the image.

        Args:
            kind: of the tracks. Those that the pictures aligned, and the rims, count by their noise, that of the tracks being what is left
                of their errors: else rims and false observations outweigh those that were aligned.
            found: whether the masks were found in each photo: rims may then be a pixel off all around, and rays meet them nonetheless.
        """
        self._minimize(Noise())
        if kind is TrackKind.GUIDED and self.tracks.count:
            self._minimize(Noise(FOUND_RIMS_PX if found else GUIDED_TRACKS_PX, GUIDED_TRACKS_PX))
        if kind is TrackKind.ALIGNED and self.tracks.count:
            rims_px = ROUGH_RIMS_PX if found or self.measure_misses_px().mean() > EXACT_MISS_PX else EXACT_RIMS_PX
            errors_px = np.linalg.norm(self._reprojection_errors(self.state)[0], axis=1)
            self._minimize(Noise(rims_px, float(np.clip(np.median(errors_px), LEAST_TRACKS_PX, 1.0))))

    def find_standing_out(self, misses_px: np.ndarray) -> np.ndarray:
        """(K,) numbers of the views whose masks, or cameras, contradict the others': their rays miss, or those of the others miss them.

        A network may cut off a side of the object, and a view that sees one face squarely is held loosely by points, and follows its mask.

        Args:
            misses_px: (R,) what `measure_misses_px` says of the cameras as they are.
        """
        by_view_px = self.measure_contradictions_px(misses_px)
        found: np.ndarray = np.flatnonzero(by_view_px > max(STANDS_OUT * float(np.median(by_view_px)), STANDS_OUT_PX))
        return found

    def measure_contradictions_px(self, misses_px: np.ndarray) -> np.ndarray:
        """(N,) by how much the rays of each view miss the other masks, and those of the others miss its mask, in the mean of a view's rays.

        Oversized masks produce inconsistent rays; a mask that lacks a part is missed by the rays of the others.

        Args:
            misses_px: (R,) what `measure_misses_px` says of the cameras as they are.
        """
        views, rays = len(self.cameras), self.rays
        own_px = np.bincount(rays.view, misses_px, views)
        summed_px: np.ndarray = own_px + np.bincount(rays.other, np.maximum(-rays.value, 0.0), views)
        return summed_px / (len(rays.view) / views)

    def _minimize(self, noise: Noise) -> None:
        damping = 1e-3
        self._touch(self.state)
        cost = self._measure_cost(self.state, noise)
        for _ in range(ROUNDS):
            outlines, tracks = self._linearize_outlines().divided(noise.rims), self._linearize_tracks(noise.tracks)
            before, start, enough = cost, self.state, (1 - CONVERGED) * cost
            for _ in range(TRIALS):
                step, points_step = solve_step(outlines, tracks, damping)
                moved = start.moved(step, points_step)
                self._touch(moved)
                cost = self._measure_cost(moved, noise)
                if cost < before:
                    break
                damping, enough = 6 * damping, before  # a short step brings little
            if cost >= enough:
                self._touch(start)
                return
            self.state, damping = moved, max(damping / 5, LEAST_DAMPING)

    def measure_misses_px(self) -> np.ndarray:
        """(R,) by how much each ray of the rims misses the other masks, px per 1000 px of the image; 0 where it passes through all."""
        return np.maximum(-self._touch(self.state), 0.0)

    def measure_information(self) -> np.ndarray:
        """(6 N + 1, 6 N + 1) what the rims tell of the cameras as they are, each turned about the object, and of the focal length."""
        self._touch(self.state)
        return find_information(self._linearize_outlines())

    def measure_error_px(self) -> float:
        """The reprojection error of the tracks, px per 1000 px of the image, in the mean; 0 without tracks."""
        errors = self._reprojection_errors(self.state)[0]
        return float(np.linalg.norm(errors, axis=1).mean()) if len(errors) else 0.0

    def adjusted_cameras(self) -> list[Camera]:
        """The cameras as they are now, in the frame in which they were given."""
        factor = np.diag([np.exp(self.state.log_focal)] * 2 + [1.0])
        adjusted = []
        for camera, rotation, translation in zip(self.cameras, self.state.rotation, self.state.translation, strict=True):
            pose = make_transform(rotation, translation * self.radius - rotation @ self.centre)
            intrinsics = camera.intrinsics.copy()
            intrinsics[:2, :2] = intrinsics[:2, :2] @ factor[:2, :2]
            adjusted.append(replace(camera, camera_from_world=pose, intrinsics=intrinsics))
        return adjusted

    def adjusted_points(self) -> np.ndarray:
        """(P, 3) the tracks' points, in the frame of the cameras."""
        return self.state.points * self.radius + self.centre

    def _triangulate(self) -> np.ndarray:
        """(P, 3) the points nearest to the rays of their observations."""
        tracks, state = self.tracks, self.state
        if not tracks.count:
            return np.zeros((0, 3))
        rays = self._rays(tracks.view, tracks.pixels, 0.0)
        world = np.einsum("oji,oj->oi", state.rotation[tracks.view], rays)
        world /= np.linalg.norm(world, axis=1, keepdims=True)
        origins = -np.einsum("oji,oj->oi", state.rotation[tracks.view], state.translation[tracks.view])
        across = np.eye(3) - world[:, :, None] * world[:, None, :]
        matrix, right = np.zeros((tracks.count, 3, 3)), np.zeros((tracks.count, 3))
        np.add.at(matrix, tracks.point, across)
        np.add.at(right, tracks.point, np.einsum("oij,oj->oi", across, origins))
        return np.linalg.solve(matrix + 1e-9 * np.eye(3), right[..., None])[..., 0]

    def _rays(self, view: np.ndarray, pixels: np.ndarray, log_focal: float) -> np.ndarray:
        """(K, 3) rays through pixels of views, in their cameras, of depth 1."""
        focal = self.focal_px[view, None] * np.exp(log_focal)
        return np.concatenate([(pixels - self.middle_px[view]) / focal, np.ones((len(view), 1))], axis=1)

    def _project_into(self, state: State, view: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(K, 2) pixels of points in one view, and their (K,) depths: what `_project` says, without an array of cameras."""
        turned = np.einsum("kij,kj->ki", np.broadcast_to(state.rotation[view], (len(points), 3, 3)), points)
        x, y, depth = (turned[:, axis] + state.translation[view, axis] for axis in range(3))
        focal = self.focal_px[view] * np.exp(state.log_focal)
        return np.stack([along / depth * focal + middle for along, middle in zip((x, y), self.middle_px[view], strict=True)], 1), depth

    def _project(self, state: State, view: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(K, 2) pixels of points in views, and (K, 3) the points in their cameras."""
        inside = np.einsum("kij,kj->ki", state.rotation[view], points) + state.translation[view]
        focal = self.focal_px[view, None] * np.exp(state.log_focal)
        return inside[:, :2] / inside[:, 2:] * focal + self.middle_px[view], inside

    def _touch(self, state: State) -> np.ndarray:
        """Find where on each ray the object is, and in which views it misses most; (R,) the least signed distance there."""

        def place(view: np.ndarray, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
            rays = self._rays(view, pixels, state.log_focal) * depth[:, None] - state.translation[view]
            return np.einsum("kji,kj->ki", state.rotation[view], rays)

        def look(view: int, points: np.ndarray) -> np.ndarray:
            distance = self.distance[view]
            if distance is None:
                return np.full(len(points), np.inf)
            pixels, depth = self._project_into(state, view, points)
            return np.where(depth > 0, look_up_many(distance, pixels), -np.float32(REFERENCE_PX))

        return self.rays.touch(state.translation[:, 2], place, look)

    def _measure_cost(self, state: State, noise: Noise) -> float:
        """Of the rays as touched last, and the tracks."""
        miss = np.maximum(-self.rays.value, 0.0) / noise.rims
        errors = self._reprojection_errors(state)[0] / noise.tracks
        return float((miss - np.log1p(miss)).sum() + 0.5 * np.log1p((errors**2).sum(1)).sum())

    def _reprojection_errors(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        tracks = self.tracks
        pixels, inside = self._project(state, tracks.view, state.points[tracks.point])
        return (pixels - tracks.pixels) / self.unit_px[tracks.view, None], inside

    def _differentiate_projection(self, view: np.ndarray, inside: np.ndarray) -> np.ndarray:
        """(K, 2, 3) derivative of pixels, per 1000 px, by points in the cameras."""
        focal = self.focal_px[view] * np.exp(self.state.log_focal) / self.unit_px[view] / inside[:, 2]
        derivative = np.zeros((len(view), 2, 3))
        derivative[:, 0, 0] = derivative[:, 1, 1] = focal
        derivative[:, :, 2] = -focal[:, None] * inside[:, :2] / inside[:, 2:]
        return derivative

    def _linearize_outlines(self) -> SilhouetteRows:
        """Of each touched ray, in the views that it misses most or grazes."""
        state, rays = self.state, self.rays
        source, other = rays.view[rays.ray], rays.other
        ahead = self._rays(source, rays.pixels[rays.ray], state.log_focal)
        through = ahead * rays.depth[rays.ray, None]
        back = state.rotation[source].transpose(0, 2, 1)
        points = np.einsum("kij,kj->ki", back, through - state.translation[source])
        pixels, inside = self._project(state, other, points)
        slope = np.zeros((len(other), 2))
        for view in np.unique(other):
            distance = self.distance[view]
            if distance is not None:
                slope[other == view] = measure_slope(distance, pixels[other == view]) * self.unit_px[view]
        by_inside = np.einsum("kr,krc->kc", slope, self._differentiate_projection(other, inside))
        by_world = np.einsum("kc,kcd->kd", by_inside, state.rotation[other])
        turn = make_cross_matrices(points)
        from_source = np.concatenate([np.einsum("kd,kde->ke", by_world, turn), -np.einsum("kd,kde->ke", by_world, back)], axis=1)
        from_other = np.concatenate([-np.einsum("kd,kde->ke", by_world, turn), by_inside], axis=1)
        bent = through * [-1.0, -1.0, 0.0]
        by_focal = np.einsum("kd,kde,ke->k", by_world, back, bent)
        by_focal += (slope * (pixels - self.middle_px[other]) / self.unit_px[other, None]).sum(1)
        jacobian = np.concatenate([from_source, from_other, by_focal[:, None]], axis=1)
        columns = self._columns(source, other)
        rows = np.repeat(np.arange(len(other)), columns.shape[1])
        sparse = csr_matrix((jacobian.ravel(), (rows, columns.ravel())), (len(other), 6 * len(self.cameras) + 1))
        by_depth = np.einsum("kd,kde,ke->k", by_world, back, ahead)
        return SilhouetteRows(rays.value, sparse, by_depth, rays.ray)

    def _columns(self, *views: np.ndarray) -> np.ndarray:
        """(K, 6 n + 1) of the unknowns of n views each, and of the focal length."""
        parts = [6 * view[:, None] + np.arange(6) for view in views]
        return np.concatenate([*parts, np.full((len(views[0]), 1), 6 * len(self.cameras))], axis=1)

    def _linearize_tracks(self, noise_px: float) -> TrackBlocks:
        """Of all observations, under Cauchy's loss, in units of their noise."""
        state, tracks = self.state, self.tracks
        residual, inside = self._reprojection_errors(state)
        by_inside = self._differentiate_projection(tracks.view, inside)
        by_point = by_inside @ state.rotation[tracks.view]
        turn = -by_point @ make_cross_matrices(state.points[tracks.point])
        pixels = residual + (tracks.pixels - self.middle_px[tracks.view]) / self.unit_px[tracks.view, None]
        jacobian = np.concatenate([turn, by_inside, pixels[..., None]], axis=2) / noise_px
        residual, by_point = residual / noise_px, by_point / noise_px
        columns, weight, point = self._columns(tracks.view), 1 / (1 + (residual**2).sum(1)), tracks.point
        size, count = 6 * len(self.cameras) + 1, tracks.count
        hessian, gradient = np.zeros((size, size)), np.zeros(size)
        np.add.at(hessian, (columns[:, :, None], columns[:, None, :]), np.einsum("k,kra,krb->kab", weight, jacobian, jacobian))
        np.add.at(gradient, columns, np.einsum("k,kra,kr->ka", weight, jacobian, residual))
        coupling, blocks, points_gradient = np.zeros((count, size, 3)), np.zeros((count, 3, 3)), np.zeros((count, 3))
        np.add.at(coupling, (point[:, None], columns), np.einsum("k,kra,krb->kab", weight, jacobian, by_point))
        np.add.at(blocks, point, np.einsum("k,kra,krb->kab", weight, by_point, by_point))
        np.add.at(points_gradient, point, np.einsum("k,kra,kr->ka", weight, by_point, residual))
        return TrackBlocks(hessian, gradient, coupling, blocks, points_gradient)
