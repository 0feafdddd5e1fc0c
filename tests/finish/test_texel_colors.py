"""The colours of texels: the kernel against a twin in NumPy, and that for CUDA against it, in Numba's simulator and on a device."""

import numpy as np
import pytest

from helpers import few_texels
from helpers.simulator import run_in_simulator
from zeroshop_steps.finish.texturing.texel_colors import VotingView, make_texel_colors
from zeroshop_steps.runtime.compute.kernel_devices import has_cuda
from zeroshop_steps.runtime.errors import StepError


def test_texels_have_the_colours_of_the_twin():
    (means, weights), (expected, expected_weights) = few_texels.color("cpu"), few_texels.color_by_twin()
    off = np.abs(means - 255 * np.clip(expected, 0, 1))
    assert np.array_equal(weights > 0, expected_weights > 0) and 0.2 < (weights > 0).mean() < 0.9
    # OpenCV, which samples for the twin, rounds positions to a 32nd of a pixel.
    assert np.abs(weights - expected_weights).max() < 0.06 and off.mean() < 2.0
    assert off[weights == 0].max() < 0.51


def test_a_photo_is_shown_as_it_is_at_the_centres_of_its_pixels():
    columns, rows = (grid.ravel() for grid in np.meshgrid(np.arange(1, 9), np.arange(1, 7)))
    count, view = len(rows), few_texels.make_views()[0]
    vertices = np.stack([columns + 0.5, rows + 0.5, np.ones(count)], 1)
    corners, shares = np.repeat(np.arange(count, dtype=np.int32)[:, None], 3, 1), np.full((count, 3), 1 / 3, np.float32)
    near, nothing = np.ones_like(view.depth), np.zeros((count, 3), np.float32)
    colors = make_texel_colors("cpu", corners, shares, vertices, 1e-6)
    colors.begin_round(0.5, np.inf)
    colors.add(VotingView(np.eye(3, 4), view.image, near, near, np.ones(count, np.float32), nothing))
    means, weights = colors.finish(nothing, 0.0)
    assert np.allclose(weights, 1.0) and np.abs(means - 255 * view.image[rows, columns]).max() < 0.51


@pytest.mark.slow
def test_the_simulated_kernels_give_the_colours_that_the_cpu_gives(tmp_path):
    run_in_simulator(few_texels.__file__, str(tmp_path / "found.npz"))
    found, (means, weights) = np.load(tmp_path / "found.npz"), few_texels.color("cpu")
    assert np.allclose(found["weights"], weights, atol=1e-6)
    assert np.abs(found["means"].astype(int) - means).max() <= 1 and (found["means"] == means).mean() > 0.99


@pytest.mark.skipif(not has_cuda(), reason="Numba finds no CUDA device")
def test_a_device_gives_the_colours_that_the_cpu_gives_and_the_same_bytes_twice():
    (means, weights), found, again = (few_texels.color(device) for device in ("cpu", "cuda", "cuda"))
    assert np.allclose(found[1], weights, atol=1e-6) and np.abs(found[0].astype(int) - means).max() <= 1
    assert all(mine.tobytes() == other.tobytes() for mine, other in zip(found, again, strict=True))


def test_an_absent_device_is_refused(monkeypatch):
    monkeypatch.setattr("zeroshop_steps.runtime.compute.kernel_devices.has_cuda", lambda: False)
    *texels, _ = few_texels.make_texels()
    with pytest.raises(StepError, match="finds no CUDA device"):
        make_texel_colors("cuda", *texels, few_texels.TOLERANCE)
