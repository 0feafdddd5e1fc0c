"""Salient-object detection by a network in an ONNX file, which onnxruntime runs on the processor.

Any network will do that takes one RGB image and gives one map of its size. How those that are known expect their images stands in
salient_networks.py; u2netp comes with the set-up.
"""

import argparse
import functools
import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnxruntime
from scipy.special import expit

from zeroshop_steps.geometry.imaging.images import compute_overlap, read_image
from zeroshop_steps.networks.imagenet import LEVEL_DEVIATION, LEVEL_MEAN
from zeroshop_steps.networks.saliency.object_finder import surround_main_thing
from zeroshop_steps.networks.saliency.salient_networks import (
    NETWORKS,
    network_path,
    recognize_network,
    require_network,
)
from zeroshop_steps.runtime.compute.thread_pool import map_in_threads
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.progress import ProgressReport

USUAL_SIDE_PX = 1024  # of the image, where the file leaves it open; IS-Net and BiRefNet were trained on this
# The bytes of a map must not depend on the threads of the step, and sums in another order change single pixels. So a session has one
# thread, and several photos are seen at once. A large input needs gigabytes for each photo: then one at a time, always by two threads.
MOST_AT_ONCE = 4  # photos: u2netp takes 0.4 GB for each, u2net 0.6
ONE_BY_ONE_PX = 512 * 512
ROUNDING = 0.01  # of answers that are shares: of half precision, with room; those before the last sigmoid reach several units
CLOSER_MARGIN = 0.15  # around the main thing, of its longer side, that is left when the network looks closer
CLOSER_SHARE = 0.5  # of the photo: what fills more of it is not seen much finer from closer
CLOSER_AGREES = 0.9  # overlap of the two looks: of 20 photos of a drill, 19 agree to 0.98, and of one the closer look lost a quarter


def add_network_arguments(parser: argparse.ArgumentParser, default: str | None) -> None:
    """Options that name a network; `default` is the network where none is named, or None for none."""
    usual = default or "none"
    parser.add_argument("--network", type=network_path, default=default, help=(
        f"salient-object network: {', '.join(NETWORKS)}, or an ONNX file (default: {usual})"))  # fmt: skip
    for name, what in (("--mean", "taken off"), ("--deviation", "divided by")):
        parser.add_argument(name, type=float, nargs=3, metavar=("RED", "GREEN", "BLUE"), help=(
            f"of the images that an unknown network was trained on, {what}, 0 to 255 (default: that of the known network)"))  # fmt: skip


def load_network(args: argparse.Namespace) -> "SalientObjectNetwork":
    """The network that the command line names. Raises StepError where it is missing or no such network."""
    return SalientObjectNetwork(args.network, args.mean, args.deviation)


