"""How exact depth cameras are, by kind.

Depth from disparity (structured light, stereo) errs with the square of the distance, time of flight hardly with it, and at edges all mix
near and far.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class NoiseModel:
    """Standard deviation of a camera's depth: floor_mm + growth_per_mm * depth^2, and at edges what the depth changes in a blur.

    Attributes:
        blur_widths: how far off the place of a depth may be, as a share of the image's width: about a pixel of the camera's own.
    """

    floor_mm: float
    growth_per_mm: float
    blur_widths: float

    def deviation_mm(self, depth_mm: np.ndarray, slope_mm: np.ndarray, width_px: int) -> np.ndarray:
        """The deviations of depths, mm; slope_mm: by how much the depth changes from pixel to pixel."""
        return np.hypot(self.floor_mm + self.growth_per_mm * depth_mm**2, self.blur_widths * width_px * slope_mm)


NOISE = {
    "structured_light": NoiseModel(0.5, 1.5e-6, 0.5 / 640),
    "stereo": NoiseModel(0.5, 3.8e-6, 2.0 / 848),
    "tof": NoiseModel(3.0, 1.0e-6, 1.0 / 512),
    "lidar": NoiseModel(10.0, 0.0, 1.0 / 192),
}
"""By kind: a Kinect (Khoshelham and Elberink 2012; Barron and Malik 2013); a stereo camera with a base of 50 mm, a focal length of 420 px
and a matching error of 0.08 px; an Azure Kinect (Kurillo et al. 2022); a phone's LiDAR (Luetzenburg et al. 2021)."""
