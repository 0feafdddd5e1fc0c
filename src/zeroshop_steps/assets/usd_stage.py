"""The prims of a body's USD stage."""

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from zeroshop_steps.assets.body_files import TEXTURE, VISUAL, Body
from zeroshop_steps.runtime.errors import StepError


def load_pxr() -> Any:
    """The modules of usd-core. Raises StepError where it is missing."""
    try:
        from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdPhysics, UsdSemantics, UsdShade, UsdUtils, Vt
    except ImportError:
        raise StepError("usd-core is not installed, which writes USD; run: pip install 'zeroshop[robot]', or: make") from None
    modules = (Gf, Kind, Sdf, Usd, UsdGeom, UsdPhysics, UsdSemantics, UsdShade, UsdUtils, Vt)
    return SimpleNamespace(**{module.__name__.rpartition(".")[2]: module for module in modules})


def write_stage(pxr: Any, body: Body, path: Path, texture: str, date: str | None = None) -> None:
    """Write a stage to `path`, text or binary by its suffix.

    Args:
        texture: the path that its material names.
        date: of creation, for the metadata.
    """
    stage = pxr.Usd.Stage.CreateInMemory()
    pxr.UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    pxr.UsdGeom.SetStageUpAxis(stage, pxr.UsdGeom.Tokens.z)
    pxr.UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    root = pxr.UsdGeom.Xform.Define(stage, f"/{prim_name(body.name)}")
    stage.SetDefaultPrim(root.GetPrim())
    pxr.Usd.ModelAPI(root).SetKind(pxr.Kind.Tokens.component)
    pxr.UsdSemantics.LabelsAPI.Apply(root.GetPrim(), "class").CreateLabelsAttr([body.name])
    metadata = _describe(body) | ({"usd_date_generated": date} if date else {})
    stage.GetRootLayer().customLayerData = {**metadata, "SimReady_Metadata": metadata}
    _add_physics(pxr, root.GetPrim(), body)
    place = str(root.GetPath())
    pxr.UsdGeom.Scope.Define(stage, f"{place}/Looks")
    surface = _add_surface(pxr, stage, f"{place}/Looks/surface", texture if (body.folder / TEXTURE).is_file() else None)
    rubbing = pxr.UsdShade.Material.Define(stage, f"{place}/Looks/friction")
    friction = pxr.UsdPhysics.MaterialAPI.Apply(rubbing.GetPrim())
    friction.CreateStaticFrictionAttr(body.friction)
    friction.CreateDynamicFrictionAttr(body.friction)
    friction.CreateRestitutionAttr(0.0)
    pxr.UsdGeom.Xform.Define(stage, f"{place}/Geometry")
    visual = _add_mesh(pxr, stage, f"{place}/Geometry/visual", body.folder / VISUAL)
    pxr.UsdShade.MaterialBindingAPI.Apply(visual.GetPrim()).Bind(surface)
    pxr.UsdGeom.Xform.Define(stage, f"{place}/Geometry/collision")
    for part in body.parts:
        shape = _add_mesh(pxr, stage, f"{place}/Geometry/collision/{prim_name(Path(part).stem)}", body.folder / part)
        shape.CreatePurposeAttr(pxr.UsdGeom.Tokens.guide)
        pxr.UsdPhysics.CollisionAPI.Apply(shape.GetPrim())
        pxr.UsdPhysics.MeshCollisionAPI.Apply(shape.GetPrim()).CreateApproximationAttr(pxr.UsdPhysics.Tokens.convexHull)
        bound = pxr.UsdShade.MaterialBindingAPI.Apply(shape.GetPrim())
        bound.Bind(rubbing, pxr.UsdShade.Tokens.weakerThanDescendants, "physics")
    stage.GetRootLayer().Export(str(path))


def prim_name(name: str) -> str:
    """A name that USD takes for a prim: letters, digits and underscores, not beginning with a digit."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return plain if re.match(r"[A-Za-z_]", plain) else f"_{plain}"


def principal_axes(inertia: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(3,) moments of inertia in increasing order, and the (3, 3) rotation whose columns are their axes."""
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return moments, axes


