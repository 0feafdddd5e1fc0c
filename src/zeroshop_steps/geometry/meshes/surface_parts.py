"""Parts of a surface with colours in any form, joined to one mesh with one texture or with colours at its vertices."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh

PLAIN_GREY = 190  # of 255, of a surface without any colour
MOST_TEXELS = 1 << 28  # of a joined texture
TEXEL_TOLERANCE = 1e-3  # by which texture coordinates within an image may leave it


@dataclass(frozen=True)
class SurfacePart:
    """Faces with one texture, or without any.

    Attributes:
        surface: positions, faces and what the vertices have.
        corner_uv: (F, 3, 2) texture coordinates of the faces' corners, or None; then those of the vertices count.
        face_colors: (F, 3) uint8, or None; then those of the vertices count.
    """

    surface: Mesh
    corner_uv: np.ndarray | None = None
    face_colors: np.ndarray | None = None


def join_parts(parts: Sequence[SurfacePart]) -> Mesh:
    """One surface of all parts, whose vertices are split where corners differ in texture coordinates or colour.

    Several textures become one image. Where some parts have a texture, the colours of the others become part of it.

    Raises:
        ValueError: a face among several textures repeats one of them.
    """
    surfaces = [_split_vertices(part) for part in parts]
    if len(surfaces) == 1:
        return surfaces[0]
    if any(one.texture is not None for one in surfaces):
        surfaces = _share_texture([with_texture(one) for one in surfaces])
    elif any(one.colors is not None for one in surfaces):
        grey = (np.full((len(one.vertices), 3), PLAIN_GREY, np.uint8) for one in surfaces)
        surfaces = [one if one.colors is not None else replace(one, colors=plain) for one, plain in zip(surfaces, grey, strict=True)]
    starts = np.cumsum([0, *(len(one.vertices) for one in surfaces)])
    faces = np.concatenate([one.faces + start for one, start in zip(surfaces, starts, strict=False)])

    def joined(values: list[np.ndarray | None]) -> np.ndarray | None:
        there = [one for one in values if one is not None]
        return np.concatenate(there) if len(there) == len(values) else None

    return Mesh(
        np.concatenate([one.vertices for one in surfaces]),
        faces,
        joined([one.normals for one in surfaces]),
        joined([one.uv for one in surfaces]),
        surfaces[0].texture,
        joined([one.quality for one in surfaces]),
        joined([one.colors for one in surfaces]),
    )


def with_texture(mesh: Mesh) -> Mesh:
    """The mesh with a texture: its own, or else one of its vertices' colours or of plain grey.

    Every face has 2 x 2 texels of its own, between whose centres a bilinear lookup is the interpolation between its corners.
    """
    if mesh.is_textured:
        return mesh
    if mesh.colors is None:
        texture = np.full((4, 4, 3), PLAIN_GREY, np.uint8)
        return replace(mesh, uv=np.full((len(mesh.vertices), 2), 0.5), texture=texture)
    count = len(mesh.faces)
    columns = max(1, int(np.ceil(np.sqrt(count))))
    rows = max(1, -(-count // columns))
    corners = mesh.colors[mesh.faces].astype(int)
    blocks = np.zeros((rows * columns, 2, 2, 3), np.uint8)
    blocks[:count, 0, 0], blocks[:count, 0, 1], blocks[:count, 1, 0] = corners[:, 0], corners[:, 1], corners[:, 2]
    blocks[:count, 1, 1] = np.clip(corners[:, 1] + corners[:, 2] - corners[:, 0], 0, 255)
    texture = blocks.reshape(rows, columns, 2, 2, 3).transpose(0, 2, 1, 3, 4).reshape(2 * rows, 2 * columns, 3)
    place = np.stack(np.divmod(np.arange(count), columns)[::-1], 1)[:, None] * 2 + [[0.5, 0.5], [1.5, 0.5], [0.5, 1.5]]
    uv = place.reshape(-1, 2) / [2 * columns, 2 * rows]
    uv[:, 1] = 1.0 - uv[:, 1]
    index = mesh.faces.reshape(-1)
    split = mesh.take_vertices(index)
    return replace(split, faces=np.arange(3 * count).reshape(-1, 3), uv=uv, texture=texture)


def _split_vertices(part: SurfacePart) -> Mesh:
    """The surface with a vertex for every pair of a vertex and what its corners have."""
    surface, faces = part.surface, part.surface.faces
    if part.corner_uv is None and part.face_colors is None:
        return surface
    keys = [faces.reshape(-1, 1).astype(float)]
    keys += [] if part.corner_uv is None else [part.corner_uv.reshape(-1, 2)]
    keys += [] if part.face_colors is None else [np.repeat(part.face_colors, 3, axis=0).astype(float)]
    _, first, index = np.unique(np.concatenate(keys, 1), axis=0, return_index=True, return_inverse=True)
    split = replace(surface.take_vertices(faces.reshape(-1)[first]), faces=index.reshape(-1, 3))
    if part.corner_uv is not None:
        split = replace(split, uv=part.corner_uv.reshape(-1, 2)[first])
    return split if part.face_colors is None else replace(split, colors=np.repeat(part.face_colors, 3, axis=0)[first])


def _share_texture(surfaces: list[Mesh]) -> list[Mesh]:
    """The same surfaces with all their textures in one image, in rows."""
    textures = list({id(one.texture): one.texture for one in surfaces if one.texture is not None}.values())
    columns = int(np.ceil(np.sqrt(len(textures))))
    rows = [textures[start : start + columns] for start in range(0, len(textures), columns)]
    heights = [max(image.shape[0] for image in row) for row in rows]
    width = max(sum(image.shape[1] for image in row) for row in rows)
    if sum(heights) * width > MOST_TEXELS:
        raise ValueError(f"its {len(textures)} textures together have {sum(heights) * width:.2g} pixels; bake them into one image")
    shared = np.zeros((sum(heights), width, 3), np.uint8)
    corner_px: dict[int, tuple[int, int]] = {}
    for number, image in enumerate(textures):
        row, column = divmod(number, columns)
        left, top = corner_px[id(image)] = sum(one.shape[1] for one in rows[row][:column]), sum(heights[:row])
        shared[top : top + image.shape[0], left : left + image.shape[1]] = image
    placed = []
    for surface in map(_move_into_image, surfaces):
        assert surface.uv is not None and surface.texture is not None
        size = np.array(surface.texture.shape[1::-1])
        # Half a texel from the border, so that no lookup mixes in the neighbour.
        pixels = np.clip(surface.uv * [1, -1] * size + [0, size[1]], 0.5, size - 0.5) + corner_px[id(surface.texture)]
        uv = pixels / shared.shape[1::-1]
        placed.append(replace(surface, uv=np.stack([uv[:, 0], 1.0 - uv[:, 1]], 1), texture=shared))
    return placed


def _move_into_image(surface: Mesh) -> Mesh:
    """The surface with texture coordinates within 0 and 1, where they repeat. Raises ValueError where one face needs a repetition."""
    assert surface.uv is not None
    if not len(surface.faces) or (surface.uv.min() > -TEXEL_TOLERANCE and surface.uv.max() < 1 + TEXEL_TOLERANCE):
        return surface
    uv = surface.uv[surface.faces]
    moved = uv - np.floor(uv.min(1, keepdims=True) + TEXEL_TOLERANCE)
    if moved.max() > 1 + TEXEL_TOLERANCE:
        raise ValueError("it has several textures, and a face repeats one of them; bake them into one image")
    split = surface.take_vertices(surface.faces.reshape(-1))
    return replace(split, faces=np.arange(surface.faces.size).reshape(-1, 3), uv=moved.reshape(-1, 2))
