"""Neighbouring images that share few points: they show the same, and features were missed, or they show different sides."""

from pathlib import Path

import cv2
import numpy as np
import pycolmap

from helpers.side_points import add_side_points
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.register.verification.duplicate_structure import check_duplicate_structure
from zeroshop_steps.register.verification.missing_correspondences import find_mismatched_pairs
from zeroshop_steps.register.verification.verdict import judge

WIDTH, HEIGHT, FOCAL, HIGH = 320, 240, 300.0, 4.0


def print_of(side: int) -> np.ndarray:
    """(400, 400) uint8 of a print that covers -2 to 2 along both axes."""
    return cv2.GaussianBlur(np.random.default_rng(side).integers(0, 256, (400, 400)).astype(np.float32), (0, 0), 2.5)


def make_scene(folder: Path, sides: list[int], share: float) -> pycolmap.Reconstruction:
    """Cameras that look down at a print from places side by side, each at that of its side; each sees a random share of its points."""
    rng = np.random.default_rng(0)
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(model="PINHOLE", width=WIDTH, height=HEIGHT, params=[FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2], camera_id=1)
    model.add_camera_with_trivial_rig(camera)
    rotation = np.diag([1.0, -1.0, -1.0])
    places = np.concatenate([rng.uniform(-1.0, 1.0, (max(sides) + 1, 300, 2)), np.zeros((max(sides) + 1, 300, 1))], axis=2)
    seen = [rng.random(300) < share for _ in sides]
    for number, side in enumerate(sides):
        centre = np.array([0.12 * number - 0.06 * len(sides), 0.05 * (number % 3), HIGH])
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ centre)
        keypoints = camera.img_from_cam(places[side] @ rotation.T - rotation @ centre)
        image = pycolmap.Image(name=f"{number}.png", keypoints=keypoints, camera_id=1, image_id=number + 1)
        model.add_image_with_trivial_frame(image, pose)
        # From pixels of the print to the plane, and from there to the image.
        plane_from_print = np.array([[0.01, 0, -2.0], [0, 0.01, -2.0], [0, 0, 1]])
        image_from_plane = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]]) @ np.c_[rotation[:, :2], -rotation @ centre]
        picture = cv2.warpPerspective(print_of(side), image_from_plane @ plane_from_print, (WIDTH, HEIGHT))
        write_image(folder / f"{number}.png", np.repeat(picture[..., None], 3, 2).clip(0, 255).astype(np.uint8))
    add_side_points(model, places, sides, seen)
    return model


def test_images_of_one_place_show_the_same_though_few_points_match(tmp_path):
    model = make_scene(tmp_path, [0] * 8, 0.15)
    judged, unlike = find_mismatched_pairs(model, tmp_path)
    assert judged == 28 and unlike == []
    assert "share almost nothing" in judge(check_duplicate_structure(model).findings).reason
    found = check_duplicate_structure(model, images=tmp_path)
    assert found.findings[0].strength == 0 and found.entries["compared_pictures"] == 28
    assert found.entries["unlike"] == [] and len(found.entries["strangers"]) >= 10


def test_sides_that_lie_on_each_other_show_different_things(tmp_path):
    sides = [0, 1, 0, 1, 0, 1, 0, 1]
    model = make_scene(tmp_path, sides, 0.6)
    judged, unlike = find_mismatched_pairs(model, tmp_path)
    assert judged == 28
    assert {(one, other) for one, other in unlike} == {(f"{a}", f"{b}") for a in range(8) for b in range(a + 1, 8) if sides[a] != sides[b]}
    (finding,) = check_duplicate_structure(model, images=tmp_path).findings
    assert finding.strength > 2 and "16 of 28 pairs" in finding.found and "show different things" in finding.found
