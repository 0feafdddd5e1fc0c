"""Close the surface: the underside flat at the support plane, and every other hole.

The underside is closed flat (underside.py), but for what photos look through (overhang.py). A few small holes besides
are filled with triangles between the vertices of their borders, and the rest of the mesh stays as it is. Where more is open, or a strip
of ground lies around the foot, the whole surface is closed in space (watertight.py) and simplified again. A generated mesh, if there is
one, proposes all of that (generated.py). The faces that were added and that fewer than two photos see come last: neither quality nor
grade counts them.

A closed vessel whose inside is plain still has a lid, or is filled in part. It is opened where the colours of the photos tell its
inside (hollows.py).
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from zeroshop_steps.finish.clean import simplify
from zeroshop_steps.finish.closing.underside import STATES, Underside, close_underside, find_open_borders, leave_open
from zeroshop_steps.geometry.alignment.robust_estimates import AGREEING_VIEWS
from zeroshop_steps.geometry.alignment.surface_distance import count_seeing_views, measure_distances
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.meshes.mesh_repair import triangulate
from zeroshop_steps.geometry.meshes.meshlab import VOXEL_STEPS
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.surface.mvs.seeds import read_confirmed_points

if TYPE_CHECKING:
    from zeroshop_steps.finish.closing.watertight import GroundPlane

GROUND_SHARE = 0.005
"""More of the surface than this lying flat just above the support plane is ground. On rendered objects it is below 0.0002, on two
real captures with ground in their masks 0.03 to 0.06."""
SMALL_HOLES_DIAGONALS = 1.0
"""Holes whose borders are together shorter than this, in diagonals of the object, are filled one by one. Of rendered objects the
clamp has 0.6, a mug whose plain inside is torn 7.8; real captures with torn surfaces have 13."""
ADDED_DIAGONALS = 0.005
"""A face farther than this from the measured surface, in diagonals of the object, was added."""
UPRIGHT_CERTAINTY, FLOOR_DIAGONALS = 0.9, 0.005
"""Where cameras were held as upright as this (1: all agree), nothing is closed farther below the mesh than this."""
HOLLOWS = ("opened", "kept")
"""What is done with lids over plain hollows."""


@dataclass(frozen=True)
class Closing:
    """What is closed: `underside` and `holes` are closed or open, `hollows` opened or kept; a surface closed in space has `max_faces`."""

    underside: str = "closed"
    holes: str = "closed"
    hollows: str = "opened"
    max_faces: int = 45000

    @property
    def everything(self) -> bool:
        """Whether the underside and all holes are closed."""
        return self.underside == self.holes == "closed"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of closing."""
    parser.add_argument("--underside", choices=STATES, default="closed", help="close it, or leave it open (default: %(default)s)")
    parser.add_argument(
        "--holes", choices=STATES, default="closed", help="close all other holes, where the underside is closed (default: %(default)s)"
    )
    parser.add_argument(
        "--hollows",
        choices=HOLLOWS,
        default="opened",
        help="lids over plain hollows of a mesh that was closed: open them where photos tell the inside (default: %(default)s)",
    )


