"""Outlines are found at the photos' own resolution, where a pixel shows half of the object."""

import cv2
import numpy as np
import pytest

from zeroshop_steps.segment.outlines.outline import follow_edges

HEIGHT, WIDTH, CUT_WIDTH = 270, 480, 240


def draw(object_color, ground_color, printed=0.2):
    """A blurred and noisy photo, (H, W, 3) uint8, and the true (H, W) bool mask: a printed disc with a handle 3 px wide."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    disc = np.hypot(x - 200.3, y - 130.7) < 70
    mask = disc | ((np.abs(y - 130) < 1.5) & (x > 200) & (x < 330))
    print_ = np.array(object_color) * (1 - printed + printed * np.sign(np.sin(x / 9) * np.sin(y / 7)))[..., None]
    photo = cv2.GaussianBlur(np.where(mask[..., None], print_, np.array(ground_color, float)), (0, 0), 1.0)
    return (photo + rng.normal(0, 2, photo.shape)).clip(0, 255).astype(np.uint8), mask


def cut(mask, grown_px):
    """The mask at the width at which photos are cut, (h, w) float32, too large by so many pixels of the photo."""
    grown = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5) <= grown_px
    return cv2.resize(grown.astype(np.float32), (CUT_WIDTH, HEIGHT * CUT_WIDTH // WIDTH), interpolation=cv2.INTER_AREA)


def overlap(mask, other):
    return (mask & other).sum() / (mask | other).sum()


def enlarge(mask):
    return cv2.resize(mask, (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR) > 0.5


@pytest.mark.parametrize(("object_color", "ground_color"), [((210, 190, 60), (50, 48, 45)), ((60, 70, 160), (205, 200, 190))])
@pytest.mark.parametrize("grown_px", [-1.5, 0.0, 2.0])
def test_the_outline_lies_where_pixels_show_half_of_the_object(object_color, ground_color, grown_px):
    photo, mask = draw(object_color, ground_color)
    small = cut(mask, grown_px) if grown_px >= 0 else 1 - cut(~mask, -grown_px)
    found = follow_edges(small, photo)
    disc = np.s_[:, :265]  # without the handle, which is too thin to show its own colour
    assert overlap(found[disc], mask[disc]) > 0.99
    assert grown_px == 0.0 or overlap(found[disc], mask[disc]) > overlap(enlarge(small)[disc], mask[disc]) + 0.02


def test_the_outline_stays_where_the_photo_shows_no_edge():
    """Where the object has the colour of the ground, and where it is too thin."""
    photo, mask = draw((125, 125, 125), (115, 115, 115), printed=0.0)
    small = cut(mask, 2.0)
    assert overlap(follow_edges(small, photo), enlarge(small)) > 0.99
    photo, mask = draw((210, 190, 60), (50, 48, 45))
    handle = np.s_[120:140, 275:325]
    assert mask[handle].any() and not (mask & ~follow_edges(cut(mask, 1.0), photo))[handle].any()


def test_large_photos_and_empty_masks():
    """A photo many times as wide as its mask is looked at smaller; nothing is found where there is nothing."""
    photo, mask = draw((210, 190, 60), (50, 48, 45))
    large = cv2.resize(photo, None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)
    found = follow_edges(cut(mask, 2.0), large)
    true = cv2.resize(mask.astype(np.uint8), None, fx=4, fy=4, interpolation=cv2.INTER_NEAREST) > 0
    assert found.shape == true.shape and overlap(found[:, :1060], true[:, :1060]) > 0.985
    assert not follow_edges(np.zeros((135, 240), np.float32), photo).any()
    assert follow_edges(np.ones((135, 240), np.float32), photo).all()
