"""Salient-object detection by a network of the user's, an ONNX file that onnxruntime runs on the processor.

Any network will do that takes one RGB image and gives one map of its size: U2-Net (Qin et al. 2020), IS-Net (Qin et al. 2022),
BiRefNet (Zheng et al. 2024) and what was trained like them. Nothing is shipped or downloaded: the licences of such weights differ.
"""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnxruntime
from scipy.special import expit

from zeroshop_steps.geometry.images import compute_overlap, read_image
from zeroshop_steps.networks.object_finder import surround_main_thing
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.progress import track

IMAGE_MEAN, IMAGE_DEVIATION = [128.0, 128.0, 128.0], [256.0, 256.0, 256.0]  # of IS-Net's images, 0 to 255
USUAL_SIDE_PX = 1024  # of the image, where the file leaves it open; IS-Net and BiRefNet were trained on this
THREADS = 2  # always the same number, because sums in another order change single pixels
CHANNELS = 3
ROUNDING = 0.01  # of answers that are shares: of half precision, with room; those before the last sigmoid reach several units
CLOSER_MARGIN = 0.15  # around the main thing, of its longer side, that is left when the network looks closer
CLOSER_SHARE = 0.5  # of the photo: what fills more of it is not seen much finer from closer
CLOSER_AGREES = 0.9  # overlap of the two looks: of 20 photos of a drill, 19 agree to 0.98, and of one the closer look lost a quarter
WARNINGS = 3  # the severity from which onnxruntime speaks: errors; it warns of unused weights otherwise


class SalientObjectNetwork:
    """The network of an ONNX file.

    Args:
        path: the file.
        mean, deviation: (3,) of the image that are taken off, and divided by, in levels of 0 to 255.

    Raises:
        StepError: the file is missing, is no network, or does not take one RGB image.
    """

    def __init__(self, path: Path, mean: list[float], deviation: list[float]) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise StepError(
                f"the network {self.path} does not exist; segment.saliency.weights names an ONNX file of a salient-object network"
            )
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads, options.inter_op_num_threads, options.log_severity_level = THREADS, 1, WARNINGS
        try:
            self._session = onnxruntime.InferenceSession(self.path, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # its errors have no common class of their own
            reason = str(error).strip().splitlines()[0]
            raise StepError(f"{self.path} cannot be read as an ONNX network ({reason}); export or download it again") from None
        inputs = self._session.get_inputs()
        shape = inputs[0].shape
        if len(inputs) != 1 or len(shape) != 4 or shape[1] != CHANNELS or inputs[0].type != "tensor(float)":
            described = ", ".join(f"{one.name} {one.shape} {one.type}" for one in inputs)
            raise StepError(f"{self.path} takes {described}; expected one float image of 1 x 3 x height x width: use another network")
        self._input, self._output = inputs[0].name, self._session.get_outputs()[0].name
        self._size_px = tuple(side if isinstance(side, int) and side > 0 else USUAL_SIDE_PX for side in (shape[3], shape[2]))
        self._mean, self._deviation = (np.array(values, np.float32).reshape(1, 1, CHANNELS) for values in (mean, deviation))

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
        # Networks differ in whether the last step, a sigmoid, is in the file; what lies outside 0 to 1 by rounding has had it.
        logits = found.min() < -ROUNDING or found.max() > 1 + ROUNDING
        found = expit(found) if logits else found.clip(0, 1)
        shrinks = size_px[0] < self._size_px[0]
        return np.asarray(cv2.resize(found, size_px, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR))

    def find_maps(self, paths: Sequence[Path], width_px: int) -> list[np.ndarray]:
        """What the network sees in each photo: (h, w) float32, 0 to 1, at most `width_px` wide."""
        maps = []
        for path in track(paths, "saliency", len(paths)):
            image = read_image(path)
            width = min(width_px, image.shape[1])
            maps.append(self.predict(image, (width, round(image.shape[0] * width / image.shape[1]))))
        return maps

    def look_closer(self, paths: Sequence[Path], maps: Sequence[np.ndarray], width_px: int) -> list[np.ndarray]:
        """The maps, (h, w) float32, with the mean of them and of what the network sees in the surroundings of the main thing alone.

        A photo is reduced to what the network takes, so the outline of a small or thin thing is coarse. From closer, a part of it may look
        like a thing: what differs much from the look at the whole photo does not count.

        Args:
            paths: the photos.
            maps: what it saw in each whole photo.
            width_px: of the new maps, at most; maps of photos that the thing fills stay as they are.
        """
        closer = []
        for path, found in track(zip(paths, maps, strict=True), "closer", len(paths)):
            around = surround_main_thing(found, CLOSER_MARGIN)
            if around is None or found[around].size > CLOSER_SHARE * found.size:
                closer.append(found)
                continue
            image = read_image(path)
            width = min(width_px, image.shape[1])
            fine = cv2.resize(found, (width, round(image.shape[0] * width / image.shape[1])))
            part, seen = (_scale_slices(around, found.shape, target.shape) for target in (fine, image))
            whole, inside = fine[part], self.predict(image[seen], fine[part].shape[::-1])
            agrees = compute_overlap(whole > 0.5, inside > 0.5) >= CLOSER_AGREES
            fine[part] = (whole + inside) / 2
            closer.append(fine if agrees else found)
        return closer

    @property
    def name(self) -> str:
        """The file's name, for records."""
        return self.path.name

    def describe(self) -> dict[str, Any]:
        """What its maps depend on: the file's SHA-256 and what it expects of an image."""
        values = {"mean": self._mean.ravel().tolist(), "deviation": self._deviation.ravel().tolist()}
        with self.path.open("rb") as file:
            return {"sha256": hashlib.file_digest(file, "sha256").hexdigest(), **values}


def _scale_slices(slices: tuple[slice, slice], shape: tuple[int, ...], target: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns of an array as those of another, of the same picture."""
    rows, columns = (
        slice(round(part.start * new / old), min(new, round(part.stop * new / old)))
        for part, old, new in zip(slices, shape[:2], target[:2], strict=True)
    )
    return rows, columns
