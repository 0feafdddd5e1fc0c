"""MJCF of a body, for MuJoCo: one free body in the mesh's frame, with convex parts that collide and the textured mesh that is seen.

Paths are relative to the file. Mass and inertia are written out, so MuJoCo takes neither from the parts, which overlap and fill
hollows.
"""

import argparse
import xml.etree.ElementTree as xml
from pathlib import Path

from zeroshop_steps.assets.body_files import TEXTURE, VISUAL, Body, read_body, require_beside
from zeroshop_steps.assets.xml_files import add, numbers, write_xml

VISUAL_GROUP, COLLISION_GROUP = "2", "3"  # as in MuJoCo's own models: viewers show the first and hide the second
TORSION_M, ROLLING_M = 0.005, 0.0001  # MuJoCo's own coefficients of torsional and rolling friction


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--body", type=Path, required=True, help="the body's folder, beside --out")
    parser.add_argument("--out", type=Path, required=True, help="e.g. results/demo/mug/2dgs.mjcf.xml")


def run(args: argparse.Namespace) -> None:
    """Write one MJCF."""
    body = read_body(args.body)
    write_xml(args.out, describe_model(body, require_beside(body, args.out)))


def describe_model(body: Body, folder: str) -> xml.Element:
    """The `mujoco` element; `folder` is the body's, relative to the file."""
    model = xml.Element("mujoco", model=body.name)
    add(model, "compiler", meshdir=folder, texturedir=folder, angle="radian")
    assets = add(model, "asset")
    textured = (body.folder / TEXTURE).is_file()
    if textured:
        add(assets, "texture", name="surface", type="2d", file=TEXTURE)
        add(assets, "material", name="surface", texture="surface", specular="0.1", shininess="0.1")
    # No mesh has a mass here; as shells, they may have any shape and be as thin as they like.
    add(assets, "mesh", name="visual", file=VISUAL, inertia="shell")
    for part in body.parts:
        add(assets, "mesh", name=Path(part).stem, file=part, inertia="shell")
    tree = add(add(model, "worldbody"), "body", name=body.name)
    add(tree, "freejoint")
    i = body.inertia_kg_m2
    order = [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]
    add(tree, "inertial", pos=numbers(body.centre_m), mass=numbers([body.mass_kg]), fullinertia=numbers(order))
    seen = {"material": "surface"} if textured else {"rgba": "0.7 0.7 0.7 1"}
    add(tree, "geom", name="visual", type="mesh", mesh="visual", contype="0", conaffinity="0", mass="0", group=VISUAL_GROUP, **seen)
    friction = numbers([body.friction, TORSION_M, ROLLING_M])
    for part in body.parts:
        name = Path(part).stem
        add(tree, "geom", name=name, type="mesh", mesh=name, mass="0", condim="4", friction=friction, group=COLLISION_GROUP)
    return model
