"""FoundationPose's refiner and scorer on a device, from the published checkpoints or from ONNX files, within its memory."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Protocol

import torch
from torch import Tensor

from zeroshop_steps.networks.devices import PROCESS_BYTES, RESERVE, MemoryNeeds, check_memory, measure_free_bytes
from zeroshop_steps.networks.foundationpose.model import RefineNet, ScoreNet, load_network
from zeroshop_steps.networks.foundationpose.onnx_pairs import OnnxPairs
from zeroshop_steps.pose.foundationpose.crops import CropPairs

NETWORKS_BYTES = 240_000_000
"""Of both networks, a photo of 640 x 480 px with depth, and the rasterizer; measured."""
PAIR_BYTES = 20_000_000
"""That one pair of crops takes at the peak of a network, in float32 on a processor; the most of several measurements."""
MOST_PAIRS = {"cpu": 16, "cuda": 252}
"""Pairs that go together at most: on a processor, more gain nothing."""


class PairNetworks(Protocol):
    """What the estimator needs of the networks."""

    @property
    def batch(self) -> int:
        """How many pairs may come together."""

    def refine(self, pairs: CropPairs) -> tuple[Tensor, Tensor]:
        """(N, 3) translations and (N, 3) turns, as `poses.apply_update` takes them."""

    def score(self, batches: Iterator[CropPairs]) -> Tensor:
        """(N,) scores, higher is better, of the pairs in all batches, which are compared with each other."""


class TorchNetworks:
    """The published checkpoints in our own networks.

    Raises:
        StepError: weights are missing, damaged or of other networks, or memory does not suffice for a single pose.
    """

    def __init__(self, weights: Sequence[Path], device: torch.device) -> None:
        self.batch = choose_batch(device)
        self._refiner, self._scorer = load_network(RefineNet, weights[0], device), load_network(ScoreNet, weights[1], device)

    def refine(self, pairs: CropPairs) -> tuple[Tensor, Tensor]:
        """As `PairNetworks` says."""
        translation, turn = self._refiner(pairs.rendered, pairs.observed)
        return translation.float(), turn.float()

    def score(self, batches: Iterator[CropPairs]) -> Tensor:
        """As `PairNetworks` says."""
        return self._scorer.rank(torch.cat([self._scorer.describe(pairs.rendered, pairs.observed) for pairs in batches])).float()


class OnnxNetworks:
    """The hub's ONNX files, run by onnxruntime. The scorer takes all poses at once, as it was exported.

    Raises:
        StepError: a file is missing, is no network, or does not take pairs; or memory does not suffice.
    """

    def __init__(self, weights: Sequence[Path], device: torch.device, poses: int = MOST_PAIRS["cuda"]) -> None:
        self.batch = choose_batch(device, poses)
        self._refiner, self._scorer = OnnxPairs(weights[0], device, outputs=2), OnnxPairs(weights[1], device, outputs=1)

    def refine(self, pairs: CropPairs) -> tuple[Tensor, Tensor]:
        """As `PairNetworks` says."""
        translation, turn = self._refiner.run(pairs.rendered, pairs.observed)
        return translation, turn

    def score(self, batches: Iterator[CropPairs]) -> Tensor:
        """As `PairNetworks` says."""
        pairs = list(batches)
        [scores] = self._scorer.run(torch.cat([one.rendered for one in pairs]), torch.cat([one.observed for one in pairs]))
        return scores.reshape(-1)


def predict_peak_bytes(pairs: int) -> int:
    """The most memory that a run takes whose networks see so many pairs at once."""
    return PROCESS_BYTES + NETWORKS_BYTES + pairs * PAIR_BYTES


def choose_batch(device: torch.device, least: int = 1) -> int:
    """How many pairs can go together on a device.

    Raises:
        StepError: fewer than `least`.
    """
    check_memory(
        MemoryNeeds(
            predict_peak_bytes(least),
            f"FoundationPose on {least} {'pose' if least == 1 else 'poses'} at once",
            "close what else uses it, or use the pose estimator render_compare, which needs less",
        ),
        device,
    )
    fits = (RESERVE * measure_free_bytes(device.type) - predict_peak_bytes(0)) / PAIR_BYTES
    return max(1, min(MOST_PAIRS[device.type], int(fits)))
