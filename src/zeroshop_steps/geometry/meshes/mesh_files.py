"""Meshes that users have: PLY, and through trimesh OBJ, glTF, STL and OFF."""

import codecs
import io
import json
import logging
import re
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.geometry.imaging.image_files import any_size
from zeroshop_steps.geometry.imaging.images import IMAGE_SUFFIXES, to_rgb, write_image
from zeroshop_steps.geometry.meshes.obj_text import cut_obj, scale_colors
from zeroshop_steps.geometry.meshes.ply_surface import find_beside, find_textures, read_ply, read_texture, require_mesh_file
from zeroshop_steps.geometry.meshes.surface_parts import SurfacePart, join_parts, with_texture
from zeroshop_steps.geometry.meshes.triangle_meshes import OBJECT_SIZES_M, Mesh, write_ply
from zeroshop_steps.geometry.meshes.units import MM_PER_M
from zeroshop_steps.runtime.errors import StepError, warn

GLTF = (".glb", ".gltf")
SUFFIXES = (".ply", ".obj", *GLTF, ".stl", ".off")
"""Formats, the preferred one first."""
TRANSFORM = "KHR_texture_transform"
READABLE = ("KHR_materials_", "KHR_lights_", "KHR_xmp", "KHR_texture_basisu", "EXT_texture_webp", "KHR_draco_mesh_compression", TRANSFORM)
"""Extensions of glTF that may be in a file, as long as it does not require them: they change no shape, or have a substitute."""
TEXTURE_OPTIONS = re.compile(
    r"(-(clamp|blend[uv]|cc) (on|off) +|-(bm|boost|texres|imfchan|colorspace) \S+ +"
    r"|-s( 1(\.0*)?)+ +|-[ot]( 0(\.0*)?)+ +|-mm 0\S* 1(\.0*)? +)+"
)
"""Options of a texture in MTL that leave it where it is; with others, such as a scale, its line names no file."""

ZERO = re.compile(rb"(?m)^f[ \t](.*[ \t])?0(/|\s|$)")
"""A face of OBJ with the vertex 0; they are counted from 1, or backwards from -1."""
DIFFUSE, AMBIENT = (re.compile(rb"(?im)^[ \t]*map_K%c\b" % letter) for letter in b"da")


def read_mesh(path: Path) -> Mesh:
    """Read a mesh of any format in `SUFFIXES` in the file's own frame; OBJ and glTF in metres become millimetres, with a warning.

    Raises:
        StepError: the mesh is missing, damaged, compressed or of another format, or names files outside its folder.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".ply":
        return _tell_untextured(path, read_ply(path))
    if suffix not in SUFFIXES:
        raise StepError(f"mesh {path} is of no format that is read: {', '.join(SUFFIXES)}; export it as PLY")
    require_mesh_file(path)
    transforms = _check_gltf(path) if suffix in GLTF else {}
    try:
        mesh = _tell_untextured(path, join_parts(_read_parts(path, transforms)))
    except StepError:
        raise
    except Exception as error:
        raise StepError(f"mesh {path} cannot be read as {suffix[1:].upper()} ({error}); export it again, or as PLY") from None
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    # OBJ has no unit and glTF is in metres, but both are often in millimetres.
    if suffix in (".obj", *GLTF) and diagonal < OBJECT_SIZES_M[1]:
        warn(f"mesh {path} measures {diagonal:.3g} across, which is taken for metres; a PLY is taken for millimetres")
        mesh = replace(mesh, vertices=mesh.vertices * MM_PER_M)
    return mesh


def find_mesh(stem: Path) -> Path | None:
    """The mesh of this path without its suffix, in the first of `SUFFIXES` that is there; None if there is none."""
    files = [path for path in stem.parent.glob("*") if path.stem == stem.name and path.suffix.lower() in SUFFIXES and path.is_file()]
    return min(files, key=lambda path: (SUFFIXES.index(path.suffix.lower()), path.name), default=None)


def describe_others(folder: Path) -> str:
    """What a folder holds that has not the mesh that is sought, and what to do where none is of a format that is read, in words."""
    files = sorted(path.name for path in folder.iterdir() if path.is_file()) if folder.is_dir() else []
    held = f"it holds {', '.join(files[:3])}{' and more' if len(files) > 3 else ''}" if files else "it is empty, or does not exist"
    known = any(name.lower().endswith(SUFFIXES) for name in files)
    return held if known else f"{held}; meshes that are read end in {', '.join(SUFFIXES)}: export it as PLY"


def list_mesh_files(path: Path) -> list[Path]:
    """The files of a mesh whose change changes it: itself, and its textures or material beside it."""
    if path.suffix.lower() == ".ply":
        return [path, *find_textures(path)]
    return [path, *(beside for beside in [path.with_suffix(".mtl")] if beside.is_file())]


def write_copy(source: Path, mesh: Mesh, folder: Path) -> None:
    """Write a mesh that was read, and perhaps moved, as model.ply with a texture: a PLY's only PNG or JPEG as it is, or a PNG."""
    images = find_textures(source) if source.suffix.lower() == ".ply" and mesh.is_textured else []
    mesh, kept = with_texture(mesh), len(images) == 1 and images[0].suffix.lower() in IMAGE_SUFFIXES
    target = folder / f"model{images[0].suffix.lower() if kept else '.png'}"
    if kept:
        shutil.copyfile(images[0], target)
    else:
        write_image(target, mesh.texture_image)
    write_ply(folder / "model.ply", mesh, target.name)


