"""The surface in a PLY file of any program: polygons, texture coordinates at vertices or corners, several textures, colours."""

import io
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np
from PIL import Image

from zeroshop_steps.geometry.imaging.image_files import any_size
from zeroshop_steps.geometry.imaging.images import IMAGE_SUFFIXES, read_image, to_rgb
from zeroshop_steps.geometry.meshes.mesh_repair import cut_polygons, find_triangles
from zeroshop_steps.geometry.meshes.ply_tables import Element, Lists, PlyTables, read_ply_tables, read_remarks
from zeroshop_steps.geometry.meshes.surface_parts import SurfacePart, join_parts
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import GIT_LFS_POINTER

CORNERS = ("vertex_indices", "vertex_index")
TEXTURE_COORDINATES = (("texture_u", "texture_v"), ("s", "t"), ("u", "v"), ("texture_s", "texture_t"))
COLORS = (
    ("red", "green", "blue"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
    ("ambient_red", "ambient_green", "ambient_blue"),
    ("r", "g", "b"),
)
OTHERS = {b"ply": "PLY: name it .ply", b"glTF": "GLB: name it .glb", b"PK": "ZIP: unpack it", GIT_LFS_POINTER: "Git LFS: git lfs pull"}
"""Kinds of files by their first bytes, and what to do where the name says another one."""
LARGEST_TEXTURE_COORDINATE = 1e4
"""Beyond 0 and 1 a texture repeats; so often it never does, and in float32 nothing of the place within the image would be left."""
TEXTURE_REMARK = re.compile(r"texture_?(?:file|name)\s*[:=]?\s+(.+)", re.IGNORECASE)


def read_ply(path: Path) -> Mesh:
    """Read a PLY mesh of any program, and from beside it the textures that its `TextureFile` comments name.

    Polygons become triangles. Vertices are split where corners differ in texture coordinates or faces in colour; several textures become
    one.

    Raises:
        StepError: the mesh is missing, damaged or without faces, or a texture is missing or outside the mesh's folder.
    """
    path = Path(path)
    require_mesh_file(path)
    tables = read_ply_tables(path)
    vertex, face = tables.elements.get("vertex"), tables.elements.get("face")
    if vertex is None or not {"x", "y", "z"} <= set(vertex.columns):
        raise StepError(f"mesh {path} has no vertices with x, y and z; export it again")
    vertices = _stack(vertex.columns, ("x", "y", "z"))
    assert vertices is not None
    faces, polygons, corners = _triangles(tables, vertices)
    if not len(faces):
        remedy = "Export it again."
        if face is not None and face.rows and not set(CORNERS) & set(face.lists):
            remedy = f"Its faces have {' and '.join(face.lists) or 'no lists'}, not {' or '.join(CORNERS)}: rename the corners' list."
        elif len(vertices):
            kind = "It holds 3D Gaussians (splats)" if "f_dc_0" in vertex.columns else "It is a point cloud"
            remedy = f"{kind}: make a surface of it, such as by Screened Poisson in MeshLab."
        raise StepError(f"mesh {path} has {len(vertices)} vertices and {len(faces)} faces; a surface is needed. {remedy}")
    if faces.min() < 0 or faces.max() >= len(vertices):
        odd = int(faces.min() if faces.min() < 0 else faces.max())
        raise StepError(f"mesh {path} is damaged: a face has vertex {odd}, but there are {len(vertices)}, from 0 on; export it again")
    lost = ~np.isfinite(vertices).all(1)
    if lost[faces].any():
        first = int(faces[lost[faces]].min())
        raise StepError(
            f"mesh {path} is damaged: places of vertices that faces use are not finite, the first of vertex {first}; export it again"
        )
    vertices[lost] = vertices[faces[0, 0]]  # no face uses them
    quality = vertex.columns.get("quality")
    # Other programs call any scalar quality.
    known = quality is not None and len(quality) and quality.min() >= 0 and quality.max() <= 1
    normals = _stack(vertex.columns, ("nx", "ny", "nz"))
    surface = Mesh(
        vertices,
        faces,
        normals if normals is None or np.isfinite(normals).all() else None,
        _first_pair(vertex),
        None,
        quality.astype(float) if known and quality is not None else None,
        _colors(vertex),
    )
    corner_uv = _corner_coordinates(face, polygons, corners, path) if face is not None and surface.uv is None else None
    for values in (surface.uv, corner_uv):
        if values is not None and not (np.abs(values) <= LARGEST_TEXTURE_COORDINATE).all():
            raise StepError(
                f"mesh {path} has texture coordinates that are not finite or larger than {LARGEST_TEXTURE_COORDINATE:g};"
                " 0 to 1 is the image: unwrap it again"
            )
    face_colors = _colors(face) if face is not None and polygons is not None else None
    parts = SurfacePart(surface, corner_uv, None if face_colors is None or polygons is None else face_colors[polygons])
    textures = find_textures(path, tables.remarks) if surface.uv is not None or corner_uv is not None else []
    numbers = face.columns.get("texnumber") if face is not None else None
    if numbers is not None and polygons is not None:
        numbers = numbers.astype(int)[polygons]
    try:
        return join_parts(_by_texture(parts, numbers, textures, path))
    except ValueError as error:
        raise StepError(f"mesh {path} cannot be used as it is: {error}") from None


def require_mesh_file(path: Path) -> None:
    """Raise StepError where a mesh is not there, a folder, or of another kind than its name says."""
    if path.is_dir():
        raise StepError(f"mesh {path} is a folder; name the mesh in it")
    if not path.is_file():
        raise StepError(f"mesh {path} does not exist; check the path, or run the step that writes it")
    with path.open("rb") as file:
        start = file.read(32)
    for begin, kind in OTHERS.items():
        if start.startswith(begin) and not kind.endswith(path.suffix.lower()):
            raise StepError(f"mesh {path} is no {path.suffix[1:].upper()} but {kind}, by its first bytes")


def _by_texture(whole: SurfacePart, numbers: np.ndarray | None, textures: list[Path], path: Path) -> list[SurfacePart]:
    """The part of each texture, and that of faces without one."""
    if not textures:
        return [whole]
    if numbers is None and len(textures) > 1:
        warn(
            f"mesh {path} names {len(textures)} textures, but no texnumber says which faces have which; {textures[0].name} is drawn on all"
        )
    if numbers is None or (len(textures) == 1 and not (numbers < 0).any()):
        return [_textured(whole, read_texture(path, textures[0]))]
    if numbers.max() >= len(textures):
        raise StepError(
            f"mesh {path} has faces of texture {numbers.max()}, but names {len(textures)} textures, counted from 0; export it again"
        )
    parts = []
    for number in np.unique(np.maximum(numbers, -1)):
        faces = np.maximum(numbers, -1) == number
        corner_uv, colors = (None if values is None else values[faces] for values in (whole.corner_uv, whole.face_colors))
        part = SurfacePart(replace(whole.surface, faces=whole.surface.faces[faces]), corner_uv, colors)
        parts.append(_textured(part, read_texture(path, textures[number])) if number >= 0 else part)
    return parts


def _textured(part: SurfacePart, texture: np.ndarray) -> SurfacePart:
    return SurfacePart(replace(part.surface, texture=texture), part.corner_uv, part.face_colors)


def read_texture(path: Path, texture: Path, content: bytes | None = None) -> np.ndarray:
    """(H, W, 3) uint8 RGB of a mesh's texture of any kind that Pillow reads, such as TGA and DDS. Raises StepError for others."""
    if content is None and texture.suffix.lower() in IMAGE_SUFFIXES:
        return read_image(texture)
    try:
        with any_size(), Image.open(io.BytesIO(texture.read_bytes() if content is None else content)) as image:
            if image.mode == "F":
                raise ValueError
            return to_rgb(image)
    except (OSError, SyntaxError, ValueError, NotImplementedError):
        raise StepError(
            f"texture {texture} of mesh {path} is empty, damaged or of a kind that is not read, such as EXR, KTX2 or floats; export it as"
            " PNG or JPEG"
        ) from None


def find_textures(path: Path, remarks: tuple[str, ...] | None = None) -> list[Path]:
    """The images that a PLY names in its `TextureFile` comments, in order.

    Raises:
        StepError: one is missing, or outside the mesh's folder, which a model from elsewhere could use to have any file read.
    """
    found = (TEXTURE_REMARK.fullmatch(remark.strip()) for remark in (read_remarks(path) if remarks is None else remarks))
    textures = [find_beside(path, match[1].strip().strip("\"'"), "the texture") for match in found if match]
    for texture in textures:
        if not texture.is_file():
            raise StepError(
                f"mesh {path} names the texture {texture.name}, but {texture} does not exist; put it there, or remove the line TextureFile"
                " to use the shape alone"
            )
    return textures


def find_beside(path: Path, name: str, what: str) -> Path:
    """The file that a mesh names, in its own folder; of a path elsewhere, the file of that name beside the mesh, if there is one.

    Where no name is the same, one that differs in upper and lower case is: Windows, where many meshes come from, tells no difference.

    Raises:
        StepError: the name leads out of the mesh's folder, and no file of that name is in it.
    """
    windows = PureWindowsPath(name)
    relative = PurePosixPath(*windows.parts) if "\\" in name else PurePosixPath(name)
    if windows.drive or windows.root or relative.is_absolute() or ".." in relative.parts:
        if (path.parent / windows.name).is_file():
            return path.parent / windows.name
        raise StepError(f"mesh {path} names {what} {name}, which is outside its folder; put the file beside the mesh and name that")
    found = path.parent / relative
    alike = [] if found.exists() or not found.parent.is_dir() else sorted(found.parent.iterdir())
    return next((one for one in alike if one.name.casefold() == found.name.casefold()), found)


def _triangles(tables: PlyTables, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """(F, 3) faces; (F,) the polygons that they are of, and (F, 3) their corners in these: None of strips."""
    face = tables.elements.get("face")
    listed = next((face.lists[name] for name in CORNERS if face is not None and name in face.lists), None)
    if listed is not None and len(listed.values) and len(vertices):
        values = listed.values.astype(np.int64)
        polygons, corners = cut_polygons(vertices[np.clip(values, 0, len(vertices) - 1)], listed.counts)
        starts = np.cumsum(listed.counts) - listed.counts
        return values[starts[polygons][:, None] + corners], polygons, corners
    strips = tables.elements.get("tristrips")
    if strips is None:
        return np.zeros((0, 3), np.int64), None, None
    found: list[np.ndarray] = []
    for listed in (strips.lists[name] for name in CORNERS if name in strips.lists):
        values = listed.values.astype(np.int64)
        for strip in np.split(values, np.flatnonzero(values < 0)):
            strip = strip[strip >= 0]
            if len(strip) >= 3:
                rows = np.stack([strip[:-2], strip[1:-1], strip[2:]], 1)
                rows[1::2] = rows[1::2, [1, 0, 2]]
                found.append(rows[find_triangles(rows)])
    return np.concatenate(found) if found else np.zeros((0, 3), np.int64), None, None


def _corner_coordinates(face: Element, polygons: np.ndarray | None, corners: np.ndarray | None, path: Path) -> np.ndarray | None:
    """(F, 3, 2) texture coordinates of the triangles' corners, 0 where a polygon has none. Raises StepError where it has half of them."""
    listed: Lists | None = face.lists.get("texcoord")
    sizes = next((face.lists[name].counts for name in CORNERS if name in face.lists), None)
    if listed is None or polygons is None or corners is None or sizes is None or not len(listed.values):
        return None
    starts, whole = np.cumsum(listed.counts) - listed.counts, listed.counts == 2 * sizes
    odd = np.flatnonzero(~whole & (listed.counts > 0))
    if len(odd):
        raise StepError(
            f"mesh {path} is damaged: face {odd[0]} has {sizes[odd[0]]} corners and {listed.counts[odd[0]]} numbers in texcoord; expected"
            f" {2 * sizes[odd[0]]}, two for each; export it again"
        )
    places = np.where(whole[polygons][:, None], starts[polygons][:, None] + 2 * corners, 0)
    uv = np.stack([listed.values[places], listed.values[places + 1]], 2).astype(float)
    return np.where(whole[polygons][:, None, None], uv, 0.0)


def _stack(columns: Mapping[str, np.ndarray], names: tuple[str, ...]) -> np.ndarray | None:
    return np.stack([columns[name].astype(float) for name in names], 1) if set(names) <= set(columns) else None


def _first_pair(vertex: Element) -> np.ndarray | None:
    return next((pair for names in TEXTURE_COORDINATES if (pair := _stack(vertex.columns, names)) is not None), None)


def _colors(element: Element) -> np.ndarray | None:
    """(N, 3) uint8 colours of an element's rows. Floating ones are 0..1, wide whole ones 0..65535; or 0..255, where that is their range."""
    for names in COLORS:
        values = _stack(element.columns, names)
        if values is not None and len(values):
            values = np.nan_to_num(values)
            code = element.code_of(names[0])
            if code == "b":  # bytes that a program declared as char
                values = values % 256
            full = 255
            if code in "fd" and values.max() <= 1:
                full = 1
            elif code == "H" and values.max() > 255:
                full = 65535
            return np.clip(np.rint(values * (255 / full)), 0, 255).astype(np.uint8)
    return None
