"""Sharpen a model: bring the observations of each point into line by the pictures themselves, and adjust the cameras to that.

A feature is found in each image by itself, half a pixel off or so, and by more where the image is blurred. A few hundred such points
on a plain table let cameras bend as a whole. The pictures of a point tell its place far better: the patch around it in one image is
aligned with those in the others, by an affine map with the highest correlation (Evangelidis & Psarakis 2008). That keypoints are best
adjusted after the model is known is the finding of Lindenberger et al. 2021, who compare learned features instead of patches.
"""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from zeroshop_steps.geometry.imaging.images import read_image
from zeroshop_steps.register.features.sift import SiftOptions
from zeroshop_steps.register.mapping.mapper import adjust_robustly
from zeroshop_steps.register.photometry.transfer import cut_patch, span_axes
from zeroshop_steps.register.scene.image_set import REFERENCE_PX

LARGEST_PX = SiftOptions.max_side_px  # images are made so small: patches of larger ones would show nothing but noise
HALF_PX, MARGIN_PX = 10, 6
"""Half of a patch's side, and what is looked at around it in the other images: a keypoint may be off by half of that."""
OBSERVATIONS = 250  # aligned of each image, at least, if it has so many: more cost time and bring little
MOST_DOUBT_PX = 0.06
"""Deviation of a patch's place for noise of one grey level. Smooth shading, or an edge alone, has more: it fits in many places."""
LEAST_CORRELATION, MOST_SHIFT_PX, MOST_STRETCH = 0.85, 3.0, 2.0
"""A patch that resembles the reference less, lies farther off, or grows or shrinks by more than this is not aligned."""
CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 1e-3)
SMOOTHING_PX = 3  # side of the Gaussian over patches
ITERATIONS = 100  # of each round, at most
LOSS_SCALES_PX = (0.5, 0.2, 0.2)
"""Of the Cauchy loss, one round of adjustment each, per 1000 px of the images' longer side; aligned patches lie within 0.1 px."""
MOST_ERROR_PX = 1.0  # of an aligned point after that, likewise
LEAST_ALIGNED = 50  # points; fewer do not hold cameras better than what was there
WEAK = 30  # aligned observations; an image with fewer keeps the others, too

Element = tuple[int, int]
"""Of a track: the numbers of the image and of the keypoint in it."""


@dataclass(frozen=True)
class Picture:
    """An image that patches are cut from.

    Attributes:
        grey: (h, w) float32.
        scale: its pixels per pixel of the photo.
        camera: of the photo.
        pose: (3, 4) camera from world.
    """

    grey: np.ndarray
    scale: float
    camera: pycolmap.Camera
    pose: np.ndarray

    @staticmethod
    def read(path: Path, camera: pycolmap.Camera, pose: np.ndarray) -> "Picture":
        """Read an image, made smaller if it is large."""
        grey: np.ndarray = cv2.cvtColor(read_image(path), cv2.COLOR_RGB2GRAY).astype(np.float32)
        scale = min(1.0, LARGEST_PX / max(grey.shape))
        if scale < 1.0:
            grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        return Picture(grey, scale, camera, pose)

    @property
    def centre(self) -> np.ndarray:
        """(3,) the camera's, in the world."""
        return -self.pose[:, :3].T @ self.pose[:, 3]

    def pixel_size(self, point: np.ndarray) -> float:
        """What a pixel covers at the depth of a (3,) point, in the model's unit."""
        return float(self.pose[2] @ np.append(point, 1.0)) / (self.camera.mean_focal_length() * self.scale)

    def project(self, points: np.ndarray) -> np.ndarray:
        """(N, 2) pixels of (N, 3) points."""
        return self.scale * self.camera.img_from_cam(points @ self.pose[:, :3].T + self.pose[:, 3])