def _tell_untextured(path: Path, mesh: Mesh) -> Mesh:
    if mesh.uv is None and path.suffix.lower() == ".ply" and (textures := find_textures(path)):
        warn(
            f"mesh {path} names the texture {textures[0].name}, but has no texture coordinates, and is used without it: no two properties"
            " such as texture_u and texture_v at vertices, and no list texcoord at faces; unwrap it again"
        )
    if mesh.uv is not None and not mesh.is_colored:
        how = "its header needs a line such as comment TextureFile NAME.png"
        if path.suffix.lower() != ".ply":
            how = "its lines mtllib and usemtl must name a material that has an image"
        warn(f"mesh {path} has texture coordinates, but no image for them, and is used without colour; {how}")
    return mesh


def _read_parts(path: Path, transforms: Mapping[str | None, Mapping[str, Any]]) -> list[SurfacePart]:
    """The parts of all materials, placed in the scene. Raises StepError where there is no face, or a file cannot be used."""
    import trimesh
    from trimesh.exchange.gltf.extensions import register_handler

    register_handler("KHR_materials_pbrSpecularGlossiness", scope="material")(_take_diffuse)
    files = _FolderFiles(path)
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # what matters of its complaints is raised here
    kind, content = path.suffix[1:].lower(), path.read_bytes().removeprefix(codecs.BOM_UTF8)
    if kind == "obj" and ZERO.search(content):
        raise StepError(f"mesh {path} has a face of vertex 0, but OBJ counts from 1; export it again, or as PLY")
    content = cut_obj(scale_colors(content)) if kind == "obj" else content
    last = content.split(b"#")[0].rstrip().rpartition(b"\n")[2].split() if kind == "off" else []
    if content[:4] in (b"COFF", b"CNOF") or (last and last[0].isdigit() and len(last) > int(last[0]) + 1):
        warn(f"mesh {path} has colours, which are not read of OFF, and is used without them; export it as PLY")
    with any_size():
        scene = trimesh.load_scene(io.BytesIO(content), file_type=kind, resolver=files, process=False, group_material=True)
    if files.refused:
        raise files.refused[0]
    parts = [_to_part(one, transforms) for one in scene.dump() if isinstance(one, trimesh.Trimesh) and len(one.faces)]
    if not parts:
        raise StepError(
            f"mesh {path} has no faces{', or is cut off' if kind == 'stl' else ''}; a surface is needed: export it again, or make a"
            " surface of its points"
        )
    if not all(np.isfinite(part.surface.vertices).all() for part in parts):
        raise StepError(f"mesh {path} is damaged: it has vertices that are not finite; export it again")
    return parts


def _take_diffuse(context: Mapping[str, Any]) -> dict[str, Any]:
    """The diffuse colours of a material by an older extension; trimesh's own conversion takes those of a mirror, where it says no more."""
    return {
        base: context["data"].get(name) for base, name in (("baseColorTexture", "diffuseTexture"), ("baseColorFactor", "diffuseFactor"))
    }


