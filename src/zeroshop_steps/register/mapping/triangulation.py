"""Sparse points from known cameras."""

from pathlib import Path

import pycolmap

from zeroshop_steps.register.mapping.incremental import make_mapping_options
from zeroshop_steps.register.scene.image_set import ImageSet


def triangulate_points(
    database: Path, image_set: ImageSet, camera_from_world: dict[str, pycolmap.Rigid3d], seed: int
) -> pycolmap.Reconstruction:
    """Sparse points from the matches of a database, with its cameras held fixed at {image stem: pose}; `seed` is of RANSAC."""
    model = pycolmap.Reconstruction()
    with pycolmap.Database.open(database) as opened:
        for camera in opened.read_all_cameras():
            model.add_camera_with_trivial_rig(camera)
        for image in sorted(opened.read_all_images(), key=lambda image: image.name):
            placed = pycolmap.Image(name=image.name, camera_id=image.camera_id, image_id=image.image_id)
            model.add_image_with_trivial_frame(placed, camera_from_world[Path(image.name).stem])
    mapper = make_mapping_options(len(image_set.images), seed)
    output = database.parent / "triangulated"
    output.mkdir()
    return pycolmap.triangulate_points(model, database, image_set.images[0].parent, output, options=mapper)
