"""What the cues mean together: the fitted network, beside a twin in PyTorch, and what it does where cues know nothing."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers.table_scene import ball_mask, table_views
from zeroshop_steps.segment.cues.fusion import CHANNELS, CUES, MOST_ODDS, estimate_odds, load_fusion, prepare_channels
from zeroshop_steps.segment.photometry.exposure import Exposure
from zeroshop_steps.segment.scene import Hull, read_mask_scene, start_guess
from zeroshop_steps.segment.support import propose_supports

BALL = (0.0, 0.0, 0.5)


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    views, model = table_views(tmp_path_factory.mktemp("printed"), [[BALL]] * 8)
    scene = read_mask_scene(views, model, Exposure(np.zeros((8, 3)), False, []), None, 240)
    return scene, next(propose_supports(model, views, scene.planes)).support, [ball_mask(view.camera, BALL) for view in views]


def channel(stack, name):
    return stack[..., CHANNELS.index(name)]


def test_the_network_is_that_of_pytorch():
    fusion, channels = load_fusion(), np.random.default_rng(0).uniform(-1, 1, (50, len(CHANNELS))).astype(np.float32)
    first, second = torch.nn.Linear(*fusion.first.shape), torch.nn.Linear(len(fusion.second), 1)
    with torch.no_grad():
        first.weight.copy_(torch.from_numpy(fusion.first.T))
        first.bias.copy_(torch.from_numpy(fusion.first_offset))
        second.weight.copy_(torch.from_numpy(fusion.second[None]))
        second.bias.fill_(fusion.second_offset)
        expected = second(torch.relu(first(torch.from_numpy(channels))))[:, 0].numpy()
    assert np.allclose(fusion(channels), expected, atol=1e-4)


def test_the_ground_tells_the_ball(printed):
    scene, support, truths = printed
    stack = prepare_channels(scene, start_guess(scene, support))(0)
    off, known = channel(stack, "ground_off"), channel(stack, "ground_known") > 0
    assert known.mean() > 0.6
    assert np.median(off[truths[0] & known]) > 0.5 and np.median(off[~truths[0] & known]) < 0.1
    assert not channel(stack, "network_known").any() and not channel(stack, "hull").any(), "these know nothing"


def test_points_tell_what_is_flat(printed):
    scene, support, truths = printed
    see = prepare_channels(scene, start_guess(scene, scene.place(support)))
    raised = np.stack([channel(see(index), "points_raised") for index in range(len(truths))])
    assert raised[np.stack(truths)].mean() > 0.3 and raised[~np.stack(truths)].mean() < -0.1
    guessed = prepare_channels(scene, start_guess(scene, None))(0)
    assert channel(guessed, "points_known").any(), "without a plane of its own, the lowest one serves"


def test_cues_that_are_left_out_know_nothing(printed):
    scene, support, _ = printed
    stack = prepare_channels(scene, start_guess(scene, support), without=tuple(CUES))(0)
    assert not stack.any()


def hull_of(truths):
    """A hull that all views show."""
    nothing = [np.zeros_like(truth) for truth in truths]
    return Hull(np.ones((1, 1, 1), bool), truths, [truth.astype(np.float32) for truth in truths], nothing)


def test_a_hull_teaches_colors(printed):
    scene, support, truths = printed
    stack = prepare_channels(scene, replace(start_guess(scene, support), hull=hull_of(truths)))(0)
    colors, hull = channel(stack, "colors"), channel(stack, "hull")
    assert np.median(colors[truths[0]]) > 0.5 and np.median(colors[~truths[0]]) < 0
    assert (hull[truths[0]] > 0).all() and (hull[~truths[0]] < 0).all()


def test_a_network_that_sees_another_thing_than_the_other_views_is_told(printed):
    scene, support, truths = printed
    seen = [np.where(truth, 0.9, 0.1).astype(np.float32) for truth in truths]
    seen[0] = np.roll(seen[0], seen[0].shape[1] // 3, 1)
    see = prepare_channels(replace(scene, saliency=seen), replace(start_guess(scene, support), hull=hull_of(truths)))
    assert channel(see(0), "network_agrees").max() < 0.7 and channel(see(1), "network_agrees").min() == 1.0


def test_odds_of_all_views(printed):
    scene, support, truths = printed
    for odds, truth in zip(estimate_odds(scene, start_guess(scene, support)), truths, strict=True):
        assert np.abs(odds).max() <= MOST_ODDS and np.median(odds[truth]) > np.median(odds[~truth]) + 0.5
