"""URDF of a body: one link in the mesh's frame, for ROS, Gazebo, Drake, PyBullet, Pinocchio and MuJoCo.

Paths are relative to the file. Friction is not part of URDF; it is given as PyBullet's and Gazebo's extensions, and MuJoCo's
extension tells it where the meshes are.
"""

import argparse
import xml.etree.ElementTree as xml
from pathlib import Path

from zeroshop_steps.assets.body_files import VISUAL, Body, read_body, require_beside
from zeroshop_steps.assets.xml_files import add, numbers, write_xml

LINK = "base_link"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--body", type=Path, required=True, help="the body's folder, beside --out")
    parser.add_argument("--package", help="a ROS package that the results lie in; paths then are package://PACKAGE/... (for RViz)")
    parser.add_argument("--out", type=Path, required=True, help="e.g. results/demo/mug/2dgs.urdf")


def run(args: argparse.Namespace) -> None:
    """Write one URDF."""
    body = read_body(args.body)
    folder = require_beside(body, args.out)
    write_xml(args.out, describe_robot(body, f"package://{args.package}/{folder}" if args.package else folder, folder))


def describe_robot(body: Body, prefix: str, folder: str) -> xml.Element:
    """The `robot` element.

    Args:
        prefix: before the names of the meshes.
        folder: of the body, relative to the file, for MuJoCo, which does not know packages.
    """
    robot = xml.Element("robot", name=body.name)
    link = add(robot, "link", name=LINK)
    inertial = add(link, "inertial")
    add(inertial, "origin", xyz=numbers(body.centre_m), rpy="0 0 0")
    add(inertial, "mass", value=numbers([body.mass_kg]))
    inertia = body.inertia_kg_m2
    places = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    add(inertial, "inertia", **{name: numbers([inertia[place]]) for name, place in places.items()})
    for kind, name in [("visual", VISUAL), *(("collision", part) for part in body.parts)]:
        shape = add(link, kind, name=Path(name).stem)
        add(shape, "origin", xyz="0 0 0", rpy="0 0 0")
        add(add(shape, "geometry"), "mesh", filename=f"{prefix}/{name}")
    add(add(link, "contact"), "lateral_friction", value=numbers([body.friction]))
    gazebo = add(robot, "gazebo", reference=LINK)
    for name in ("mu1", "mu2"):
        add(gazebo, name).text = numbers([body.friction])
    add(add(robot, "mujoco"), "compiler", meshdir=folder, strippath="true", balanceinertia="false", discardvisual="false")
    return robot