def _describe(body: Body) -> dict[str, Any]:
    """What catalogues of assets ask for."""
    facts = ("mass_source", "mass_factor", "scale", "scale_source", "frame")
    return {
        "asset_name": body.name,
        "asset_type": "prop",
        "source_file": VISUAL,
        "rigid_body_count": 1,
        "mass": body.mass_kg,
        **{name: body.facts[name] for name in facts},
        **({"generated": True} if body.facts.get("generated") else {}),
    }


def _add_physics(pxr: Any, prim: Any, body: Body) -> None:
    from scipy.spatial.transform import Rotation

    pxr.UsdPhysics.RigidBodyAPI.Apply(prim)
    mass = pxr.UsdPhysics.MassAPI.Apply(prim)
    mass.CreateMassAttr(body.mass_kg)
    mass.CreateCenterOfMassAttr(pxr.Gf.Vec3f(*body.centre_m.tolist()))
    moments, axes = principal_axes(body.inertia_kg_m2)
    x, y, z, w = Rotation.from_matrix(axes).as_quat(canonical=True).tolist()
    mass.CreateDiagonalInertiaAttr(pxr.Gf.Vec3f(*moments.tolist()))
    mass.CreatePrincipalAxesAttr(pxr.Gf.Quatf(w, x, y, z))


def _add_surface(pxr: Any, stage: Any, place: str, texture: str | None) -> Any:
    """The material that is seen: matt, with the texture's colours."""
    types = pxr.Sdf.ValueTypeNames
    material = pxr.UsdShade.Material.Define(stage, place)
    shader = pxr.UsdShade.Shader.Define(stage, f"{place}/shader")
    shader.CreateIdAttr("UsdPreviewSurface")
    # As in the GLB: nearly matt, since the texture already shows the light of the photos.
    shader.CreateInput("roughness", types.Float).Set(0.9)
    shader.CreateInput("metallic", types.Float).Set(0.0)
    material.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", types.Token))
    color = shader.CreateInput("diffuseColor", types.Color3f)
    if texture is None:
        color.Set(pxr.Gf.Vec3f(0.7, 0.7, 0.7))
        return material
    reader = pxr.UsdShade.Shader.Define(stage, f"{place}/coordinates")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", types.String).Set("st")
    image = pxr.UsdShade.Shader.Define(stage, f"{place}/texture")
    image.CreateIdAttr("UsdUVTexture")
    image.CreateInput("file", types.Asset).Set(texture)
    image.CreateInput("sourceColorSpace", types.Token).Set("sRGB")
    image.CreateInput("st", types.Float2).ConnectToSource(reader.CreateOutput("result", types.Float2))
    for axis in ("wrapS", "wrapT"):
        image.CreateInput(axis, types.Token).Set("repeat")
    color.ConnectToSource(image.CreateOutput("rgb", types.Float3))
    return material


def _add_mesh(pxr: Any, stage: Any, place: str, path: Path) -> Any:
    """A mesh prim of an OBJ in the body's folder."""
    import trimesh

    loaded: Any = trimesh.load(path, process=False, maintain_order=True, force="mesh")
    vertices, faces = np.asarray(loaded.vertices, np.float32), np.asarray(loaded.faces, np.int32)
    mesh = pxr.UsdGeom.Mesh.Define(stage, place)
    array = pxr.Vt
    mesh.CreatePointsAttr(array.Vec3fArray.FromNumpy(vertices))
    mesh.CreateFaceVertexCountsAttr(array.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(array.IntArray.FromNumpy(faces.reshape(-1)))
    mesh.CreateSubdivisionSchemeAttr(pxr.UsdGeom.Tokens.none)
    mesh.CreateExtentAttr(array.Vec3fArray.FromNumpy(np.stack([vertices.min(0), vertices.max(0)])))
    mesh.CreateNormalsAttr(array.Vec3fArray.FromNumpy(np.asarray(loaded.vertex_normals, np.float32)))
    mesh.SetNormalsInterpolation(pxr.UsdGeom.Tokens.vertex)
    uv = getattr(loaded.visual, "uv", None)
    if uv is not None and len(uv) == len(vertices):
        coordinates = pxr.UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", pxr.Sdf.ValueTypeNames.TexCoord2fArray, pxr.UsdGeom.Tokens.vertex)
        coordinates.Set(array.Vec2fArray.FromNumpy(np.asarray(uv, np.float32)))
    return mesh
