"""A carton before cameras that are bent, and COLMAP models of them."""

from dataclasses import replace

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from helpers.made_scene import SIZE_MM, made_scene
from zeroshop_steps.geometry.cameras.pinhole import write_cameras
from zeroshop_steps.geometry.cameras.sparse_files import read_reconstruction

VIEWS = 10


def make_views():
    """The carton from ten sides."""
    return made_scene([360.0 / VIEWS * number for number in range(VIEWS)], [20.0, 50.0] * (VIEWS // 2), width_px=480, height_px=360)


def bend(cameras, degrees):
    """Turn each camera about the object's middle, ever farther around it and back."""
    middle = np.array([0.0, 0.0, SIZE_MM[2] / 2])
    bent = []
    for number, camera in enumerate(cameras):
        turn = Rotation.from_rotvec(
            np.radians(degrees) * np.array([np.sin(2.1 * number), np.cos(1.3 * number), np.sin(number)])
        ).as_matrix()
        pose = camera.camera_from_world.copy()
        pose[:3, 3] += pose[:3, :3] @ (middle - turn @ middle)
        pose[:3, :3] = pose[:3, :3] @ turn
        bent.append(replace(camera, camera_from_world=pose))
    return bent


def model_of(folder, cameras, true, count, neighbours, noise_px=0.3):
    """A COLMAP model of these cameras, whose points are where the true cameras see points of the carton."""
    write_cameras(folder, cameras)
    model, rng = read_reconstruction(folder), np.random.default_rng(0)
    images = {image.name: image for image in model.images.values()}
    points = rng.uniform([-0.5, -0.5, 0.0], [0.5, 0.5, 1.0], (count, 3)) * SIZE_MM
    seen = {camera.name: camera.project(points)[0] + rng.normal(0, noise_px, (count, 2)) for camera in true}
    first = rng.integers(0, VIEWS, count)
    for name, image in images.items():
        image.points2D = [pycolmap.Point2D(pixel) for pixel in seen[name]]
    for index, point in enumerate(points):
        track = pycolmap.Track()
        for step in range(neighbours):
            track.add_element(images[true[(first[index] + step) % VIEWS].name].image_id, index)
        model.add_point3D(point, track, np.zeros(3, np.uint8))
    return model
