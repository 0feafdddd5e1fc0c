"""Triangle meshes, plain or textured, and how they are written to PLY (BOP's layout)."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write

FACE_TYPE = np.dtype([("count", "u1"), ("index", "<i4", 3)])
PLY_TYPES = {"float": "<f4", "uchar": "u1"}
COLORS = ("red", "green", "blue")
SEEN_QUALITY, MEASURED_QUALITY = 0.25, 0.75  # mean quality of a face's corners, halfway between the classes 0, 0.5 and 1
FACING_COSINE = 0.5  # of the angle between a normal and the direction that surface faces: within 60 degrees
SAME_SIDE_COSINE = 0.7  # of the angle between normals: surface within 45 degrees lies on one side of a body
OBJECT_SIZES_M = (0.005, 3.0)  # what is smaller or larger is no object for these programs, or in another unit
MIN_FACES = 100  # fewer cannot describe an object


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh, textured when `uv` and `texture` are there.

    Attributes:
        vertices: (V, 3) float64 positions; the unit is the file's (mm for models and products).
        faces: (F, 3) int64 vertex indices, counter-clockwise seen from outside.
        normals: (V, 3) unit vertex normals, or None.
        uv: (V, 2) texture coordinates, origin at the image's lower left, or None.
        texture: (height, width, 3) uint8 RGB, or None.
        quality: (V,) how certain the surface is: 1 measured, 0.5 assumed, 0 never seen; or None where that is not known.
        colors: (V, 3) uint8 sRGB at the vertices, or None.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None = None
    uv: np.ndarray | None = None
    texture: np.ndarray | None = None
    quality: np.ndarray | None = None
    colors: np.ndarray | None = None

    def with_normals(self) -> "Mesh":
        """The same mesh with area-weighted vertex normals; vertices at one position, split by a texture seam, share theirs."""
        area_normals = self._area_normals()
        _, position = np.unique(self.vertices, axis=0, return_inverse=True)
        position = position.reshape(-1)
        sums = np.zeros((position.max() + 1, 3))
        for corner in range(3):
            np.add.at(sums, position[self.faces[:, corner]], area_normals)
        normals = sums[position]
        return replace(self, normals=normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))

    @property
    def vertex_normals(self) -> np.ndarray:
        """(V, 3) the mesh's normals; where it has none, computed from its faces."""
        normals = self.normals if self.normals is not None else self.with_normals().normals
        assert normals is not None
        return normals

    @property
    def texture_coordinates(self) -> np.ndarray:
        """(V, 2) the mesh's `uv`. Raises StepError where it has none."""
        if self.uv is None:
            raise StepError("the mesh has no texture coordinates (texture_u and texture_v); unwrap it, or take a textured one")
        return self.uv

    @property
    def texture_image(self) -> np.ndarray:
        """(height, width, 3) the mesh's `texture`. Raises StepError where it has none."""
        if self.texture is None:
            raise StepError("the mesh has no texture image; a PLY with a TextureFile comment and that image beside it is needed")
        return self.texture

    @property
    def is_textured(self) -> bool:
        """Whether it has texture coordinates and an image."""
        return self.uv is not None and self.texture is not None

    @property
    def is_colored(self) -> bool:
        """Whether it has a texture, or colours at its vertices."""
        return self.is_textured or self.colors is not None

    def require_quality(self) -> np.ndarray:
        """(V,) quality. Raises ValueError where the mesh has none: a fault of the program, not of the user's."""
        if self.quality is None:
            raise ValueError("the mesh has no quality")
        return self.quality

    def without_loose_vertices(self) -> "Mesh":
        """The same mesh without vertices that belong to no face."""
        used, index = np.unique(self.faces, return_inverse=True)
        return replace(self.take_vertices(used), faces=index.reshape(self.faces.shape))

    def take_vertices(self, index: np.ndarray) -> "Mesh":
        """The mesh with the vertices of these numbers, (N,); the faces still hold the old numbers."""
        values = (None if one is None else one[index] for one in (self.normals, self.uv, self.quality, self.colors))
        normals, uv, quality, colors = values
        return replace(self, vertices=self.vertices[index], normals=normals, uv=uv, quality=quality, colors=colors)

    def seen_faces(self) -> np.ndarray:
        """(F,) bool, faces that photos saw; all without quality."""
        return self._face_quality() >= SEEN_QUALITY

    def assumed_faces(self) -> np.ndarray:
        """(F,) bool, faces that photos saw and that nothing measured; none without quality."""
        return self.seen_faces() & ~self.measured_faces()

    def measured_faces(self) -> np.ndarray:
        """(F,) bool, faces whose position was measured; all without quality."""
        return self._face_quality() >= MEASURED_QUALITY

    def _face_quality(self) -> np.ndarray:
        return np.ones(len(self.faces)) if self.quality is None else self.quality[self.faces].mean(1)

    def face_areas(self) -> np.ndarray:
        """(F,) areas of the faces, in the unit of the vertices squared."""
        return np.linalg.norm(self._area_normals(), axis=1) / 2

    def face_normals(self) -> np.ndarray:
        """(F, 3) unit normals of the faces, zero where a face has no area."""
        normals = self._area_normals()
        return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)

    def _area_normals(self) -> np.ndarray:
        """(F, 3) normals of the faces, as long as twice their areas."""
        corners = self.vertices[self.faces]
        return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _header(vertices: int, types: Mapping[str, str], faces: int, comments: Iterable[str] = ()) -> list[str]:
    """The lines of a header, of vertices with properties of these types by name."""
    words = {kind: name for name, kind in PLY_TYPES.items()}
    return [
        *("ply", "format binary_little_endian 1.0"),
        *(f"comment {comment}" for comment in comments),
        *(f"element vertex {vertices}", *(f"property {words[kind]} {name}" for name, kind in types.items())),
        *(f"element face {faces}", "property list uchar int vertex_indices"),
        *("end_header", ""),
    ]


