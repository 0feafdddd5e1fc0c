"""MASt3R on a set of pictures: each is encoded once, pairs are decoded as they are asked for."""

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import torch

from zeroshop_steps.networks.devices import PROCESS_BYTES, MemoryNeeds, check_memory, fits_in_memory, run_network
from zeroshop_steps.networks.mast3r.framing import LONG_SIDE_PX, Framing, fit_framing_of_file, load_picture
from zeroshop_steps.networks.mast3r.model import PATCH_PX, ImagePrediction, MASt3R, Mast3rSettings
from zeroshop_steps.runtime.progress import track

NAME = "MASt3R_ViTLarge_BaseDecoder_512_catmlpdpt_metric.pth"
SMALLEST_SIDE_PX = 224  # where memory is short, the pictures are made no smaller than this
BYTES_A_PIXEL = 2000
"""Of a pair, at the peak in the heads; 1430 were measured."""


def predict_peak_bytes(parameters: int, framings: Sequence[Framing], configuration: Mast3rSettings, half: bool = False) -> int:
    """Memory at the peak: the weights (with `half`, also in half precision), the tokens of all pictures, and one pair in the heads."""
    tokens = sum(framing.width_px * framing.height_px for framing in framings) // PATCH_PX**2
    pixels = sorted((framing.width_px * framing.height_px for framing in framings), reverse=True)[:2]
    return PROCESS_BYTES + (6 if half else 4) * parameters + 4 * tokens * configuration.encoder_channels + BYTES_A_PIXEL * sum(pixels)


class PairPredictor(Protocol):
    """What matching and alignment need of the network: `Mast3rPredictor`, or in tests what is known of a virtual scene."""

    framings: list[Framing]

    def pair(self, first: int, second: int) -> tuple[ImagePrediction, ImagePrediction]:
        """What it says of two pictures; the points of both are in the camera frame of the first."""

    def similarities(self) -> torch.Tensor:
        """(N, N) similarities of the pictures."""


class Mast3rPredictor:
    """The network and its pictures.

    Attributes:
        framings: how each picture was resized and cropped.
        tokens: what the encoder says of each, (1, rows * columns, C).
    """

    def __init__(
        self,
        network: MASt3R,
        paths: Sequence[Path],
        device: torch.device,
        long_side_px: int = LONG_SIDE_PX,
        masks: Sequence[Path] | None = None,
    ) -> None:
        """Read and encode the pictures; with masks, what lies outside of them is black.

        Raises:
            StepError: it does not fit into memory.
        """
        self.framings = [fit_framing_of_file(path, long_side_px) for path in paths]
        largest = max(self.framings, key=lambda framing: framing.width_px * framing.height_px)
        self.what = f"MASt3R on {len(paths)} pictures of {largest.width_px} x {largest.height_px} px"
        self._check_memory(network, paths, device, long_side_px)
        self.device, self.tokens = device, []
        with run_network(device, self.what):
            self.network = network.to(device)
            pairs = zip(paths, masks or itertools.repeat(None, len(paths)), strict=True)
            for path, mask in track(pairs, "encoding pictures", len(paths)):
                picture, _ = load_picture(path, long_side_px, mask)
                self.tokens.append(network.encode(picture[None].to(device)))

    def _check_memory(self, network: MASt3R, paths: Sequence[Path], device: torch.device, long_side_px: int) -> None:
        parameters = sum(parameter.numel() for parameter in network.parameters())

        def needed(side_px: int) -> int:
            framings = [fit_framing_of_file(path, side_px) for path in paths]
            return predict_peak_bytes(parameters, framings, network.configuration, half=device.type == "cuda")

        smaller = (side for side in range(long_side_px - PATCH_PX, SMALLEST_SIDE_PX - 1, -PATCH_PX) if fits_in_memory(needed(side), device))
        if not fits_in_memory(needed(long_side_px), device):
            side = next(smaller, None)
            instead = f"--long-side-px {side} would fit" if side else "no size of pictures would fit; free memory"
            check_memory(MemoryNeeds(needed(long_side_px), self.what, f"{instead}, or use another method, such as colmap"), device)

    def pair(self, first: int, second: int) -> tuple[ImagePrediction, ImagePrediction]:
        """What the network says of two pictures; the points of both are in the camera frame of the first."""
        grids = [(self.framings[index].height_px // PATCH_PX, self.framings[index].width_px // PATCH_PX) for index in (first, second)]
        with run_network(self.device, self.what):
            return self.network.predict(self.tokens[first], self.tokens[second], *grids)

    def similarities(self) -> torch.Tensor:
        """(N, N) cosine similarities of the pictures: of their mean tokens, less what all have in common."""
        means = torch.cat([tokens.float().mean(1) for tokens in self.tokens])
        means = torch.nn.functional.normalize(means - means.mean(0), dim=1)
        return (means @ means.T).cpu()
