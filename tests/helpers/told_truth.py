"""Networks that find cameras, run as they are, whose answers are then replaced by the truth of a rendered capture, with noise."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from helpers.made_pairs import MadePairs, Noise
from helpers.small_vggt import TrueNetwork
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model
from zeroshop_steps.geometry.imaging.images import list_images, read_depth_mm

NOISE = Noise(feature=0.02, point=0.002)


def told_pairs(predictor: type) -> type:
    """`Mast3rPredictor` that is told what pairs of a rendered capture show; of other pictures it says what it says.

    It encodes all pictures and is asked for one pair itself: even tiny, its heads take seconds for each.
    """

    class Told(predictor):  # type: ignore[misc]
        def __init__(self, network: Any, paths: list[Path], device: Any, long_side_px: int = 512, masks: Any = None) -> None:
            super().__init__(network, paths, device, long_side_px, masks)
            capture = Path(paths[0]).resolve().parents[1]
            self.asked = False
            self.truth = _read_truth(capture, [Path(path).name for path in paths], long_side_px) if (capture / "truth").is_dir() else None

        def pair(self, first: int, second: int) -> Any:
            if self.truth is None:
                return super().pair(first, second)
            told = self.truth.pair(first, second)
            if not self.asked:
                said = super().pair(first, second)
                shapes = [[one.points.shape, one.descriptor_confidence.shape] for one in (*said, *told)]
                assert shapes[:2] == shapes[2:], "the network answers in the shape of the truth"
                self.asked = True
            return told

    return Told


def _read_truth(capture: Path, names: list[str], long_side_px: int) -> MadePairs:
    cameras = {camera.name: camera for camera in read_sparse_model(capture / "truth").cameras}
    depths = [read_depth_mm(capture / "depth" / Path(name).with_suffix(".png")) for name in names]
    return MadePairs([cameras[name] for name in names], depths, 1e-3, NOISE, long_side_px)


def told_frames(register: Callable[..., Any]) -> Callable[..., Any]:
    """VGGT's `register` whose network is told the truth after it has answered."""

    class Told:
        def __init__(self, network: Any, capture: Path, image_px: int) -> None:
            self.network, self.capture, self.image_px, self.truth = network, capture, image_px, None

        def predict(self, pixels: np.ndarray) -> Any:
            said, told = self.network.predict(pixels), self._tell(pixels).predict(pixels)
            assert said.depth.shape == told.depth.shape and said.encodings.shape == told.encodings.shape
            return told

        def track(self, pixels: np.ndarray, view: int, xy: np.ndarray) -> Any:
            said, told = self.network.track(pixels, view, xy), self._tell(pixels).track(pixels, view, xy)
            assert said[0].shape == told[0].shape
            return told

        def _tell(self, pixels: np.ndarray) -> TrueNetwork:
            if self.truth is None:
                from zeroshop_steps.register.scene.image_set import read_image_set
                from zeroshop_steps.register.vggt.frames import read_frames

                frames = read_frames(read_image_set(self.capture), self.image_px, 14)
                self.truth = TrueNetwork(self.capture, frames, turn_deg=0.5, fov_error=0.005, depth_error=0.002, track_px=0.2)
            return self.truth

    @functools.wraps(register)
    def told(image_set: Any, out: Path, options: Any, network: Any, image_px: int, patch_px: int, known: Any) -> Any:
        capture = Path(image_set.images[0]).resolve().parents[1]
        assert len(list_images(capture / "images")) == len(image_set.images)
        return register(image_set, out, options, Told(network, capture, image_px), image_px, patch_px, known)

    return told