def refine_keypoints(model: pycolmap.Reconstruction, images: dict[str, Path]) -> tuple[pycolmap.Reconstruction, dict[str, float]]:
    """A copy of a model whose observations are aligned by the pictures and whose cameras and points are adjusted to them.

    Points that are not aligned stay, at the place that fits the new cameras best.

    Args:
        model: with a pose for each image that counts.
        images: {image name: file}, in the pixels of the model's cameras.

    Returns:
        The copy, and figures: `points` aligned, `error_before_px` and `error_px`, the mean reprojection error of these points as they
        were found and as they are now. No points: too few could be aligned, and the copy is as the model was.
    """
    pictures = {
        image_id: Picture.read(
            images[model.images[image_id].name],
            model.cameras[model.images[image_id].camera_id],
            model.images[image_id].cam_from_world().matrix(),
        )
        for image_id in sorted(model.reg_image_ids())
    }
    aligned = {}
    for point_id in choose_tracks(model, OBSERVATIONS):
        places = align_point(model, point_id, pictures)
        if len(places) > 1:
            aligned[point_id] = places
    copy = pycolmap.Reconstruction(model)
    if len(aligned) < LEAST_ALIGNED:
        return copy, {"points": 0}
    before_px = float(np.mean([model.points3D[point_id].error for point_id in aligned]))
    aligned |= _find_support_of_weak(model, aligned)
    others = {point_id: model.points3D[point_id] for point_id in model.point3D_ids() if point_id not in aligned}
    _replace_points(copy, model, aligned)
    unit_px = max(max(camera.width, camera.height) for camera in copy.cameras.values()) / REFERENCE_PX
    for scale_px in LOSS_SCALES_PX:
        adjust_robustly(copy, scale_px * unit_px, ITERATIONS)
        copy.update_point_3d_errors()
        for point_id in [point_id for point_id, point in copy.points3D.items() if point.error > MOST_ERROR_PX * unit_px]:
            others[point_id] = model.points3D[point_id]
            copy.delete_point3D(point_id)
    figures = {"points": copy.num_points3D(), "error_before_px": before_px, "error_px": copy.compute_mean_reprojection_error()}
    _add_others(copy, model, others, LOSS_SCALES_PX[0] * unit_px)
    return copy, {name: round(value, 4) for name, value in figures.items()}


def choose_tracks(model: pycolmap.Reconstruction, observations: int) -> list[int]:
    """The longest tracks that give each image at least so many observations, if it has them."""
    counts: dict[int, int] = {}
    chosen = []
    for point_id in sorted(model.point3D_ids(), key=lambda point_id: (-model.points3D[point_id].track.length(), point_id)):
        seen = {element.image_id for element in model.points3D[point_id].track.elements}
        if any(counts.get(image_id, 0) < observations for image_id in seen):
            chosen.append(point_id)
            for image_id in seen:
                counts[image_id] = counts.get(image_id, 0) + 1
    return chosen


def align_point(model: pycolmap.Reconstruction, point_id: int, pictures: dict[int, Picture]) -> dict[Element, np.ndarray]:
    """{observation: (2,) pixel of the photo} of a point, as the patch around it says; the reference keeps its place.

    The reference is seen from nearest to the mean direction of all views, which is also taken for the normal of the surface there.
    """
    point = model.points3D[point_id]
    elements: list[Element] = list({one.image_id: (one.image_id, one.point2D_idx) for one in point.track.elements}.values())
    found = {one: model.images[one[0]].points2D[one[1]].xy for one in elements}
    looks = np.array([pictures[image_id].centre - point.xyz for image_id, _ in elements])
    looks /= np.linalg.norm(looks, axis=1, keepdims=True)
    normal = looks.sum(0) / np.linalg.norm(looks.sum(0))
    reference = elements[int(np.argmax(looks @ normal))]
    picture = pictures[reference[0]]
    plane = picture.pixel_size(point.xyz) * HALF_PX * span_axes(normal[None], picture.pose[0, :3])[0]
    patches = {}
    for one in elements:
        view = pictures[one[0]]
        middle, *ends = view.project(point.xyz + np.concatenate([np.zeros((1, 3)), plane]))
        shape = ((np.array(ends) - middle) / HALF_PX).T
        patches[one] = view, shape, view.scale * found[one]
    template = cut_patch(picture.grey, *patches[reference][1:], HALF_PX)
    if estimate_doubt_px(template) > MOST_DOUBT_PX:
        return {}
    places = {reference: found[reference]}
    for one, (view, shape, middle) in patches.items():
        if one != reference and (shift := align_patch(template, cut_patch(view.grey, shape, middle, HALF_PX + MARGIN_PX))) is not None:
            places[one] = found[one] + shape @ shift / view.scale
    return places


