"""Depth of cameras in whole numbers, also with rotated bits as in SUN3D and the Amazon Picking Challenge."""

from pathlib import Path

import numpy as np

from zeroshop_steps.runtime.errors import StepError, warn

USUAL_MM = 20.0, 30_000.0
"""Of what a depth camera sees in the median: no object stands nearer to one, and no room is deeper."""
ROTATED_BITS, BITS = 3, 16
"""SUN3D (Xiao et al., ICCV 2013) stores millimetres with their bits rotated to the left by 3, so that other programs show a picture."""
LEAST_DIFFERENT = 16  # values of an image that tells; fewer may be multiples of 8 by chance
DEPTH_CHANNELS = ("Z", "V")  # as Blender names them, after the layer
ROTATED_STEP_MM = 0.125  # a step that already makes millimetres of rotated bits


def depth_to_mm(raw: np.ndarray, step_mm: float, name: str) -> np.ndarray:
    """(height, width) float32 mm of a depth image.

    Where all numbers are multiples of 8, though a step is no eighth of a millimetre, the bits are rotated. That is said and undone.

    Args:
        raw: (height, width) of whole numbers, 0 where nothing was measured.
        step_mm: of one number.
        name: of the image, for the message.
    """
    if raw.dtype == np.uint16 and not np.isclose(step_mm, ROTATED_STEP_MM, rtol=0.01) and _is_rotated(raw):
        warn(f"{name}: all numbers are multiples of 8, so their bits are rotated by 3, as in SUN3D; they are turned back")
        raw = (raw >> ROTATED_BITS) | (raw << (BITS - ROTATED_BITS))
    return raw.astype(np.float32) * np.float32(step_mm)


def check_unit(depth_mm: np.ndarray, what: str, remedy: str, usual_mm: tuple[float, float] = USUAL_MM) -> np.ndarray:
    """The depth, unless the median of what was measured (above 0) is nothing that a camera sees: raises StepError for another unit."""
    median_mm = float(np.median(depth_mm[depth_mm > 0])) if (depth_mm > 0).any() else usual_mm[0]
    if not usual_mm[0] <= median_mm <= usual_mm[1]:
        unit = "metres, taken for millimetres" if median_mm < usual_mm[0] else "millimetres, taken for metres"
        found = f"{median_mm:.3g} mm in the median; expected {usual_mm[0]:g} to {usual_mm[1]:g}"
        raise StepError(f"{what} is {found}: it looks like {unit}; {remedy}")
    return depth_mm


def read_exr(path: Path) -> np.ndarray:
    """(height, width) float32 of an OpenEXR file's depth: its only channel, else Z or V, else that of a grey picture.

    Raises:
        StepError: it cannot be read, or several channels differ and none is called depth.
    """
    import OpenEXR

    try:
        with OpenEXR.File(str(path), separate_channels=True) as opened:
            channels = {name: channel.pixels.astype(np.float32) for name, channel in opened.channels().items()}
    except RuntimeError as error:
        raise StepError(f"depth {path} cannot be read as OpenEXR ({error}); export it again") from None
    named = [values for name, values in channels.items() if name.rpartition(".")[2].upper() in DEPTH_CHANNELS]
    values = named if len(named) == 1 else list(channels.values())
    if not values or any(not np.array_equal(values[0], other) for other in values[1:]):
        raise StepError(f"depth {path} has the channels {', '.join(channels) or 'none'}; expected one, or one called Z or V")
    return values[0]


def _is_rotated(raw: np.ndarray) -> bool:
    """Whether the lowest bits are never used; they hold what is beyond 8 m, which few cameras measure."""
    if (raw & ((1 << ROTATED_BITS) - 1)).any():
        return False
    return len(np.unique(raw[raw > 0])) >= LEAST_DIFFERENT