def write_ply(path: Path, mesh: Mesh, texture_name: str | None = None) -> None:
    """Write a binary PLY: positions, normals, `texture_u`/`texture_v`, and a `TextureFile` comment naming `texture_name`.

    `quality`, where the mesh has it, is a vertex property that MeshLab can show as colours; other readers ignore it. Colours of the
    vertices are red, green and blue, one byte each.
    The caller writes the texture image, because several PLYs may share one.
    """
    columns = {"x": mesh.vertices[:, 0], "y": mesh.vertices[:, 1], "z": mesh.vertices[:, 2]}
    if mesh.normals is not None:
        columns |= {"nx": mesh.normals[:, 0], "ny": mesh.normals[:, 1], "nz": mesh.normals[:, 2]}
    if mesh.uv is not None:
        columns |= {"texture_u": mesh.uv[:, 0], "texture_v": mesh.uv[:, 1]}
    if mesh.quality is not None:
        columns |= {"quality": mesh.quality}
    types = {name: "<f4" for name in columns}
    if mesh.colors is not None:
        columns |= {name: mesh.colors[:, channel] for channel, name in enumerate(COLORS)}
        types |= {name: "u1" for name in COLORS}
    vertex = np.empty(len(mesh.vertices), dtype=list(types.items()))
    for name, values in columns.items():
        vertex[name] = values
    face = np.empty(len(mesh.faces), FACE_TYPE)
    face["count"], face["index"] = 3, mesh.faces
    header = _header(len(vertex), types, len(face), [f"TextureFile {texture_name}"] if texture_name else [])
    with atomic_write(path) as temporary:
        temporary.write_bytes("\n".join(header).encode() + vertex.tobytes() + face.tobytes())


def number_edges(edges: np.ndarray) -> np.ndarray:
    """(E,) numbers of (E, 2) edges in the order of their vertices, in either direction: `np.unique` is slow with rows."""
    return edges.min(1).astype(np.int64) * (int(edges.max(initial=0)) + 1) + edges.max(1)


def diameter_of(mesh: Mesh) -> float:
    """Diagonal of the bounding box, in the mesh's unit: the length that relative measures refer to.

    BOP's diameter is the largest distance between two vertices, which is a little shorter.
    """
    return float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
