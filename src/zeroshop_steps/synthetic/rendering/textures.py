"""Filtered texture look-up for the ray caster: mip pyramids and anisotropic trilinear sampling in linear light."""

from dataclasses import dataclass

import cv2
import numba
import numpy as np

from zeroshop_steps.geometry.imaging.srgb import linear_to_srgb, srgb_to_linear

MAX_PROBES = 16  # of the texture along the longer side of a pixel's footprint

LINEAR_OF_BYTE = srgb_to_linear(np.arange(256) / 255.0).astype(np.float32)
_BYTE_OF_LINEAR = np.rint(linear_to_srgb(np.linspace(0.0, 1.0, 16385)) * 255).astype(np.uint8)


def encode_srgb(linear: np.ndarray) -> np.ndarray:
    """Linear light to uint8 sRGB, clipped, by table."""
    return _BYTE_OF_LINEAR[(np.clip(linear, 0.0, 1.0) * (len(_BYTE_OF_LINEAR) - 1) + 0.5).astype(np.int32)]


@dataclass(frozen=True)
class MipPyramid:
    """A mip pyramid in one flat array.

    Attributes:
        texels: (T, 3) uint8 sRGB, all levels one after the other, rows from the top.
        levels: (L, 3) int64 offset, width, height of each level, finest first.
        wrap: whether coordinates repeat beyond 0..1 (else they are clamped).
    """

    texels: np.ndarray
    levels: np.ndarray
    wrap: bool


