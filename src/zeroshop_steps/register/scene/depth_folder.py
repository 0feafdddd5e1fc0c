"""Depth images that come with the photos: 16-bit PNG of the photos' size, named like them and aligned pixel by pixel, 0 where unknown.

They give the scale and measure surface. What is wrong with all of them is said here: another unit, or not aligned.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from zeroshop_steps.capture.cameras_json import FILE, read_given_cameras
from zeroshop_steps.geometry.alignment.robust_estimates import robust_deviation
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.imaging.depth_images import check_unit, depth_to_mm
from zeroshop_steps.geometry.imaging.image_files import check_kind
from zeroshop_steps.geometry.imaging.images import decode_image
from zeroshop_steps.register.scene.record import find_lens
from zeroshop_steps.register.scene.undistortion import undistort_by_lens
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json

USUAL_MM = 50.0, 5000.0  # from the object; nearer no depth camera measures, and farther nobody holds one
OFF_DIAGONALS = 0.15  # a pixel whose depth is this far off, in diagonals of the object, shows something else
MOST_OFF = 0.15  # share of such pixels from which on the images are not aligned


@dataclass(frozen=True)
class DepthFolder:
    """The depth images of a capture, or of the passes of an object.

    Attributes:
        folder: in which they lie; of the first pass that has some.
        files: the depth image of each photo that has one, by the stem of the registered view's name.
        steps_mm: by the number of the pass, millimetres a step.
        lenses: the registration's record, which has the lens of each photo.
    """

    folder: Path
    files: Mapping[str, Path]
    steps_mm: Mapping[int, float]
    lenses: Mapping[str, Any]

    @staticmethod
    def find(folders: Mapping[int, Path], views: Sequence[View], cameras: Path, capture: Path, step_mm: float) -> "DepthFolder":
        """The images of registered views, named like the user's photos.

        Args:
            folders: by the number of the pass, which is 1 where there is one.
            cameras, capture: folders of the registration and of the capture, of all passes.
            step_mm: unless the cameras.json beside a folder says it.

        Raises:
            StepError: there is no such folder, the step is out of range, or the capture comes from a video.
        """
        if not 1e-3 <= step_mm <= 100.0:
            raise StepError(
                f"a step of the depth images is {step_mm:g} mm; 0.001 to 100 are possible, 1 is usual (height.depth_camera.step_mm)"
            )
        files: dict[str, Path] = {}
        steps_mm = {}
        for number, folder in folders.items():
            if not folder.is_dir():
                raise StepError(f"the folder of depth images {folder} does not exist")
            beside = folder.parent / FILE
            steps_mm[number] = (read_given_cameras(beside).depth_step_mm if beside.is_file() else None) or step_mm
            files |= _find_files(folder, [view for view in views if view.pass_number == number], capture / "capture.json", number)
        record_path = cameras / "registration.json"
        record = read_json(record_path) if record_path.is_file() else {}
        return DepthFolder(next(iter(folders.values())), files, steps_mm, record)

    def read_mm(self, view: View) -> np.ndarray | None:
        """(height, width) float32 mm as the undistorted photo shows them, 0 where nothing was measured; None where there is no image.

        Raises:
            StepError: it is no depth image, or has not its photo's size.
        """
        stem = Path(view.camera.name).stem
        if stem not in self.files:
            return None
        lens = find_lens(dict(self.lenses), stem)
        size_px = (lens["width_px"], lens["height_px"]) if lens else (view.camera.width_px, view.camera.height_px)
        measured_mm = depth_to_mm(_read_steps(self.files[stem], size_px), self.steps_mm[view.pass_number], str(self.files[stem]))
        return undistort_by_lens(measured_mm, lens, cv2.INTER_NEAREST, cv2.BORDER_CONSTANT)

    def check_unit(self, view: View, median_mm: float) -> None:
        """Raise StepError where the object's median depth in an image is nothing that a camera measures."""
        what = f"{self.files[Path(view.camera.name).stem]}: the object's depth, at {self.steps_mm[view.pass_number]:g} mm a step,"
        remedy = "export millimetres, or give the unit as height.depth_camera.step_mm"
        check_unit(np.array([median_mm]), what, remedy, USUAL_MM)

    def agree(self, ratios: Mapping[str, float], off: Mapping[str, float]) -> tuple[float, float, float]:
        """What the images agree on: mm per unit of the registration, its spread as a share, and the median share of pixels that are off.

        Args:
            ratios: by the name of the view, mm per unit.
            off: share of the object's pixels that show something else, as `OFF_DIAGONALS` says.

        Raises:
            StepError: the images are not aligned with the photos.
        """
        values = np.array(list(ratios.values()))
        scale_mm = float(np.median(values))
        spread = robust_deviation(values / scale_mm - 1.0)
        share = float(np.median(list(off.values())))
        if share > MOST_OFF or spread > OFF_DIAGONALS:
            worst = max(off, key=lambda name: off[name])
            raise StepError(
                f"{self.folder}: the depth images are not aligned with the photos: {share:.0%} of the object's pixels show something else "
                f"({self.files[Path(worst).stem].name}: {off[worst]:.0%}), and their scales differ by {spread:.0%}; export depth that is"
                " aligned to the colour image"
            )
        return scale_mm, spread, share


def _find_files(folder: Path, views: Sequence[View], capture_record: Path, number: int) -> dict[str, Path]:
    """{stem of a view: its depth image} of the views of a pass."""
    facts = read_json(capture_record)
    facts = facts["sources_of_passes"][number - 1] if "sources_of_passes" in facts else facts
    if "source_frames" in facts:
        raise StepError(
            f"depth images belong to photos, and {capture_record.parent} comes from a video: export the colour images as photos"
        )
    names = facts.get("source_names")
    stems = {Path(view.camera.name).stem: view.own_stem for view in views}
    last = max(map(int, stems.values()), default=0) if names else 0
    if names and not (isinstance(names, list) and all(isinstance(name, str) for name in names) and last < len(names)):
        raise StepError(
            f"{capture_record}: source_names must list the user's photos, one for each image; delete the folder and run capture again"
        )
    found = {}
    for stem, own in stems.items():
        path = folder / f"{Path(names[int(own)]).stem if names else own}.png"
        if os.path.lexists(path):
            check_kind(path, "depth image")
            found[stem] = path
    return found


def _read_steps(path: Path, size_px: tuple[int, int]) -> np.ndarray:
    """(height, width) uint16 steps, of a photo of (width, height).

    Raises:
        StepError: it is no depth image, or not aligned with its photo.
    """
    depth = decode_image(path, cv2.IMREAD_UNCHANGED)
    if depth.ndim != 2 or depth.dtype != np.uint16:
        kind = f"{depth.dtype} with {1 if depth.ndim == 2 else depth.shape[2]} channel(s)"
        raise StepError(f"depth image {path} is {kind}; expected a 16-bit PNG with one channel, in millimetres")
    if depth.shape[::-1] != size_px:
        raise StepError(
            f"depth image {path} is {depth.shape[1]} x {depth.shape[0]} px, its photo {size_px[0]} x {size_px[1]} px: "
            "it is not aligned with the photo; export depth that is aligned to the colour image"
        )
    return depth