def close_mesh(
    mesh: Mesh, height: Mapping[str, Any], views: Sequence[View], options: Closing, stereo: Path | None = None,
    generated: Mesh | None = None,
) -> tuple[Mesh, dict[str, Any]]:  # fmt: skip
    """Close a cleaned mesh, as the module describes.

    Args:
        mesh: in the registration frame.
        height: content of height.json, which has the support plane.
        views: the registered photos.
        options: what is closed.
        stereo: seeds.npz with the depths that stereo confirmed, if there are any.
        generated: a mesh that proposes the underside and hollows, where both are closed; registration frame.

    Returns:
        the closed mesh, and the content of closed.json.
    """
    from zeroshop_steps.finish.closing.overhang import lift_underside
    from zeroshop_steps.finish.closing.watertight import GroundPlane

    plane = GroundPlane(np.array(height["up"]), height["bottom"]) if height["up_source"] == "support_plane" else None
    floor = plane or find_floor(mesh, height)
    method, ground_share = "none", plane.ground_share(mesh) if plane else 0.0
    closed, underside = leave_open(mesh)
    proposed: dict[str, Any] = {}
    if generated and options.everything:
        confirmed = read_confirmed_points(stereo, views) if stereo else np.zeros((0, 3))
        closed, underside, proposed = close_by_generated(mesh, generated, views, confirmed, floor, options.max_faces)
        method = "generated"
    elif options.underside == "closed" and plane:
        closed, underside = close_underside(mesh, plane.normal, plane.offset)
        method = "flat" if underside.faces else "none"
        if underside.faces:
            closed = lift_underside(closed, len(mesh.vertices), underside.first_face, plane.normal, list(views))
    if method != "generated" and options.everything and (not underside.watertight or ground_share > GROUND_SHARE):
        filled = None if ground_share > GROUND_SHARE else fill_small_holes(closed, underside, views)
        closed, underside = filled or close_in_space(mesh, views, floor, options.max_faces)
        method = "holes" if filled else "volume"
    hollow = None
    if options.hollows == "opened" and options.everything and method != "generated" and floor and underside.watertight:
        closed, underside, hollow = open_plain_hollow(closed, underside, views, stereo, floor.normal)
    if hollow:
        unit, per_unit = ("mm", 1000 * height["metres_per_unit"]) if height["metres_per_unit"] else ("of the registration", 1.0)
        wall, bottom = (f"{hollow[name] * per_unit:.2g}" for name in ("wall", "floor"))
        print(f"close: hollow opened: wall {wall}, floor {bottom} {unit}", file=sys.stderr)
    print(f"close: {method}, {underside.faces} unseen faces added, watertight: {underside.watertight}", file=sys.stderr)
    return closed, {
        "underside": underside.as_record(),
        "closing": {"method": method, "ground_share": round(ground_share, 5), "watertight": underside.watertight, **proposed},
        "hollow": hollow,
        "parameters": {
            "underside": options.underside,
            "holes": options.holes,
            "hollows": options.hollows,
            "unseen": "generated" if generated else "smooth",
        },
    }


def find_floor(mesh: Mesh, height: Mapping[str, Any]) -> "GroundPlane | None":
    """A plane just below the mesh where no support plane was found, but cameras were held upright: what is below it no photo tells."""
    from zeroshop_steps.finish.closing.watertight import GroundPlane

    if (height["up_uncertainty"].get("roll_certainty") or 0.0) < UPRIGHT_CERTAINTY:
        return None
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    return GroundPlane(np.array(height["up"]), height["bottom"] - FLOOR_DIAGONALS * diagonal, found=False)


def close_by_generated(
    mesh: Mesh, generated: Mesh, views: Sequence[View], confirmed: np.ndarray, plane: "GroundPlane | None", max_faces: int
) -> tuple[Mesh, Underside, dict[str, Any]]:
    """The mesh closed as a generated one proposes; what was added is last and counts as never seen, whether photos see it or not.

    Returns:
        The closed mesh, what was added to it, and the figures for the record.
    """
    from zeroshop_steps.finish.closing.generated import propose
    from zeroshop_steps.finish.closing.measured_surface import MeasuredSurface
    from zeroshop_steps.finish.closing.watertight import close_surface

    proposal = propose(mesh, views, confirmed, generated)
    closed = simplify(close_surface(proposal.measured, views, plane, proposal.shape), max_faces, VOXEL_STEPS)
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    closed = MeasuredSurface(proposal.measured).snapped(closed, ADDED_DIAGONALS * diagonal).with_normals()
    kept = measure_distances(proposal.measured, closed.vertices[closed.faces].mean(1)) <= ADDED_DIAGONALS * diagonal
    whole, underside = _with_unseen_last(closed, kept, len(find_open_borders(proposal.measured.faces)))
    return whole, underside, {"fit_diagonals": round(proposal.distance / diagonal, 5), "lids_share": round(proposal.lids, 5)}