class SalientObjectNetwork:
    """The network of an ONNX file.

    Args:
        path: the file.
        mean, deviation: (3,) of the images that it was trained on, 0 to 255. By default those of the network that the file is known to
            hold. Where it is not known, those of ImageNet, with a warning.

    Raises:
        StepError: the file is missing, is no network, or does not take one RGB image; or only one of mean and deviation is given.
    """

    def __init__(self, path: Path, mean: Sequence[float] | None = None, deviation: Sequence[float] | None = None) -> None:
        self.path = require_network(Path(path))
        self._session = self._open(1)
        inputs = self._session.get_inputs()
        shape = inputs[0].shape
        if len(inputs) != 1 or len(shape) != 4 or shape[1] != 3 or inputs[0].type != "tensor(float)":
            described = ", ".join(f"{one.name} {one.shape} {one.type}" for one in inputs)
            raise StepError(f"{self.path} takes {described}; expected one float image of 1 x 3 x height x width: use another network")
        self._input, self._output = inputs[0].name, self._session.get_outputs()[0].name
        width, height = (side if isinstance(side, int) and side > 0 else USUAL_SIDE_PX for side in (shape[3], shape[2]))
        self._size_px = width, height
        self._one_by_one = width * height > ONE_BY_ONE_PX
        if self._one_by_one:
            self._session = self._open(2)
        chosen = self._choose_normalization(mean, deviation)
        self._mean, self._deviation = (np.array(values, np.float32).reshape(1, 1, 3) for values in chosen)

    def _open(self, threads: int) -> onnxruntime.InferenceSession:
        options = onnxruntime.SessionOptions()
        # Severity 3: errors alone; below, it warns of unused weights.
        options.intra_op_num_threads, options.inter_op_num_threads, options.log_severity_level = threads, 1, 3
        try:
            return onnxruntime.InferenceSession(self.path, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # its errors have no common class of their own
            reason = str(error).strip().splitlines()[0]
            raise StepError(f"{self.path} cannot be read as an ONNX network ({reason}); export or download it again") from None

    def _choose_normalization(
        self, mean: Sequence[float] | None, deviation: Sequence[float] | None
    ) -> tuple[Sequence[float], Sequence[float]]:
        if mean and deviation:
            return mean, deviation
        if mean or deviation:
            raise StepError("segment.saliency.mean and deviation go together; give both, or leave both out for a known network")
        if known := recognize_network(self.path, self._sha256, self._size_px):
            return known.mean, known.deviation
        warn(
            f"{self.path} is none of the known networks ({', '.join(NETWORKS)}); its images are normalized by the mean and deviation of"
            " ImageNet. If it was trained with others, set segment.saliency.mean and deviation"
        )
        return LEVEL_MEAN, LEVEL_DEVIATION

    def predict(self, image: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
        """How likely each pixel shows the object, 0 to 1.

        Args:
            image: (H, W, 3) RGB, 0 to 255.
            size_px: (width, height) of the answer.

        Returns:
            (height, width) float32.

        Raises:
            StepError: the network fails on it, or its first output is no map of such values.
        """
        small = cv2.resize(image, self._size_px, interpolation=cv2.INTER_AREA).astype(np.float32)
        batch = ((small - self._mean) / self._deviation).transpose(2, 0, 1)[None]
        try:
            [answer] = self._session.run([self._output], {self._input: np.ascontiguousarray(batch)})
        except Exception as error:  # as above
            raise StepError(f"{self.path} fails on a photo: {str(error).strip().splitlines()[0]}; use another network") from None
        found: np.ndarray = np.asarray(answer, np.float32)
        if found.ndim < 2 or found.size != found.shape[-1] * found.shape[-2]:
            raise StepError(f"the first output of {self.path} has shape {found.shape}; expected one map: use another network")
        found = found.reshape(found.shape[-2:])
        if not np.isfinite(found).all():
            raise StepError(f"{self.path} gives what is no number; check segment.saliency.mean and deviation, or use another network")
        # Networks differ in whether the last step, a sigmoid, is in the file; what lies outside 0 to 1 by rounding has had it. What the
        # sigmoid gives was trained as a probability, and is taken as it is: stretched from 0 to 1, as tools that cut out photos do, noise
        # would become a thing where the network sees none.
        logits = found.min() < -ROUNDING or found.max() > 1 + ROUNDING
        found = expit(found) if logits else found.clip(0, 1)
        shrinks = size_px[0] < self._size_px[0]
        return np.asarray(cv2.resize(found, size_px, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR))

    def find_maps(self, paths: Sequence[Path], width_px: int) -> list[np.ndarray]:
        """What the network sees in each photo: (h, w) float32, 0 to 1, at most `width_px` wide."""

        def look(path: Path) -> np.ndarray:
            image = read_image(path)
            width = min(width_px, image.shape[1])
            return self.predict(image, (width, round(image.shape[0] * width / image.shape[1])))

        return self._map("saliency", look, paths)

    def predict_all(self, images: Sequence[np.ndarray], sizes_px: Sequence[tuple[int, int]]) -> list[np.ndarray]:
        """What `predict` returns for each image and size."""
        return self._map("saliency", self.predict, images, sizes_px)

    def look_closer(self, paths: Sequence[Path], maps: Sequence[np.ndarray], width_px: int) -> list[np.ndarray]:
        """The maps, (h, w) float32, with the mean of them and of what the network sees in the surroundings of the main thing alone.

        A photo is reduced to what the network takes, so the outline of a small or thin thing is coarse. From closer, a part of it may look
        like a thing: what differs much from the look at the whole photo does not count.

        Args:
            paths: the photos.
            maps: what it saw in each whole photo.
            width_px: of the new maps, at most; maps of photos that the thing fills stay as they are.
        """

        def look(path: Path, found: np.ndarray) -> np.ndarray:
            around = surround_main_thing(found, CLOSER_MARGIN)
            if around is None or found[around].size > CLOSER_SHARE * found.size:
                return found
            image = read_image(path)
            width = min(width_px, image.shape[1])
            fine = cv2.resize(found, (width, round(image.shape[0] * width / image.shape[1])))
            part, seen = (_scale_slices(around, found.shape, target.shape) for target in (fine, image))
            whole, inside = fine[part], self.predict(image[seen], fine[part].shape[::-1])
            agrees = compute_overlap(whole > 0.5, inside > 0.5) >= CLOSER_AGREES
            fine[part] = (whole + inside) / 2
            return fine if agrees else found

        return self._map("closer", look, paths, maps)

    def _map(self, title: str, look: Callable[..., np.ndarray], photos: Sequence[Any], *others: Sequence[Any]) -> list[np.ndarray]:
        """What `look` returns for each photo, with a display of the progress."""
        with ProgressReport(title, len(photos)) as report:

            def look_and_count(*of_photo: Any) -> np.ndarray:
                found = look(*of_photo)
                report.advance()
                return found

            if self._one_by_one:
                return [look_and_count(*of_photo) for of_photo in zip(photos, *others, strict=True)]
            return map_in_threads(look_and_count, photos, *others, most_threads=MOST_AT_ONCE)

    @property
    def name(self) -> str:
        """The file's name, for records."""
        return self.path.name

    def describe(self) -> dict[str, Any]:
        """What its maps depend on: the file's SHA-256 and what it expects of an image."""
        values = {"mean": self._mean.ravel().tolist(), "deviation": self._deviation.ravel().tolist()}
        return {"sha256": self._sha256, **values}

    @functools.cached_property
    def _sha256(self) -> str:
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()


def _scale_slices(slices: tuple[slice, slice], shape: tuple[int, ...], target: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns of an array as those of another, of the same picture."""
    rows, columns = (
        slice(round(part.start * new / old), min(new, round(part.stop * new / old)))
        for part, old, new in zip(slices, shape[:2], target[:2], strict=True)
    )
    return rows, columns