def estimate_doubt_px(patch: np.ndarray) -> float:
    """Standard deviation of the place at which an affine alignment puts a patch, in its worst direction, for noise of one grey level.

    Place, shape, brightness and contrast are estimated together, so that the inverse of their normal matrix gives it.
    """
    smooth = cv2.GaussianBlur(patch, (SMOOTHING_PX, SMOOTHING_PX), 0)
    down, right = np.gradient(smooth)
    y, x = np.mgrid[-1 : 1 : len(patch) * 1j, -1 : 1 : len(patch) * 1j]
    effects = np.stack([right, down, right * x, right * y, down * x, down * y, np.ones_like(smooth), smooth], -1).reshape(-1, 8)
    normal_matrix = effects.T @ effects
    if np.linalg.cond(normal_matrix) > 1e12:
        return float("inf")
    return float(np.sqrt(np.linalg.eigvalsh(np.linalg.inv(normal_matrix)[:2, :2])[-1]))


def align_patch(template: np.ndarray, around: np.ndarray) -> np.ndarray | None:
    """(2,) by how much the middle of a patch lies off the middle of a larger one, in pixels; None if it is not found there."""
    offset = (len(around) - len(template)) / 2
    warp: np.ndarray = np.array([[1, 0, offset], [0, 1, offset]], np.float32)
    everywhere = np.full(around.shape, 255, np.uint8)
    try:
        correlation, warp = cv2.findTransformECC(template, around, warp, cv2.MOTION_AFFINE, CRITERIA, everywhere, SMOOTHING_PX)
    except cv2.error:  # it does not converge
        return None
    half = (len(template) - 1) / 2
    shift = warp @ [half, half, 1.0] - half - offset
    stretch = np.linalg.det(warp[:, :2])
    sure = correlation >= LEAST_CORRELATION and np.hypot(*shift) <= MOST_SHIFT_PX and 1 / MOST_STRETCH < stretch < MOST_STRETCH
    return shift if sure else None


def _find_support_of_weak(
    model: pycolmap.Reconstruction, aligned: dict[int, dict[Element, np.ndarray]]
) -> dict[int, dict[Element, np.ndarray]]:
    """All other points of the images that few aligned points hold, at the pixels at which they were found."""
    counts = Counter(image_id for places in aligned.values() for image_id, _ in places)
    support = {}
    for point_id in sorted(set(model.point3D_ids()) - set(aligned)):
        elements = [(one.image_id, one.point2D_idx) for one in model.points3D[point_id].track.elements]
        if any(counts[image_id] < WEAK for image_id, _ in elements):
            support[point_id] = {one: model.images[one[0]].points2D[one[1]].xy for one in elements}
    return support


def _replace_points(
    refined: pycolmap.Reconstruction, model: pycolmap.Reconstruction, aligned: dict[int, dict[Element, np.ndarray]]
) -> None:
    """Leave the aligned points alone in a copy of the model, at their new pixels."""
    for point_id in list(refined.point3D_ids()):
        refined.delete_point3D(point_id)
    for point_id, places in aligned.items():
        for (image_id, index), pixel in places.items():
            refined.images[image_id].points2D[index].xy = pixel
        _add_point(refined, point_id, model.points3D[point_id], list(places))


def _add_point(model: pycolmap.Reconstruction, point_id: int, point: pycolmap.Point3D, elements: list[Element]) -> None:
    track = pycolmap.Track()
    for element in elements:
        track.add_element(*element)
    model.add_point3D_with_id(point_id, pycolmap.Point3D(xyz=point.xyz, color=point.color, error=point.error, track=track))
    for image_id, index in elements:
        model.images[image_id].set_point3D_for_point2D(index, point_id)


def _add_others(
    refined: pycolmap.Reconstruction, model: pycolmap.Reconstruction, others: dict[int, pycolmap.Point3D], scale_px: float
) -> None:
    """Add the points that were not aligned, with the pixels at which they were found, where they fit the new cameras best."""
    for point_id, point in others.items():
        elements = [(one.image_id, one.point2D_idx) for one in point.track.elements]
        for image_id, index in elements:
            refined.images[image_id].points2D[index].xy = model.images[image_id].points2D[index].xy
        _add_point(refined, point_id, point, elements)
    adjust_robustly(refined, scale_px, ITERATIONS, cameras=False)
    refined.update_point_3d_errors()