class _FolderFiles(Mapping):
    """What a mesh names, for trimesh; nothing outside the mesh's folder."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.refused: list[StepError] = []

    def __iter__(self) -> Iterator[str]:
        return (one.name for one in self.path.parent.iterdir())

    def __len__(self) -> int:
        return len(list(self.path.parent.iterdir()))

    def __getitem__(self, name: str) -> bytes:
        """The content of a file. Notes an error, because trimesh ignores it, where it may not be read or is not there."""
        from urllib.parse import unquote

        try:
            text = TEXTURE_OPTIONS.sub("", str(name).strip()).strip("\"'")
            found = find_beside(self.path, text, "the file")
            if not found.is_file() and text.lower().endswith(".mtl") and " " in text:  # mtllib takes several
                return b"\n".join(self[one] for one in text.split())
            if not found.is_file() and self.path.suffix.lower() in GLTF:
                found = find_beside(self.path, unquote(text), "the file")
            if not found.is_file() and text.startswith("-"):
                raise StepError(
                    f"the material of mesh {self.path} changes its texture by options, which are not read: {text}; apply them to the"
                    " texture and its coordinates, or remove them, and leave the image's name alone"
                )
            if not found.is_file():
                raise StepError(f"mesh {self.path} names {text}, but {found} does not exist; put it there, or remove that line")
            content = found.read_bytes().removeprefix(codecs.BOM_UTF8)
            if found.suffix.lower() == ".mtl":
                # A texture of ambient light alone is the only one; of both, that of diffuse light is used.
                parts = re.split(rb"(?im)^(?=\s*newmtl\b)", content)
                return b"".join(part if DIFFUSE.search(part) else AMBIENT.sub(b"map_Kd", part) for part in parts)
            if found.suffix.lower() != ".bin":
                read_texture(self.path, found, content)  # where it cannot be read, trimesh would go on without it
        except StepError as error:
            self.refused.append(error)
            raise
        return content


def _to_part(loaded: Any, transforms: Mapping[str | None, Mapping[str, Any]]) -> SurfacePart:
    """A trimesh with its texture, or with the colours of its material, vertices or faces."""
    from trimesh.visual.material import SimpleMaterial

    surface = Mesh(np.asarray(loaded.vertices, float), np.asarray(loaded.faces, np.int64))
    visual = loaded.visual
    if visual.kind == "face":
        return SurfacePart(surface, face_colors=np.asarray(visual.face_colors)[:, :3])
    if visual.kind == "vertex":
        return SurfacePart(replace(surface, colors=np.asarray(visual.vertex_colors)[:, :3]))
    if visual.kind != "texture":
        return SurfacePart(surface)
    material = visual.material
    if isinstance(material, SimpleMaterial) and material.image is not None and not material.image.format:
        # What trimesh makes up for faces whose material is not named, or not there.
        return SurfacePart(replace(surface, uv=np.asarray(visual.uv, float)[:, :2]))
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    factor = next((found for name in ("baseColorFactor", "diffuse") if (found := getattr(material, name, None)) is not None), None)
    tint = np.ones(3) if factor is None else np.asarray(factor, float)[:3] / (255.0 if np.asarray(factor).dtype.kind in "iu" else 1.0)
    if image is None and (glow := getattr(material, "emissiveTexture", None)) is not None:  # there is no other colour
        image, tint = glow, np.ones(3)
    if image is not None and visual.uv is not None:
        texture = to_rgb(image)
        # The diffuse colour of MTL is often left black beside a texture; glTF's factor multiplies it.
        if hasattr(material, "baseColorTexture") and (tint < 1).any():
            texture = np.rint(texture * tint).astype(np.uint8)
        uv = _transform(np.asarray(visual.uv, float)[:, :2], transforms.get(material.name, {}))
        return SurfacePart(replace(surface, uv=uv, texture=texture))
    colors = visual.vertex_attributes.get("color") if hasattr(visual, "vertex_attributes") else None
    if colors is None:
        colors = np.tile(np.rint(255 * tint), (len(surface.vertices), 1))
    return SurfacePart(replace(surface, colors=np.asarray(colors)[:, :3].astype(np.uint8)))


def _transform(uv: np.ndarray, transform: Mapping[str, Any]) -> np.ndarray:
    """(V, 2) texture coordinates after glTF's KHR_texture_transform, for which v points down: scaled, turned as the image shows, moved."""
    turn = transform.get("rotation", 0.0)
    moved = np.stack([uv[:, 0], 1 - uv[:, 1]], 1) * transform.get("scale", (1, 1))
    moved = moved @ [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]] + transform.get("offset", (0, 0))
    return np.stack([moved[:, 0], 1 - moved[:, 1]], 1)


def _check_gltf(path: Path) -> dict[str | None, dict[str, Any]]:
    """How each material's texture is transformed, by its name. Raises StepError where an extension is needed that is not read here."""
    content = path.read_bytes()
    if content[:4] == b"glTF":
        content = content[20 : 20 + int.from_bytes(content[12:16], "little")]
    try:
        facts = json.loads(content)
        required, used = (facts.get(key, []) for key in ("extensionsRequired", "extensionsUsed"))
        sources = [texture.get("source") for texture in facts.get("textures", [])]
        looks = [(one.get("name"), _find_transform(one)) for one in facts.get("materials", [])]
    except (ValueError, AttributeError) as error:
        raise StepError(f"mesh {path} cannot be read as glTF ({error}); export it again, or as PLY") from None
    lacking = [name for name in required if not name.startswith((READABLE[0], TRANSFORM))]
    lacking += [name for name in used if not name.startswith(READABLE) and name not in lacking]
    if None in sources:
        lacking += [name for name in used if name.endswith("basisu") and name not in lacking]
    lacking += ["a second set of texture coordinates"] if any(look.get("texCoord") for _, look in looks) else []
    alike = len(dict(looks)) < len(looks) and any(len(look) > 1 for _, look in looks)
    lacking += [f"{TRANSFORM} with two materials of one name"] if alike else []
    if lacking:
        raise StepError(
            f"mesh {path} uses {', '.join(lacking)}, which is not read here; export it without compression, with PNG or JPEG textures and"
            " one set of texture coordinates (Blender: import it, and export glTF with these options off), or as PLY"
        )
    return dict(looks)


def _find_transform(material: Mapping[str, Any]) -> dict[str, Any]:
    """How the texture of glTF's material is transformed that `_to_part` uses, with its set of coordinates."""
    older = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness", {}).get("diffuseTexture")
    used = older or material.get("pbrMetallicRoughness", {}).get("baseColorTexture") or material.get("emissiveTexture") or {}
    return {"texCoord": used.get("texCoord")} | used.get("extensions", {}).get(TRANSFORM, {})
