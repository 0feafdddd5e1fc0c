"""Tell an object from a plain table: one colour all over, up to the light that falls on it.

A printed ground is known place by place, from views that see it beside the object (ground.py). That fails on a plain table: a low thing of
one colour looks like ground, because all views agree on its colour, too. But a plain table's colour under the object is known from around
it. A pixel with the table's hue and another brightness may be a shadow or a reflection; it says little.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.geometry.channels import measure_length, sum_channels
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.geometry.support_plane import DEVIATION_OF_MEDIAN
from zeroshop_steps.segment.ground import CELL_DISTANCES, MOST_ODDS, GroundPicture, find_in_front

# Colours are levels of 255, odds natural logarithms, lengths shares of the cameras' distance from the focus.
# Set by hand on six rendered objects on four tables each (docs/results.md).
RING_DISTANCES = 0.55  # the table's colour is learned this far around the foot
ROUNDS = 8  # of reweighting; what stands on the table counts less in each
TUKEY_DEVIATIONS = 3.0  # farther from the fitted colour is no table
MOST_HUE_SPREAD, MOST_LIGHT_SPREAD = 8.0, 13.0
"""Deviations of a plain table's hue and brightness, levels. Wood has 1 and 6, a grey carpet 5 and 12, a printed ground 13 and 33."""
LEAST_SHARE = 0.35  # of the ring's cells must fit; a table that is covered by things is not known
NOISE_LEVELS = 4.0  # of the cameras, after averaging over a few pixels
SAME_HUE_SIGMAS, OTHER_HUE_SIGMAS = 2.0, 6.0
"""Up to the first a hue is the table's, from the second on it is not: mirror images and light from the object tint a table a little."""
SAME_LIGHT_SIGMAS, OTHER_LIGHT_SIGMAS = 1.5, 4.0  # the same for brightness
SHADOW_RANGE = (0.4, 1.2)  # of the table's brightness: shadows, and the shine of lamps
SHADOW_SLOPE = 0.1  # beyond that range, over which the odds change
SHADOW_ODDS = -0.9  # for an object where only the brightness differs within that range
DARK_ODDS = 1.0  # where it is darker or brighter than that
PRINT_RANGE = 8.0  # levels between neighbouring pixels, and four times what is usual on the table: print, grain is less
CLOSED_PX, LEAST_PRINT_PX, PRINT_RIM_PX = 7, 9, 5
"""Gaps in print of up to the first are closed; what is narrower than the second then is an edge, of an object or of a shadow; what is left
ends this far outside of the print, or half of it."""
FINE_PX = 2.0  # print is finer than this, soft shadows are not
PRINT_ODDS = 0.7  # for an object where there is print: a plain table has none, whatever the colours
RISEN_DISTANCES = 0.012  # a sparse point this far above the plane is on an object: three times the plane's own tolerance
COMPANY, COMPANY_DISTANCES = 3, 0.04  # so many other points lie this close to it; lonely points are wrong matches
BLUR_PX = 3  # noise is averaged over this width