def build_pyramid(image: np.ndarray, coverage: np.ndarray | None = None, wrap: bool = False) -> MipPyramid:
    """Average an image down level by level in linear light.

    Args:
        image: (height, width, 3) uint8 sRGB.
        coverage: (height, width) bool, texels that the mesh uses. The others are filled from their neighbours, so that an
            atlas's background does not bleed over its seams. All when None.
        wrap: whether texture coordinates repeat.
    """
    linear = LINEAR_OF_BYTE[image]
    share = None if coverage is None or coverage.all() else coverage
    sums: list[np.ndarray] = [linear if share is None else linear * share[..., None]]
    weights: list[np.ndarray] = [] if share is None else [share.astype(np.float32)]
    while max(sums[-1].shape[:2]) > 1:
        height, width = sums[-1].shape[:2]
        size = (max(width // 2, 1), max(height // 2, 1))
        sums.append(cv2.resize(sums[-1], size, interpolation=cv2.INTER_AREA))
        if share is not None:
            weights.append(cv2.resize(weights[-1], size, interpolation=cv2.INTER_AREA))
    # Every byte comes back from linear light as it was, so that the finest level, three quarters of the work, need not be encoded.
    encoded = [image] if share is None else []
    filled = sums[1:] if share is None else _fill_levels(sums, weights)
    encoded += [encode_srgb(level) for level in filled]
    sizes = np.array([[0, level.shape[1], level.shape[0]] for level in encoded], np.int64)
    sizes[1:, 0] = np.cumsum(sizes[:-1, 1] * sizes[:-1, 2])
    return MipPyramid(np.concatenate([level.reshape(-1, 3) for level in encoded]), sizes, wrap)


def _fill_levels(sums: list[np.ndarray], weights: list[np.ndarray]) -> list[np.ndarray]:
    """Mean colours of all levels, finest first; where a level has no covered texel, those of the next coarser one."""
    filled = [sums[-1] / max(float(weights[-1].max()), 1e-6)]
    for total, weight in zip(reversed(sums[:-1]), reversed(weights[:-1]), strict=True):
        level = total / np.maximum(weight[..., None], 1e-6)
        coarser = cv2.resize(filled[-1], (total.shape[1], total.shape[0]), interpolation=cv2.INTER_LINEAR)
        filled.append(np.where((weight < 1e-3)[..., None], coarser, level))
    return filled[::-1]


def find_texture_coverage(uv: np.ndarray, faces: np.ndarray, width: int, height: int) -> np.ndarray:
    """(height, width) bool: texels that some triangle uses. uv (V, 2) has its origin at the lower left."""
    coverage = np.zeros((height, width), np.uint8)
    corners = np.stack([uv[:, 0] * width - 0.5, (1.0 - uv[:, 1]) * height - 0.5], 1)[faces]
    for triangle in np.rint(corners * 16).astype(np.int32):
        cv2.fillConvexPoly(coverage, triangle, 1, lineType=cv2.LINE_8, shift=4)
    return coverage.astype(bool)


@numba.njit(cache=True, fastmath=True, inline="always")
def _bilinear(texels, linear_of_byte, offset, width, height, wrap, u, v):
    x, y = u * width - 0.5, (1.0 - v) * height - 0.5
    left, top = int(np.floor(x)), int(np.floor(y))
    fx, fy = x - left, y - top
    right, bottom = left + 1, top + 1
    if wrap:
        left, right, top, bottom = left % width, right % width, top % height, bottom % height
    else:
        left, right = min(max(left, 0), width - 1), min(max(right, 0), width - 1)
        top, bottom = min(max(top, 0), height - 1), min(max(bottom, 0), height - 1)
    a, b = offset + top * width + left, offset + top * width + right
    c, d = offset + bottom * width + left, offset + bottom * width + right
    wa, wb, wc, wd = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
    red = green = blue = 0.0
    for texel, weight in ((a, wa), (b, wb), (c, wc), (d, wd)):
        red += weight * linear_of_byte[texels[texel, 0]]
        green += weight * linear_of_byte[texels[texel, 1]]
        blue += weight * linear_of_byte[texels[texel, 2]]
    return red, green, blue


@numba.njit(cache=True, forceinline=True, fastmath=True)
def sample_mip_levels(texels, levels, wrap, linear_of_byte, u, v, ux, vx, uy, vy):
    """Mean linear colour of a pixel's footprint, a parallelogram in texture space (after Heckbert 1989, probes along its long side).

    Args:
        texels, levels, wrap: a `MipPyramid`'s fields.
        linear_of_byte: (256,) decoding table.
        u, v: centre, origin at the lower left.
        ux, vx, uy, vy: change of u and v over one pixel to the right and one down.

    Returns:
        red, green, blue in linear light.
    """
    width, height = levels[0, 1], levels[0, 2]
    length_x = np.sqrt((ux * width) ** 2 + (vx * height) ** 2)
    length_y = np.sqrt((uy * width) ** 2 + (vy * height) ** 2)
    if length_x >= length_y:
        major, du, dv = length_x, ux, vx
    else:
        major, du, dv = length_y, uy, vy
    minor = max(abs(ux * vy - uy * vx) * width * height / max(major, 1e-6), 1e-3)
    probes = min(max(int(np.ceil(major / max(minor, 1.0))), 1), MAX_PROBES)
    lod = np.log2(max(max(minor, major / probes), 1e-3))
    last = levels.shape[0] - 1
    lod = min(max(lod, 0.0), float(last))
    fine = int(lod)
    coarse = min(fine + 1, last)
    blend = lod - fine
    red, green, blue = 0.0, 0.0, 0.0
    for probe in range(probes):
        shift = (probe + 0.5) / probes - 0.5
        pu, pv = u + shift * du, v + shift * dv
        r, g, b = _bilinear(texels, linear_of_byte, levels[fine, 0], levels[fine, 1], levels[fine, 2], wrap, pu, pv)
        if blend > 1e-3:
            r2, g2, b2 = _bilinear(texels, linear_of_byte, levels[coarse, 0], levels[coarse, 1], levels[coarse, 2], wrap, pu, pv)
            r, g, b = r + blend * (r2 - r), g + blend * (g2 - g), b + blend * (b2 - b)
        red += r
        green += g
        blue += b
    return red / probes, green / probes, blue / probes
