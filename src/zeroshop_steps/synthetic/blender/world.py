"""Build a described scene in Blender: meshes, materials, area lights, sky and camera. Blender's unit is the metre."""

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

M_A_MM = 1e-3  # Blender's unit is the metre
WATT_A_RADIANCE = np.pi  # measured on a white plane: a lamp of P watts and area A has the radiance P / (pi A)
DIFFUSE_BOUNCES, GLOSSY_BOUNCES, MAX_BOUNCES = 3, 2, 4  # of a light path


def metres(world_from_thing: list) -> np.ndarray:
    """(4, 4) rigid transform whose translation is in mm, with it in m."""
    transform = np.array(world_from_thing, float)
    transform[:3, 3] *= M_A_MM
    return transform


def add_thing(bproc: ModuleType, folder: Path, name: str, thing: dict) -> Any:
    """A textured mesh from `NAME.npz` and `NAME.png`; returns BlenderProc's object."""
    import bpy

    with np.load(folder / f"{name}.npz") as arrays:
        vertices, faces, normals, uv = (arrays[key] for key in ("vertices_mm", "faces", "corner_normals", "corner_uv"))
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", (vertices * M_A_MM).astype(np.float32).ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", faces.astype(np.int32).ravel())
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    mesh.polygons.foreach_set("use_smooth", np.ones(len(faces), bool))
    mesh.uv_layers.new(name="uv").data.foreach_set("uv", uv.astype(np.float32).ravel())
    mesh.update(calc_edges=True)
    mesh.normals_split_custom_set(normals.reshape(-1, 3).tolist())
    added = bproc.object.create_from_blender_mesh(mesh, name)
    added.set_local2world_mat(metres(thing["world_from_thing"]))
    added.replace_materials(_material(bproc, folder / f"{name}.png", name, thing))
    return added


def _material(bproc: ModuleType, texture: Path, name: str, thing: dict) -> Any:
    """A dielectric (Principled BSDF, refractive index 1.5) with the texture as its diffuse colour."""
    import bpy

    material = bproc.material.create(name)
    material.set_principled_shader_value("Base Color", bpy.data.images.load(str(texture)))
    material.get_the_one_node_with_type("ShaderNodeTexImage").extension = "REPEAT" if thing["wrap"] else "EXTEND"
    material.set_principled_shader_value("Metallic", 0.0)
    material.set_principled_shader_value("IOR", 1.5)
    material.set_principled_shader_value("Roughness", thing["roughness"])
    return material


def add_lights(bproc: ModuleType, scene: dict) -> None:
    """Square area lights, unseen by the camera, and a sky of even radiance, which the camera sees as the background."""
    side_m = 2.0 * scene["light_half_side_mm"] * M_A_MM
    for index, light in enumerate(scene["lights"]):
        lamp = bproc.types.Light("AREA", f"light {index}")
        lamp.blender_obj.data.shape, lamp.blender_obj.data.size = "SQUARE", side_m
        lamp.blender_obj.visible_camera = False
        across, _, towards = np.array(light["axes"])
        world_from_lamp = np.eye(4)
        world_from_lamp[:3, :3] = np.stack([across, np.cross(-towards, across), -towards], 1)  # it shines along -z
        world_from_lamp[:3, 3] = np.array(light["centre_mm"]) * M_A_MM
        lamp.set_local2world_mat(world_from_lamp)
        lamp.set_energy(WATT_A_RADIANCE * light["radiance"] * side_m**2)
    bproc.renderer.set_world_background([scene["sky"]] * 3)
    _show_background(*scene["background"])


def _show_background(level: float, slope: float) -> None:
    """Let rays of the camera that hit nothing see the grey `level + slope * (z of the ray's direction)` in place of the sky."""
    import bpy

    tree = bpy.context.scene.world.node_tree
    direction, split, grey, background, path, mix = (
        tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexCoord", "SeparateXYZ", "Math", "Background", "LightPath", "MixShader")
    )
    grey.operation = "MULTIPLY_ADD"
    grey.inputs[1].default_value, grey.inputs[2].default_value = slope, level
    output = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputWorld")
    for source, target in (
        (direction.outputs["Generated"], split.inputs[0]),
        (split.outputs["Z"], grey.inputs[0]),
        (grey.outputs[0], background.inputs["Color"]),
        (path.outputs["Is Camera Ray"], mix.inputs["Fac"]),
        (tree.nodes["Background"].outputs[0], mix.inputs[1]),
        (background.outputs[0], mix.inputs[2]),
        (mix.outputs[0], output.inputs["Surface"]),
    ):
        tree.links.new(source, target)


def add_cameras(bproc: ModuleType, scene: dict) -> None:
    """One frame a camera. OpenCV axes and pixel centres at halves become Blender's."""
    nearest_m = scene["nearest_mm"] * M_A_MM
    # BlenderProc counts pixels from their centres.
    intrinsics = np.array(scene["intrinsics"]) - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
    bproc.camera.set_intrinsics_from_K_matrix(intrinsics, scene["width_px"], scene["height_px"], nearest_m, 1e4 * nearest_m)
    for frame, world_from_camera in enumerate(scene["world_from_cameras"]):
        pose = bproc.math.change_source_coordinate_frame_of_transformation_matrix(metres(world_from_camera), ["X", "-Y", "-Z"])
        bproc.camera.add_camera_pose(pose, frame)


def build(bproc: ModuleType, folder: Path, scene: dict) -> None:
    """All of a scene; thing number n gets the pass index n + 1."""
    for index, thing in enumerate(scene["things"]):
        add_thing(bproc, folder, f"thing_{index}", thing)
    add_lights(bproc, scene)
    add_cameras(bproc, scene)