@dataclass(frozen=True)
class PlainGround:
    """The colour of a plain table.

    Attributes:
        picture: what it was learned from, for the way from cells to views.
        coefficients: (6, 3) of a quadratic in the cell's position for each channel: light falls off across a table.
        hue_spread, light_spread: deviation of the table's colours from that across and along its own brightness, levels.
    """

    picture: GroundPicture
    coefficients: np.ndarray
    hue_spread: float
    light_spread: float

    def evidence(self, camera: Camera, image: np.ndarray) -> np.ndarray:
        """(H, W) float32 log odds, at most `MOST_ODDS` either way, that a pixel of an (H, W, 3) float32 RGB image shows an object."""
        homography = self.picture.view_from_cell(camera)
        back = np.linalg.inv(homography)
        y, x = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
        w = back[2, 0] * x + back[2, 1] * y + back[2, 2]
        w = np.where(np.abs(w) < 1e-12, 1e-12, w)
        count = self.picture.known.shape[0]
        u, v = ((back[row, 0] * x + back[row, 1] * y + back[row, 2]) / w for row in (0, 1))
        # Beyond the ring the table is taken to look as at its rim.
        inward = np.minimum(RING_DISTANCES / CELL_DISTANCES / np.maximum(np.hypot(u - count / 2, v - count / 2), 1e-9), 1.0)
        u, v = (count / 2 + (part - count / 2) * inward for part in (u, v))
        table = _basis(u, v, count) @ self.coefficients
        hue, light = _split(cv2.blur(image, (BLUR_PX, BLUR_PX)), table)
        hue_off = hue / (NOISE_LEVELS + self.hue_spread)
        light_off = np.abs(light - 1) * measure_length(table) / np.sqrt(3) / (NOISE_LEVELS + self.light_spread)
        other_hue = np.clip((hue_off - SAME_HUE_SIGMAS) / (OTHER_HUE_SIGMAS - SAME_HUE_SIGMAS), 0, 1)
        other_light = np.clip((light_off - SAME_LIGHT_SIGMAS) / (OTHER_LIGHT_SIGMAS - SAME_LIGHT_SIGMAS), 0, 1)
        low, high = SHADOW_RANGE
        extreme = np.clip(np.maximum(low - light, light - high) / SHADOW_SLOPE, 0, 1)
        of_light = (1 - other_light) * -MOST_ODDS + other_light * (SHADOW_ODDS + extreme * (DARK_ODDS - SHADOW_ODDS))
        odds = (1 - other_hue) * of_light + other_hue * MOST_ODDS
        odds = np.where(find_print(image, odds < 0), np.maximum(odds, PRINT_ODDS), odds)
        return np.where(find_in_front(camera, homography), odds, 0.0).astype(np.float32)


def fit_plain_ground(picture: GroundPicture, risen: np.ndarray) -> PlainGround | None:
    """Learn the table's colour; None where the ground is printed, or too little of it is seen.

    Args:
        picture: of the ground.
        risen: (P, 3) sparse points above it. A book's cover may fill more of the picture than the table, and be plainer; what lies below
            the points is left out where the colour is not also that of what lies beside them.
    """
    count = picture.known.shape[0]
    y, x = np.nonzero(picture.known)
    inside = np.hypot(x - count / 2, y - count / 2) < RING_DISTANCES / CELL_DISTANCES
    y, x = y[inside], x[inside]
    beside = ~_find_near(picture, risen)[y, x]
    if not beside.any():
        return None
    plain, table = _fit_color(picture, x, y)
    if plain is None or table[beside].mean() < LEAST_SHARE:
        plain, _ = _fit_color(picture, x[beside], y[beside])
    return plain


def _fit_color(picture: GroundPicture, x: np.ndarray, y: np.ndarray) -> tuple[PlainGround | None, np.ndarray]:
    """The colour of most of the cells at (P,) x and y, None where they are not plain; and (P,) bool: which of them have it."""
    count = picture.known.shape[0]
    colors = picture.color[y, x].astype(float)
    basis = _basis(x, y, count)
    weights = np.ones(len(y))
    fitted = np.median(colors, axis=0)[None]
    for _ in range(ROUNDS):
        off = np.linalg.norm(colors - fitted, axis=1) / np.sqrt(3)
        spread = DEVIATION_OF_MEDIAN * float(np.median(off))
        weights = np.clip(1 - (off / (TUKEY_DEVIATIONS * max(spread, 1.0))) ** 2, 0, None) ** 2
        coefficients = np.linalg.lstsq(basis * weights[:, None], colors * weights[:, None], rcond=None)[0]
        fitted = basis @ coefficients
    table = weights > 0
    hue, light = _split(colors[table], fitted[table])
    light_levels = np.abs(light - 1) * np.linalg.norm(fitted[table], axis=1) / np.sqrt(3)
    hue_spread, light_spread = (DEVIATION_OF_MEDIAN * float(np.median(part)) for part in (hue, light_levels))
    if hue_spread > MOST_HUE_SPREAD or light_spread > MOST_LIGHT_SPREAD or table.mean() < LEAST_SHARE:
        return None, table
    return PlainGround(picture, coefficients, hue_spread, light_spread), table


