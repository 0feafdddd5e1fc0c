"""Plane curves that products are made of: polylines with rounded corners and superellipses."""

from collections.abc import Sequence

import numpy as np

ARC_STEP_RAD = np.deg2rad(9.0)
ARC_STEP_MM = 0.35


def round_polyline(corners: Sequence[tuple[float, ...]], step_mm: float = 3.0, closed: bool = False) -> np.ndarray:
    """Sample a polyline whose corners are rounded.

    Args:
        corners: (x, y) or (x, y, radius) per corner, mm; the radius is shortened where the neighbours are too close.
        step_mm: longest straight piece.
        closed: whether the last corner connects to the first; the first point is not repeated at the end.

    Returns:
        (N, 2) points.
    """
    points = np.array([corner[:2] for corner in corners], float)
    radii = [corner[2] if len(corner) > 2 else 0.0 for corner in corners]
    count = len(points)
    pieces: list[np.ndarray] = []
    for i in range(count):
        if not closed and i in (0, count - 1):
            pieces.append(points[i : i + 1])
            continue
        pieces.append(_round_corner(points[i - 1], points[i], points[(i + 1) % count], radii[i]))
    sampled = [pieces[0][0]]
    for point in [*np.concatenate(pieces)[1:], *([pieces[0][0]] if closed else [])]:
        last = sampled[-1]
        gap = np.linalg.norm(point - last)
        if gap < 1e-6:
            continue
        steps = int(np.ceil(gap / step_mm - 1e-9))
        sampled.extend([last + (point - last) * k / steps for k in range(1, steps + 1)])
    return np.array(sampled[:-1] if closed else sampled)


def arc_length(points: np.ndarray) -> np.ndarray:
    """(N,) length along a polyline (N, 2 or 3), starting at 0."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def sample_superellipse(half_x: float, half_y: float, exponent: float, fractions: np.ndarray, start_rad: float) -> np.ndarray:
    """Points (N, 2) of |x/half_x|^e + |y/half_y|^e = 1, at fractions of its length, counter-clockwise from direction `start_rad`.

    Equal fractions lie at equal distances along the curve, so print that is wrapped around it is not stretched.
    """
    if half_x == half_y and exponent == 2.0:
        angle = start_rad + 2 * np.pi * fractions
        return half_x * np.stack([np.cos(angle), np.sin(angle)], 1)
    angle = start_rad + np.linspace(0, 2 * np.pi, 1441)
    cosine, sine = np.cos(angle), np.sin(angle)
    radius = (np.abs(cosine / half_x) ** exponent + np.abs(sine / half_y) ** exponent) ** (-1.0 / exponent)
    dense = np.stack([radius * cosine, radius * sine], 1)
    length = arc_length(dense) / arc_length(dense)[-1]
    return np.stack([np.interp(fractions, length, dense[:, 0]), np.interp(fractions, length, dense[:, 1])], 1)


def _round_corner(before: np.ndarray, corner: np.ndarray, after: np.ndarray, radius: float) -> np.ndarray:
    """The arc that replaces a corner, or the corner itself."""
    to_before, to_after = before - corner, after - corner
    length_before, length_after = np.linalg.norm(to_before), np.linalg.norm(to_after)
    to_before, to_after = to_before / length_before, to_after / length_after
    half = np.arccos(np.clip(to_before @ to_after, -1, 1)) / 2
    if radius <= 0 or half > np.pi / 2 - 1e-3:
        return corner[None]
    cut = min(radius / np.tan(half), 0.49 * length_before, 0.49 * length_after)
    radius = cut * np.tan(half)
    bisector = (to_before + to_after) / np.linalg.norm(to_before + to_after)
    centre = corner + bisector * radius / np.sin(half)
    first = corner + to_before * cut - centre
    sweep = np.pi - 2 * half
    turn = np.sign(to_after[0] * to_before[1] - to_after[1] * to_before[0])
    steps = max(int(np.ceil(min(sweep / ARC_STEP_RAD, sweep * radius / ARC_STEP_MM))), 2)
    angles = turn * np.linspace(0, sweep, steps + 1)
    rotation = np.stack([np.cos(angles), -np.sin(angles), np.sin(angles), np.cos(angles)], 1).reshape(-1, 2, 2)
    return centre + rotation @ first
