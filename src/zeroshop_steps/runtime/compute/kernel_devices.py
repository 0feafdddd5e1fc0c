"""Which device the compiled kernels of stereo and of the optimizers run on. Networks choose theirs in networks/devices.py."""

from zeroshop_steps.runtime.errors import StepError

DEVICES = ("auto", "cpu", "cuda")
"""What a step may be told; auto is cuda where there is such a device. Networks take these names, too."""


def choose_kernel_device(device: str) -> str:
    """ "cpu" or "cuda" for one of cpu, cuda and auto, which is cuda where Numba finds a device.

    Raises:
        StepError: cuda is asked for and absent, or the name is unknown.
    """
    if device not in DEVICES:
        raise StepError(f"--device {device} is unknown; expected cpu, cuda or auto")
    found = device != "cpu" and has_cuda()
    if device == "cuda" and not found:
        raise StepError("--device cuda: Numba finds no CUDA device; install the extra `gpu` where there is one, or use --device cpu")
    return "cuda" if found else "cpu"


def has_cuda() -> bool:
    """Whether Numba finds a CUDA device and what it needs to compile for it."""
    from numba import cuda

    return bool(cuda.is_available())
