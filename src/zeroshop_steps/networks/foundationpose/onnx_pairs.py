"""A network that takes pairs of images, from an ONNX file as NVIDIA publishes FoundationPose's."""

from pathlib import Path

import numpy as np
import onnxruntime
import torch
from torch import Tensor

from zeroshop_steps.networks.foundationpose.settings import CROP_PX, FoundationPoseSettings
from zeroshop_steps.runtime.errors import StepError, is_out_of_memory, warn

CHANNELS = FoundationPoseSettings().image_channels
CUDA = "CUDAExecutionProvider"
PROVIDERS = {"cpu": ["CPUExecutionProvider"], "cuda": [CUDA, "CPUExecutionProvider"]}
ON_PROCESSOR = "runs on the processor, where an instance takes about eleven minutes of CPU time"


class OnnxPairs:
    """The network of a file, on a device if onnxruntime was built for that, else on the processor.

    Args:
        path: the file.
        device: cpu or cuda.
        outputs: how many it has.

    Raises:
        StepError: it is missing, no network, or one with other inputs and outputs.
    """

    def __init__(self, path: Path, device: torch.device, outputs: int) -> None:
        self.path, self._device = path, device
        if not path.is_file():
            raise StepError(f"the network {path} does not exist")
        options = onnxruntime.SessionOptions()
        # Severity 3: errors alone.
        options.intra_op_num_threads, options.log_severity_level = torch.get_num_threads(), 3
        usable = [name for name in PROVIDERS[device.type] if name in onnxruntime.get_available_providers()]
        if device.type == "cuda" and CUDA not in usable:
            warn(f"{path.name} {ON_PROCESSOR}: install onnxruntime-gpu in place of onnxruntime (make gpu)")
        try:
            self._session = onnxruntime.InferenceSession(path, options, providers=usable)
        except Exception as error:  # its errors have no common class of their own
            reason = str(error).strip().splitlines()[0]
            raise StepError(f"{path} cannot be read as an ONNX network ({reason}); delete it and fetch it again") from None
        if CUDA in usable and CUDA not in self._session.get_providers():
            warn(f"{path.name} {ON_PROCESSOR}: onnxruntime-gpu is there, but finds no CUDA and cuDNN of its version")
        inputs, self._outputs = self._session.get_inputs(), [one.name for one in self._session.get_outputs()]
        fits = [one.type == "tensor(float)" and list(one.shape[1:]) == [CHANNELS, CROP_PX, CROP_PX] for one in inputs]
        if fits != [True, True] or len(self._outputs) != outputs:
            described = ", ".join(f"{one.name} {one.shape} {one.type}" for one in inputs)
            raise StepError(
                f"{path} takes {described} and gives {len(self._outputs)} values; expected two float images of N x {CHANNELS} x {CROP_PX} x"
                f" {CROP_PX} and {outputs}: it is of another model or version; take the file that weights.csv names"
            )
        self._inputs = [one.name for one in inputs]

    def run(self, rendered: Tensor, observed: Tensor) -> list[Tensor]:
        """The outputs for N pairs of (N, 6, CROP_PX, CROP_PX) images, (N, ...) each.

        Raises:
            StepError: it fails, or memory runs out.
        """
        images = [np.ascontiguousarray(image.float().cpu().numpy()) for image in (rendered, observed)]
        try:
            found = self._session.run(self._outputs, dict(zip(self._inputs, images, strict=True)))
        except Exception as error:  # as above
            reason = str(error).strip().splitlines()[0]
            cause = MemoryError() if is_out_of_memory(error) or "allocate" in reason else None
            raise StepError(f"{self.path} fails on {len(rendered)} pairs: {reason}") from cause
        return [torch.as_tensor(np.asarray(values, np.float32), device=self._device).reshape(len(rendered), -1) for values in found]
