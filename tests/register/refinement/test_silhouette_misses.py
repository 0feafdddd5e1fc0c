"""Cameras that are bent fit to few sparse points; the outlines of the masks tell."""

from dataclasses import replace

import numpy as np

from helpers.ball_scene import ball_cameras, ball_mask
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.register.refinement.silhouette_refinement import MOST_MISSED_PX, measure_silhouette_misses_px, warn_of_misses

CAMERAS = [camera.resized(1000, 750) for camera in ball_cameras()]
MASKS = [ball_mask(camera) for camera in CAMERAS]


def shifted(camera: Camera, across: float) -> Camera:
    """The camera moved to its right."""
    move = np.eye(4)
    move[0, 3] = -across
    return replace(camera, camera_from_world=move @ camera.camera_from_world)


def test_outlines_of_right_cameras_fit_also_where_one_mask_is_wrong(capsys):
    masks = list(MASKS)
    masks[3] = np.roll(masks[3], 100, axis=1)
    for chosen in (MASKS, masks):
        missed_px = measure_silhouette_misses_px(CAMERAS, chosen)
        assert missed_px is not None and missed_px < MOST_MISSED_PX
        warn_of_misses(missed_px)
    assert not capsys.readouterr().err


def test_bent_cameras_are_told(capsys):
    """Every camera is off by up to 3 % of its distance, in another direction than its neighbours."""
    bent = [shifted(camera, 0.09 * np.cos(index * 2.0)) for index, camera in enumerate(CAMERAS)]
    missed_px = measure_silhouette_misses_px(bent, MASKS)
    assert missed_px is not None and missed_px > MOST_MISSED_PX
    warn_of_misses(missed_px)
    assert "The cameras are bent, or the masks are wrong: look at contact_sheet.png" in capsys.readouterr().err


def test_two_views_tell_nothing():
    assert measure_silhouette_misses_px(CAMERAS[:2], MASKS[:2]) is None
