"""A thing on a plain table is found in a single photo by its contrast to the ground."""

import numpy as np
import pytest

from zeroshop_steps.geometry.images import compute_overlap
from zeroshop_steps.register.ground_contrast import find_contrasting_thing

HEIGHT, WIDTH = 180, 240
THING = (slice(60, 130), slice(90, 150))


def photograph_table(seed: int = 0) -> np.ndarray:
    """A pale table, unevenly lit, with the noise of a camera."""
    y, x = np.meshgrid(np.linspace(-1, 1, HEIGHT), np.linspace(-1, 1, WIDTH), indexing="ij")
    light = 170 + 30 * x - 20 * y - 15 * x * x
    noise = np.random.default_rng(seed).normal(0, 3, (HEIGHT, WIDTH, 3))
    return np.clip(light[..., None] * [1.0, 0.97, 0.9] + noise, 0, 255).astype(np.uint8)


def thing_mask() -> np.ndarray:
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[THING] = True
    return mask


@pytest.mark.parametrize("color", [(40, 60, 140), (200, 60, 50), (60, 60, 60), (250, 250, 250)])
def test_a_thing_is_cut_out_of_an_unevenly_lit_table(color):
    photo = photograph_table()
    photo[THING] = color
    assert compute_overlap(find_contrasting_thing(photo), thing_mask()) > 0.95


def test_its_print_leaves_no_hole_and_things_that_run_out_of_the_photo_do_not_count():
    photo = photograph_table()
    photo[THING] = (200, 60, 50)
    photo[80:100, 105:130] = photo[10:30, 105:130]  # a label in the table's colours
    photo[:50, :70] = (30, 120, 60)
    photo[150:, 60:200] = (90, 30, 120)
    assert compute_overlap(find_contrasting_thing(photo), thing_mask()) > 0.95


def test_a_soft_shadow_is_no_part_of_the_thing():
    photo = photograph_table().astype(float)
    photo[100:140, 130:190] *= 0.85
    photo = photo.astype(np.uint8)
    photo[THING] = (200, 60, 50)
    assert compute_overlap(find_contrasting_thing(photo), thing_mask()) > 0.95


def test_a_dark_contact_shadow_is_no_part_of_the_thing():
    """Right at the foot a shadow is as dark as a thing may be; it fades into the table, which a thing does not."""
    photo = photograph_table().astype(float)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    away = np.hypot(np.maximum(np.abs(x - 120) - 30, 0), np.maximum(np.abs(y - 122) - 8, 0))
    photo *= (1 - 0.5 * np.clip(1 - away / 30, 0, 1))[..., None]
    photo = photo.astype(np.uint8)
    photo[THING] = (200, 60, 50)
    assert compute_overlap(find_contrasting_thing(photo), thing_mask()) > 0.95


def test_an_empty_table_shows_nothing():
    assert not find_contrasting_thing(photograph_table()).any()


def test_the_same_photo_gives_the_same_mask():
    photo = photograph_table()
    photo[THING] = (40, 60, 140)
    assert np.array_equal(find_contrasting_thing(photo), find_contrasting_thing(photo))
