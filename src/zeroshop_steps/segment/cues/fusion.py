"""The log odds that a pixel shows the object, by all cues together: a small network whose weights were fitted on many captures.

One network serves with and without a hull, a ground or a salient-object network: a cue that knows nothing is 0, and so it was in a part of
the captures it was fitted on (auto-context: Tu 2008). `benchmarks/fit_masks.py` fits it.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from zeroshop_steps.runtime.compute.thread_pool import map_in_threads
from zeroshop_steps.segment.cues import MOST_ODDS, ground, hull, network, own_colors, points, prompted
from zeroshop_steps.segment.scene import Guess, MaskScene

CUES = {cue.__name__.rpartition(".")[2]: cue for cue in (network, ground, points, own_colors, hull, prompted)}
CHANNELS = tuple(name for cue in CUES.values() for name in cue.CHANNELS)
WEIGHTS = Path(__file__).with_name("cue_weights.json")


@dataclass(frozen=True)
class Fusion:
    """A network with one hidden layer of rectified units: (C, K) and (K,) weights and offsets, then (K,) and one offset."""

    first: np.ndarray
    first_offset: np.ndarray
    second: np.ndarray
    second_offset: float

    def __call__(self, channels: np.ndarray) -> np.ndarray:
        """(P,) log odds for (P, C) channels."""
        return np.asarray(np.maximum(channels @ self.first + self.first_offset, 0) @ self.second + self.second_offset)


@cache
def load_fusion() -> Fusion:
    """The fitted network."""
    stored = json.loads(WEIGHTS.read_text())
    assert tuple(stored["channels"]) == CHANNELS, "the cues changed; fit their weights again"
    first, first_offset, second = (np.array(stored[name], np.float32) for name in ("first", "first_offset", "second"))
    return Fusion(first, first_offset, second, float(stored["second_offset"]))


def prepare_channels(scene: MaskScene, guess: Guess, without: Sequence[str] = ()) -> Callable[[int], np.ndarray]:
    """What gives the (h, w, C) float32 channels of a view, those of the cues `without` and of cues that know nothing 0."""
    prepared = {name: None if name in without else cue.prepare(scene, guess) for name, cue in CUES.items()}

    def see(index: int) -> np.ndarray:
        camera = scene.cameras[index]
        stack = np.zeros((camera.height_px, camera.width_px, len(CHANNELS)), np.float32)
        place = 0
        for name, cue in CUES.items():
            if (shown := prepared[name]) is not None:
                stack[..., place : place + len(cue.CHANNELS)] = np.stack(shown(index), -1)
            place += len(cue.CHANNELS)
        return stack

    return see


def estimate_odds(scene: MaskScene, guess: Guess, without: Sequence[str] = ()) -> list[np.ndarray]:
    """(h, w) float32 log odds of the object in every view, at most `MOST_ODDS` either way."""
    see, fusion = prepare_channels(scene, guess, without), load_fusion()

    def estimate(index: int) -> np.ndarray:
        channels = see(index)
        odds = fusion(channels.reshape(-1, len(CHANNELS))).reshape(channels.shape[:2])
        return np.clip(odds, -MOST_ODDS, MOST_ODDS).astype(np.float32)

    return map_in_threads(estimate, range(len(scene.views)))
