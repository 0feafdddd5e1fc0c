"""Tensors as the arrays that kernels for CUDA take: the same memory, without a copy."""

from typing import Any

import torch

from zeroshop_steps.runtime.compute.kernel_devices import choose_kernel_device
from zeroshop_steps.runtime.errors import StepError

THREADS = 128
"""Of a block."""


def choose_kernels(device: str) -> str:
    """ "cpu" or "cuda" for one of cpu, cuda and auto, where kernels and tensors both must find the device.

    Raises:
        StepError: cuda is asked for and absent for either, or the name is unknown.
    """
    chosen = choose_kernel_device(device)
    if chosen == "cuda" and not is_simulated() and not torch.cuda.is_available():
        if device == "auto":
            return "cpu"
        raise StepError(
            "--device cuda: Numba finds a CUDA device and PyTorch does not; install a build of PyTorch for CUDA, or use --device cpu"
        )
    return chosen


def is_simulated() -> bool:
    """Whether Numba's simulator stands in for a CUDA device."""
    from numba import config

    return bool(config.ENABLE_CUDASIM)


def tensor_device(kernels: str) -> torch.device:
    """Where the tensors of kernels for "cpu" or "cuda" lie: the simulator's lie in the host's memory."""
    return torch.device("cuda" if kernels == "cuda" and not is_simulated() else "cpu")


def to_kernel(tensor: torch.Tensor) -> Any:
    """A kernel's view of a tensor without gaps: what the kernel writes, the tensor holds."""
    tensor = tensor.detach()
    assert tensor.is_contiguous()
    if not tensor.numel():
        tensor = tensor.new_zeros((1,) * tensor.dim())  # an empty one has no address
    if not tensor.is_cuda:
        return tensor.numpy()
    from numba import cuda

    # Both use the default stream: what one has begun, the other waits for.
    return cuda.as_cuda_array(tensor, sync=False)


def blocks_of_threads(count: int) -> int:
    """How many blocks of `THREADS` threads give each of `count` primitives one; at least one, since no launch may be empty."""
    return max(1, -(-count // THREADS))
