"""Localize photos of the empty scene in a registration of the object's photos: both show the same ground.

The object's cameras stay fixed, and only those of the empty scene are estimated. So one set of such photos serves all objects that
were filmed there, and any registration.
"""

import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from zeroshop_steps.capture.photo_files import find_format_problems
from zeroshop_steps.geometry.alignment.robust_estimates import AGREEING_VIEWS
from zeroshop_steps.geometry.cameras.pinhole import Camera, to_matrix, to_rigid
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.imaging.images import list_images, read_image
from zeroshop_steps.register.features.sift import SiftOptions, make_extraction_options
from zeroshop_steps.register.mapping.mapper import make_mapping_options
from zeroshop_steps.register.matching.verified_matches import match_features
from zeroshop_steps.register.scene.database import create_database
from zeroshop_steps.runtime.errors import StepError

OBJECT, SCENE = "object", "scene"


@dataclass(frozen=True)
class LocalizedPhoto:
    """A photo of the empty scene whose camera was found.

    Attributes:
        path: the photo.
        camera: its lens.
        camera_from_world: (4, 4) in the registration frame.
    """

    path: Path
    camera: pycolmap.Camera
    camera_from_world: np.ndarray

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """(N, 2) image plane coordinates at depth 1 of (N, 2) pixels, free of the lens's distortion."""
        return np.asarray(self.camera.cam_from_img(pixels), float)[:, :2]


def localize_photos(folder: Path, views: list[View], options: SiftOptions) -> list[LocalizedPhoto]:
    """Find the cameras of the photos in `folder`.

    Args:
        folder: photos of one size and one lens that show the ground around the object's place, without the object.
        views: the registered photos of the object.
        options: of features and matching.

    Raises:
        StepError: fewer than two could be placed.
    """
    odd = find_format_problems(folder)
    if odd:
        raise StepError("; ".join(odd))
    photos = list_images(folder)
    sizes = {read_image(photo).shape for photo in photos}
    pycolmap.logging.minloglevel = pycolmap.logging.ERROR
    with tempfile.TemporaryDirectory(prefix="scene_photos.") as scratch_name:
        scratch = Path(scratch_name)
        images, database = scratch / "images", scratch / "database.db"
        placed_as = {f"{SCENE}_{photo.name}": photo for photo in photos}
        objects = {f"{OBJECT}_{view.image_path.name}": view.camera for view in views}
        images.mkdir()
        for view in views:
            os.symlink(view.image_path.resolve(), images / f"{OBJECT}_{view.image_path.name}")
        for name, photo in placed_as.items():
            os.symlink(photo.resolve(), images / name)
        _extract_features(database, images, objects, list(placed_as), len(sizes) == 1, options)
        match_features(database, options)
        model = _map_jointly(database, images, objects, scratch, options)
    placed = [
        LocalizedPhoto(placed_as[image.name], model.cameras[image.camera_id], to_matrix(image.cam_from_world()))
        for image in sorted(model.images.values(), key=lambda image: image.name)
        if image.has_pose and image.name in placed_as
    ]
    if len(placed) < AGREEING_VIEWS:
        raise StepError(
            f"{len(placed)} of {len(photos)} photos in {folder} could be placed among the object's photos, {AGREEING_VIEWS} are needed: "
            "they must show the same ground, with texture, around the place where the object stands, and nothing there may have moved. On "
            "a plain table, lay the board beside the object instead"
        )
    return placed


def _extract_features(
    database: Path, images: Path, objects: dict[str, Camera], scene: list[str], one_lens: bool, options: SiftOptions
) -> None:
    """Extract features of all photos. The object's have known cameras, the empty scene's one unknown lens, or one each."""
    mode = pycolmap.CameraMode.SINGLE if one_lens else pycolmap.CameraMode.PER_IMAGE
    pinhole, lens = pycolmap.ImageReaderOptions(), pycolmap.ImageReaderOptions()
    pinhole.camera_model, lens.camera_model = "PINHOLE", "SIMPLE_RADIAL"
    create_database(database, len(objects) + len(scene))
    pycolmap.import_images(database, images, pycolmap.CameraMode.PER_IMAGE, sorted(objects), pinhole)
    pycolmap.import_images(database, images, mode, sorted(scene), lens)
    with pycolmap.Database.open(database) as opened:
        for image in opened.read_all_images():
            if image.name in objects:
                camera = objects[image.name]
                params = camera.pinhole_params
                fields = {"model": "PINHOLE", "width": camera.width_px, "height": camera.height_px, "params": params}
                opened.update_camera(pycolmap.Camera({**fields, "camera_id": image.camera_id, "has_prior_focal_length": True}))
    extraction = make_extraction_options(options, options.first_octave)
    pycolmap.extract_features(database, images, sorted([*objects, *scene]), pycolmap.CameraMode.AUTO, lens, extraction)


def _map_jointly(database: Path, images: Path, objects: dict[str, Camera], scratch: Path, options: SiftOptions) -> pycolmap.Reconstruction:
    """Triangulate points from the object's photos with fixed cameras, then register the other photos to them."""
    model = pycolmap.Reconstruction()
    lenses = set()
    with pycolmap.Database.open(database) as opened:
        cameras = {camera.camera_id: camera for camera in opened.read_all_cameras()}
        for image in sorted(opened.read_all_images(), key=lambda image: image.name):
            if image.name not in objects:
                continue
            lenses.add(image.camera_id)
            model.add_camera_with_trivial_rig(cameras[image.camera_id])
            pose = to_rigid(objects[image.name].camera_from_world)
            model.add_image_with_trivial_frame(pycolmap.Image(name=image.name, camera_id=image.camera_id, image_id=image.image_id), pose)
    mapper = make_mapping_options(AGREEING_VIEWS, options.seed)
    for name in ("triangulated", "joint"):
        (scratch / name).mkdir()
    pycolmap.set_random_seed(options.seed)
    triangulated = pycolmap.triangulate_points(model, database, images, scratch / "triangulated", options=mapper)
    if triangulated.num_points3D() == 0:
        raise StepError(
            "the object's photos share no point of the ground, among which the empty scene's could be placed: put the object on something"
            " with texture, or lay the board beside it"
        )
    mapper.multiple_models = False
    mapper.fix_existing_frames = mapper.mapper.fix_existing_frames = True
    mapper.constant_cameras = mapper.mapper.constant_cameras = lenses
    try:
        found = pycolmap.incremental_mapping(database, images, scratch / "joint", mapper, str(scratch / "triangulated"))
    except IndexError:  # COLMAP's way to say that no other photo sees any of these points
        return model
    return max(found.values(), key=lambda joint: joint.num_reg_images(), default=model)