def open_plain_hollow(
    mesh: Mesh, underside: Underside, views: Sequence[View], stereo: Path | None, up: np.ndarray
) -> tuple[Mesh, Underside, dict[str, Any] | None]:
    """The closed mesh with its plain hollow opened, where photos tell it; otherwise as it was.

    Returns:
        mesh: the faces of the hollow that a photo sees come after all others that are seen; those that none sees are last.
        underside: the record of the faces that none sees.
        hollow: its wall and floor in the unit of the mesh, the wall's growth towards the floor, how far colours deviate, and its faces;
            None if none was opened.
    """
    from zeroshop_steps.finish.closing.hollows import open_hollow
    from zeroshop_steps.finish.closing.vessel import has_room_for_mouth

    if not has_room_for_mouth(mesh, up):
        return mesh, underside, None
    opened = open_hollow(mesh, views, read_confirmed_points(stereo, views) if stereo else np.zeros((0, 3)), up)
    if opened is None:
        return mesh, underside, None
    of_hollow = opened.origin < 0
    seen = (opened.origin < underside.first_face) | (opened.origin >= underside.first_face + underside.faces)
    # One photo is enough: between surface that two see and surface that one sees, there would be a border that photos see.
    seen[of_hollow] = _is_seen(opened.mesh, opened.mesh.faces[of_hollow], views, 1)
    order = np.argsort(of_hollow, kind="stable")
    faces = int((seen & of_hollow).sum())
    whole, record = _with_unseen_last(Mesh(opened.mesh.vertices, opened.mesh.faces[order]).with_normals(), seen[order], underside.borders)
    facts: dict[str, Any] = {name: getattr(opened, name) for name in ("wall", "floor", "taper")}
    facts["deviation"] = {name: round(getattr(opened, name), 3) for name in ("before", "after", "outside")}
    facts |= {"first_face": record.first_face - faces, "faces": faces}
    return whole, record, facts


def fill_small_holes(mesh: Mesh, underside: Underside, views: Sequence[View]) -> tuple[Mesh, Underside] | None:
    """The mesh with its holes filled, where these are few and nearly flat; None otherwise.

    Args:
        mesh: as `close_underside` gives it, with the faces of the underside last.
        underside: what was closed there.
    """
    borders = find_open_borders(mesh.faces)
    length = sum(float(np.linalg.norm(np.diff(mesh.vertices[np.append(border, border[0])], axis=0), axis=1).sum()) for border in borders)
    if length > SMALL_HOLES_DIAGONALS * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))):
        return None
    patches = [triangulate(mesh.vertices[border[::-1]]) for border in borders]  # which run clockwise about the side that faces show
    if any(patch is None for patch in patches):
        return None
    added = np.concatenate([border[::-1][patch] for border, patch in zip(borders, patches, strict=True)])
    whole = Mesh(mesh.vertices, np.concatenate([mesh.faces, added])).with_normals()
    seen = np.ones(len(whole.faces), bool)
    seen[underside.first_face : underside.first_face + underside.faces] = False
    seen[len(mesh.faces) :] = _is_seen(whole, added, views)
    return _with_unseen_last(whole, seen, len(borders) + underside.borders)


def _is_seen(mesh: Mesh, faces: np.ndarray, views: Sequence[View], photos: int = AGREEING_VIEWS) -> np.ndarray:
    """(F,) bool: which of (F, 3) faces of the mesh at least so many photos see at their middle."""
    middle = mesh.vertices[faces].mean(1)
    part = Mesh(mesh.vertices, faces)
    return count_seeing_views(middle, part.face_normals(), mesh, [view.camera for view in views], None) >= photos


def _with_unseen_last(mesh: Mesh, seen: np.ndarray, closed_borders: int) -> tuple[Mesh, Underside]:
    """The mesh with its faces in another order, and the record of those that no photo sees."""
    whole = Mesh(mesh.vertices, np.concatenate([mesh.faces[seen], mesh.faces[~seen]]), mesh.normals)
    left = len(find_open_borders(whole.faces))
    return whole, Underside("open" if left else "closed", int(seen.sum()), int((~seen).sum()), closed_borders, left, not left)


def close_in_space(mesh: Mesh, views: Sequence[View], plane: "GroundPlane | None", max_faces: int) -> tuple[Mesh, Underside]:
    """The mesh with all holes closed, its added and unseen faces last, and what these are."""
    from zeroshop_steps.finish.closing.watertight import close_surface

    closed = simplify(close_surface(mesh, views, plane), max_faces, VOXEL_STEPS).with_normals()
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    added = measure_distances(mesh, closed.vertices[closed.faces].mean(1)) > ADDED_DIAGONALS * diagonal
    seen = ~added
    seen[added] = _is_seen(closed, closed.faces[added], views)
    return _with_unseen_last(closed, seen, len(find_open_borders(mesh.faces)))
