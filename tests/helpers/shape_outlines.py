"""Outlines of a shape from all around, without a renderer."""

import cv2
import numpy as np
import trimesh

from helpers.camera_ring import ring_camera
from zeroshop_steps.register.submodels.outline_alignment import CameraGroup

VIEWS, SIZE_PX, FINER = 8, (480, 360), 4


def capture(shape: trimesh.Trimesh) -> CameraGroup:
    """A pass: cameras around a shape, and its outlines, which hide nothing: it is drawn face by face."""
    cameras = [ring_camera(index, VIEWS, 450.0, (15.0, 50.0), (0.0, 0.0, 0.0), 630.0, SIZE_PX) for index in range(VIEWS)]
    masks = {}
    for camera in cameras:
        corners = np.rint(camera.project(shape.vertices)[0] * FINER - 0.5).astype(np.int32)
        drawn = np.zeros((SIZE_PX[1] * FINER, SIZE_PX[0] * FINER), np.uint8)
        for face in shape.faces:
            cv2.fillConvexPoly(drawn, cv2.convexHull(corners[face]), 1)
        masks[camera.name] = cv2.resize(drawn.astype(np.float32), SIZE_PX, interpolation=cv2.INTER_AREA) > 0.5
    return CameraGroup(cameras, masks)
