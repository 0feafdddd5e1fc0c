"""One model of all passes: their cameras in the first pass's frame, their points, and tracks of the object across them.

The cameras of a pass keep their places to each other: its ground holds them better than the object does. (Adjusting all cameras of a
bottle's passes together by all points took them from 0.23 to 0.33 mm.) Of later passes only what they see of the object is taken: their
ground is another than the object's support.
"""

from pathlib import Path

import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.pinhole import make_transform, to_rigid
from zeroshop_steps.geometry.cameras.transforms import compute_scale, transform_points
from zeroshop_steps.join.object_matches import make_bare_model
from zeroshop_steps.join.pass_images import Pass
from zeroshop_steps.register.mapping.mapper import make_mapping_options
from zeroshop_steps.register.scene.image_set import ImageSet


def move_pose(pose: pycolmap.Rigid3d, target_from_source: np.ndarray) -> pycolmap.Rigid3d:
    """camera_from_target of camera_from_source, where the target's frame is a (4, 4) similarity away; its unit is the target's."""
    scale = compute_scale(target_from_source)
    rotation = target_from_source[:3, :3] / scale
    turned = pose.rotation.matrix() @ rotation.T
    centre = transform_points(pose.inverse().translation[None], target_from_source)[0]
    return to_rigid(make_transform(turned, -turned @ centre))


def triangulate_joined(
    database: Path, passes: list[Pass], first_from_pass: list[np.ndarray], image_set: ImageSet, seed: int, output: Path
) -> pycolmap.Reconstruction:
    """The object's points in all passes, with all cameras held fixed in the first pass's frame; features are those of the database."""
    poses = {
        image.name: move_pose(image.cam_from_world(), moved)
        for one, moved in zip(passes, first_from_pass, strict=True)
        for image in one.model.images.values()
        if image.has_pose
    }
    output.mkdir(parents=True, exist_ok=True)
    mapper = make_mapping_options(len(poses), seed)
    return pycolmap.triangulate_points(make_bare_model(database, poses), database, image_set.images[0].parent, output, options=mapper)


def merge_models(joined: pycolmap.Reconstruction, first: Pass) -> pycolmap.Reconstruction:
    """The joined model with the first pass's own points, its ground among them, beside those of the object."""
    own = {image.name: image for image in first.model.images.values()}
    merged = pycolmap.Reconstruction()
    for _, camera in sorted(joined.cameras.items()):
        merged.add_camera_with_trivial_rig(camera)
    before = {}
    for image_id, image in sorted(joined.images.items()):
        points = [point.xy for point in own[image.name].points2D] if image.name in own else []
        before[image_id] = len(points)
        points += [point.xy for point in image.points2D]
        copied = pycolmap.Image(name=image.name, keypoints=np.array(points).reshape(-1, 2), camera_id=image.camera_id, image_id=image_id)
        merged.add_image_with_trivial_frame(copied, image.cam_from_world())
    for _, point in sorted(joined.points3D.items()):
        track = pycolmap.Track()
        for element in point.track.elements:
            track.add_element(element.image_id, element.point2D_idx + before[element.image_id])
        merged.add_point3D(point.xyz, track, point.color)
    numbers = {image.name: image_id for image_id, image in joined.images.items()}
    for _, point in sorted(first.model.points3D.items()):
        track = pycolmap.Track()
        for element in point.track.elements:
            track.add_element(numbers[first.model.images[element.image_id].name], element.point2D_idx)
        merged.add_point3D(point.xyz, track, point.color)
    merged.update_point_3d_errors()
    return merged
