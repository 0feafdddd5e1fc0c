"""Clean the raw surface: remove floaters, repair, smooth lightly, simplify.

Floaters are parts that no camera sees, that lie outside the masks, or that are much smaller than the largest part. The largest
part is always kept. Where there are no cameras, only small parts are floaters.
"""

import argparse
from typing import TYPE_CHECKING

import cv2
import numpy as np

from zeroshop_steps.geometry.alignment.robust_estimates import AGREEING_VIEWS
from zeroshop_steps.geometry.cameras.registered_views import View, find_possible
from zeroshop_steps.geometry.cameras.transforms import shrink_camera
from zeroshop_steps.geometry.meshes.mesh_repair import drop_repeated_faces, find_triangles, label_parts
from zeroshop_steps.geometry.meshes.meshlab import from_meshlab, smooth_taubin, to_meshlab
from zeroshop_steps.geometry.meshes.surface_fields import weld
from zeroshop_steps.geometry.meshes.triangle_meshes import MIN_FACES, Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.runtime.errors import StepError

if TYPE_CHECKING:
    import pymeshlab

RENDER_PX = 480  # longer side of the renders that tell what is seen; smaller ones would miss thin parts
MASK_MARGIN_PX = 3.0  # a vertex this far outside a mask is outside: borders of masks are about this uncertain
MASK_MARGIN_EDGES = 1.0  # or this far, in edges of the raw mesh, which is no finer: one of small images would lose a ring below each rim
DECIMATION_QUALITY = 0.3  # MeshLab's threshold against slivers, its default; given since it would else keep that of its last call
BORDER_WEIGHT = 2.0  # edges of open borders count twice in the decimation, so that borders keep their shape


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of cleaning."""
    parser.add_argument("--max-faces", type=int, default=45000, help="the mesh is simplified to so many (default: %(default)s)")
    parser.add_argument(
        "--min-part", type=float, default=0.05, help="smallest part that is kept, as a share of the largest (default: %(default)s)"
    )
    parser.add_argument(
        "--smooth",
        type=int,
        default=30,
        help="steps of Taubin smoothing, which does not shrink; 0 for none (default: %(default)s)",
    )
    parser.add_argument("--max-hole-edges", type=int, default=30, help="holes with at most so many edges are closed (default: %(default)s)")


def check_options(args: argparse.Namespace) -> None:
    """Raise StepError for options of cleaning that are out of range."""
    if args.max_faces < MIN_FACES:
        raise StepError(f"--max-faces is {args.max_faces}; at least {MIN_FACES} are needed for a surface")
    if not 0.0 <= args.min_part <= 1.0:
        raise StepError(f"--min-part is {args.min_part}; it is a share between 0 and 1")


def clean_mesh(
    raw: Mesh, views: list[View], max_faces: int = 45000, min_part: float = 0.05, smooth: int = 30, max_hole_edges: int = 30
) -> tuple[Mesh, dict[str, int]]:
    """Clean a raw mesh, as the module describes.

    Returns:
        mesh: the cleaned mesh, oriented towards the cameras; without views, as it was.
        dropped: how many parts were removed, by reason.
    """
    mesh = _weld(raw)
    mesh = _trim_to_masks(mesh, views)
    mesh, dropped = drop_floaters(mesh, views, min_part)
    worker = to_meshlab(mesh)
    worker.meshing_repair_non_manifold_edges(method="Remove Faces")
    worker.meshing_repair_non_manifold_vertices(vertdispratio=0.0)
    if max_hole_edges > 0:
        worker.meshing_close_holes(maxholesize=max_hole_edges, selfintersection=False, newfaceselected=False)
    worker.set_selection_none()  # otherwise the filters below change only the selected faces
    smooth_taubin(worker, smooth)
    _decimate(worker, max_faces, closed=False)
    worker.meshing_remove_null_faces()
    worker.meshing_remove_unreferenced_vertices()
    mesh = from_meshlab(worker)
    if len(mesh.faces) == 0:
        raise StepError("nothing is left of the mesh after repair: it has no connected surface; add photos or check the masks")
    return _turn_towards_cameras(mesh, views), dropped


def simplify(mesh: Mesh, max_faces: int, smooth: int) -> Mesh:
    """A closed mesh smoothed by Taubin steps and decimated to at most `max_faces`; it stays closed."""
    worker = to_meshlab(mesh)
    smooth_taubin(worker, smooth)
    _decimate(worker, max_faces, closed=True)
    return from_meshlab(worker)


def _decimate(worker: "pymeshlab.MeshSet", max_faces: int, closed: bool) -> None:
    if worker.current_mesh().face_number() > max_faces:
        worker.meshing_decimation_quadric_edge_collapse(
            targetfacenum=max_faces,
            qualitythr=DECIMATION_QUALITY,  # every option is given: MeshLab would take missing ones from its last call
            preserveboundary=True,
            preservetopology=closed,
            boundaryweight=BORDER_WEIGHT,
            preservenormal=True,
            planarquadric=True,
            autoclean=True,
        )


def drop_floaters(mesh: Mesh, views: list[View], min_part: float) -> tuple[Mesh, dict[str, int]]:
    """Keep the largest part by area, and every part that is seen and has at least `min_part` of its area."""
    labels = label_parts(mesh.faces)
    areas = mesh.face_areas()
    part_areas = np.bincount(labels, areas)
    largest = int(part_areas.argmax())
    small = part_areas < min_part * part_areas[largest]
    unseen = np.ones(len(part_areas), bool)
    if views and (~small).sum() > 1:
        unseen[np.unique(labels[_find_seen_faces(mesh, views)])] = False
    else:
        unseen[:] = False
    drop = small | unseen
    drop[largest] = False
    dropped = {"small": int((small & drop).sum()), "unseen": int((unseen & ~small & drop).sum())}
    return Mesh(mesh.vertices, mesh.faces[~drop[labels]]).without_loose_vertices(), dropped


def _weld(mesh: Mesh) -> Mesh:
    joined, _ = weld(mesh)
    faces = drop_repeated_faces(joined.faces[find_triangles(joined.faces)])
    if len(faces) == 0:
        raise StepError("the mesh has no face with an area; reconstruct again")
    return Mesh(joined.vertices, faces)


def _trim_to_masks(mesh: Mesh, views: list[View]) -> Mesh:
    """Remove faces with a corner outside the masks of at least two photos; the object is inside all of them."""
    outside = np.zeros(len(mesh.vertices), int)
    edges = np.linalg.norm(mesh.vertices[mesh.faces] - mesh.vertices[np.roll(mesh.faces, 1, axis=1)], axis=2)
    margin = MASK_MARGIN_EDGES * float(np.median(edges))
    for view in views:
        mask = find_possible(view.mask(), view.confidence())
        if mask.all() or not mask.any():
            continue
        distance = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
        rows, columns, depth, seen = view.camera.find_pixels(mesh.vertices)
        margin_px = np.maximum(MASK_MARGIN_PX, margin * view.camera.intrinsics[0, 0] / depth[seen])
        outside[seen] += distance[rows[seen], columns[seen]] > margin_px
    keep = (outside[mesh.faces] < AGREEING_VIEWS).all(1)
    if not keep.any():
        raise StepError("the mesh lies outside the masks: mesh and cameras do not belong together, or the masks show another object")
    return Mesh(mesh.vertices, mesh.faces[keep]).without_loose_vertices()


def _find_seen_faces(mesh: Mesh, views: list[View]) -> np.ndarray:
    renderer = MeshRenderer(mesh)
    seen = [hits.face[hits.mask] for hits in (renderer.cast_rays(shrink_camera(view.camera, RENDER_PX)) for view in views)]
    return np.unique(np.concatenate(seen))


def _turn_towards_cameras(mesh: Mesh, views: list[View]) -> Mesh:
    """Flip all faces if the cameras mostly see the back of the surface."""
    renderer = MeshRenderer(mesh)
    normals, balance = mesh.face_normals(), 0
    for view in views:
        hits = renderer.cast_rays(shrink_camera(view.camera, RENDER_PX))
        face = hits.face[hits.mask]
        balance += np.sign(np.einsum("ij,ij->i", normals[face], view.camera.centre_in_world - mesh.vertices[mesh.faces[face, 0]])).sum()
    return mesh if balance >= 0 else Mesh(mesh.vertices, mesh.faces[:, ::-1].copy())