def find_print(image: np.ndarray, table: np.ndarray) -> np.ndarray:
    """(H, W) bool: where an (H, W, 3) float32 RGB image of a plain table shows print; `table` is where its colours are the table's."""
    light = np.asarray(cv2.blur(sum_channels(image) / 3, (2, 2)))
    light = light - np.asarray(cv2.GaussianBlur(light, (0, 0), FINE_PX))  # without the slopes of soft shadows
    window = np.ones((3, 3), np.uint8)
    steps = cv2.dilate(light, window) - cv2.erode(light, window)
    usual = float(np.median(steps[table])) if table.any() else 0.0
    rough = (steps > max(PRINT_RANGE, 4 * usual)).astype(np.uint8)
    closed = cv2.morphologyEx(rough, cv2.MORPH_CLOSE, np.ones((CLOSED_PX,) * 2, np.uint8))
    wide = cv2.morphologyEx(closed, cv2.MORPH_OPEN, np.ones((LEAST_PRINT_PX,) * 2, np.uint8))
    return cv2.erode(wide, np.ones((PRINT_RIM_PX,) * 2, np.uint8)) > 0


def find_risen_points(points: np.ndarray, support: SceneSupport) -> np.ndarray:
    """Those of the (P, 3) sparse points that lie clearly above the plane, with others near them."""
    near = points[np.linalg.norm(points - support.focus, axis=1) < support.distance]
    high = near[support.heights(near) > RISEN_DISTANCES * support.distance]
    if len(high) <= COMPANY:
        return high[:0]
    distances, _ = cKDTree(high).query(high, COMPANY + 1)
    return high[distances[:, -1] < COMPANY_DISTANCES * support.distance]


def find_below(picture: GroundPicture, points: np.ndarray) -> np.ndarray:
    """(N, N) bool: the cells below (P, 3) points and between them."""
    return _measure_depth(_find_near(picture, points)) >= COMPANY_DISTANCES / CELL_DISTANCES


def _find_near(picture: GroundPicture, points: np.ndarray) -> np.ndarray:
    """(N, N) bool: the cells below (P, 3) points and near to that."""
    axes = picture.world_from_cell[:3, :2]
    x, y = np.round((points - picture.world_from_cell[:3, 2]) @ axes / (axes**2).sum(0)).astype(int).T
    away = np.ones(picture.known.shape, bool)
    inside = (np.minimum(x, y) >= 0) & (np.maximum(x, y) < len(away))
    away[y[inside], x[inside]] = False
    return _measure_depth(away) < COMPANY_DISTANCES / CELL_DISTANCES


def _measure_depth(cells: np.ndarray) -> np.ndarray:
    """(N, N) float32: how far the cells of a (N, N) bool part lie from what is not part of it; 0 there."""
    return np.asarray(cv2.distanceTransform(cells.astype(np.uint8), cv2.DIST_L2, 5))


def join_odds(by_place: np.ndarray, by_table: np.ndarray) -> np.ndarray:
    """(H, W) log odds of the object by what views see at a place of the ground, and by the table's colour, at most `MOST_ODDS` either way.

    That all views agree on a colour is no sign of ground where it is not the table's colour: low things of one colour look so. And
    where the others see the table lighter at this place, it is no shadow: a shadow lies there in all views.
    """
    by_place = np.where(by_table > 0, np.maximum(by_place, 0.0), by_place)
    not_shadow = np.minimum((by_table - SHADOW_ODDS) * MOST_ODDS / (MOST_ODDS + SHADOW_ODDS), 0.0)
    by_table = np.where((by_place > 0) & (by_table < 0), not_shadow, by_table)
    return np.clip(by_place + by_table, -MOST_ODDS, MOST_ODDS)


def _split(colors: np.ndarray, table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far (..., 3) colours are from the table's in the best fitting light, in levels, and that light, as a factor."""
    light = (colors * table).sum(-1) / np.maximum((table * table).sum(-1), 1.0)
    return np.linalg.norm(colors - light[..., None] * table, axis=-1), light


def _basis(x: np.ndarray, y: np.ndarray, count: int) -> np.ndarray:
    """(..., 6) quadratic basis of positions in cells."""
    x, y = x / count - 0.5, y / count - 0.5
    return np.stack([np.ones_like(x, dtype=float), x, y, x * x, x * y, y * y], -1)
