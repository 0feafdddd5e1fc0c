"""Records the stops of an arm, view by view, as a capture with known cameras (docs/given-cameras.md).

A folder is a valid capture after each view, also where the process is killed: the photo, whose presence makes a view, is written last.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from zeroshop_steps.capture.cameras_json import FILE, GivenCamera, GivenCameras, Lens, check_pose, read_given_cameras
from zeroshop_steps.capture.frame_quality import MOST_EDGE_BLUR_PX, measure_edge_blur_px
from zeroshop_steps.capture.upright import make_upright
from zeroshop_steps.geometry.cameras.transforms import measure_turn_deg
from zeroshop_steps.geometry.imaging.depth_images import check_unit
from zeroshop_steps.geometry.imaging.image_files import list_folder
from zeroshop_steps.geometry.imaging.images import DEPTH_STEP_MM, read_depth_mm, write_depth_mm, write_image
from zeroshop_steps.geometry.meshes.units import MM_PER_M
from zeroshop_steps.runtime.errors import StepError, warn

FARTHEST_MM = DEPTH_STEP_MM * np.iinfo(np.uint16).max  # that 16 bits of this step hold; what is farther is none of the object
REST_S = 0.3  # so long the arm must have stood still: the time of a few images, and of an arm's last swing
REST_M, REST_DEG = 0.0005, 0.05  # by which the pose may change meanwhile: what tf of such arms wavers by
SAME_M, SAME_DEG = 0.003, 0.5  # a view nearer to an earlier one shows nothing new


@dataclass(frozen=True)
class RecordedView:
    """One view of a scan.

    Attributes:
        name: of its photo.
        lens: of the photo and of the depth.
        world_from_camera: (4, 4) m.
        has_depth: whether there is a depth image.
    """

    name: str
    lens: Lens
    world_from_camera: np.ndarray
    has_depth: bool


class ScanRecorder:
    """Writes a capture, one view after the other; a folder that has views is continued.

    Args:
        folder: the capture.
        source: what the poses come from, in words.
        position_deviation_m, rotation_deviation_deg: how exact the poses are, standard deviations; None where nobody knows.

    Raises:
        StepError: the folder holds photos that its cameras.json does not know.
    """

    def __init__(
        self, folder: Path, source: str, position_deviation_m: float | None = None, rotation_deviation_deg: float | None = None
    ) -> None:
        self.folder = Path(folder)
        self.cameras = GivenCameras({}, source, True, position_deviation_m, rotation_deviation_deg, None)
        self._watched: list[tuple[float, np.ndarray]] = []
        self.views: list[RecordedView] = self._resume()

    def watch(self, world_from_camera: np.ndarray, stamp_s: float) -> None:
        """Note where the camera is, as often as that is read: `record` then refuses views of an arm that has not come to rest."""
        self._watched = [(time_s, pose) for time_s, pose in self._watched if stamp_s - REST_S <= time_s <= stamp_s]
        self._watched.append((stamp_s, np.asarray(world_from_camera, float)))

    def record(
        self, rgb: np.ndarray, depth_m: np.ndarray | None, lens: Lens, world_from_camera: np.ndarray, stamp_s: float | None = None
    ) -> RecordedView:
        """Check a view and write it, turned by quarter turns so that the world's z is up.

        Args:
            rgb: (height, width, 3) uint8.
            depth_m: (height, width) along the optical axis, aligned with `rgb`; 0 or not finite where nothing was measured.
            lens: of both.
            world_from_camera: (4, 4) m, OpenCV's axes.
            stamp_s: when it was taken, on the clock of `watch`.

        Raises:
            StepError: a shape, size or type is wrong, the pose is no rigid motion, the arm moves, the photo is blurred, or it is the
                same view as an earlier one. Nothing is written then.
        """
        pose = self._check_pose(world_from_camera)
        depth_mm = _check_images(rgb, depth_m, lens)
        self._check_rest(pose, stamp_s)
        self._check_new(pose)
        blur_px = measure_edge_blur_px(rgb)
        if blur_px > MOST_EDGE_BLUR_PX:
            raise StepError(
                f"the photo is blurred: even its sharpest edges are smeared by {blur_px:.1f} px, of an image 960 px wide; expected up to"
                f" {MOST_EDGE_BLUR_PX:g}: wait until the arm stands still, focus, or use more light"
            )
        turns, lens, pose = make_upright(lens, pose)
        name = f"{self._last_number() + 1:04d}.png"
        if depth_mm is not None:
            write_depth_mm(self.folder / "depth" / name, np.rot90(depth_mm, turns))
        step_mm = DEPTH_STEP_MM if depth_mm is not None else self.cameras.depth_step_mm
        cameras = {**self.cameras.images, name: GivenCamera(lens, np.linalg.inv(pose))}
        self.cameras = replace(self.cameras, images=cameras, depth_step_mm=step_mm)
        self.cameras.write(self.folder / FILE)
        write_image(self.folder / "images" / name, np.rot90(rgb, turns))
        view = RecordedView(name, lens, pose, depth_mm is not None)
        self.views.append(view)
        return view

    def read_depth_m(self, view: RecordedView) -> np.ndarray | None:
        """(height, width) float32 of a recorded view, 0 where nothing was measured; None without depth."""
        return read_depth_mm(self.folder / "depth" / view.name) / np.float32(MM_PER_M) if view.has_depth else None

    def _resume(self) -> list[RecordedView]:
        photos = {path.name for path in list_folder(self.folder / "images")} if (self.folder / "images").is_dir() else set()
        known = read_given_cameras(self.folder / FILE) if (self.folder / FILE).is_file() else None
        entries = dict(known.images) if known else {}
        if strange := sorted(photos - set(entries)):
            raise StepError(
                f"{self.folder} holds {len(strange)} photos that its {FILE} does not know, such as {strange[0]}: it is another capture;"
                " name a new folder"
            )
        depths = list_folder(self.folder / "depth") if (self.folder / "depth").is_dir() else []
        for depth in depths:
            if depth.name not in photos:
                depth.unlink()  # of a view that was not finished
        if known is None:
            return []
        if len(entries) > len(photos):
            warn(f"{self.folder}: the last view was not finished, and is taken anew")
        kept = {name: one for name, one in entries.items() if name in photos}
        measured = {depth.name for depth in depths}
        views = [
            RecordedView(name, one.lens, np.linalg.inv(one.camera_from_world), name in measured)
            for name, one in kept.items()
            if one.camera_from_world is not None
        ]
        step_mm = known.depth_step_mm
        if step_mm is not None and not np.isclose(step_mm, DEPTH_STEP_MM):
            raise StepError(f"{self.folder / FILE} has depth_step_mm {step_mm:g}, scans have {DEPTH_STEP_MM:g}; name a new folder")
        self.cameras = replace(self.cameras, images=kept, depth_step_mm=step_mm)
        return views

    def _last_number(self) -> int:
        return max((int(Path(name).stem) for name in self.cameras.images if Path(name).stem.isdecimal()), default=0)

    def _check_pose(self, world_from_camera: np.ndarray) -> np.ndarray:
        pose = np.asarray(world_from_camera, float)
        if pose.shape != (4, 4):
            raise StepError(f"the camera's pose has the shape {pose.shape}; expected a (4, 4) world_from_camera in metres")
        if not np.isfinite(pose).all():
            raise StepError("the camera's pose holds NaN or infinity: tf lost the camera; expected finite numbers in metres")
        return check_pose(pose, "the camera's pose")

    def _check_rest(self, pose: np.ndarray, stamp_s: float | None) -> None:
        watched = [one for time_s, one in self._watched if stamp_s is None or stamp_s - REST_S <= time_s <= stamp_s + REST_S]
        for one in watched:
            shift_m, turn_deg = _difference(one, pose)
            if shift_m > REST_M or turn_deg > REST_DEG:
                raise StepError(
                    f"the arm is not at rest: within {REST_S:g} s the camera moved by {shift_m * MM_PER_M:.1f} mm and {turn_deg:.2f}"
                    f" degrees; expected up to {REST_M * MM_PER_M:g} mm and {REST_DEG:g} degrees: wait, and record again"
                )

    def _check_new(self, pose: np.ndarray) -> None:
        for view in self.views:
            shift_m, turn_deg = _difference(view.world_from_camera, pose)
            if shift_m < SAME_M and turn_deg < SAME_DEG:
                raise StepError(
                    f"this is the view of {view.name} again, {shift_m * MM_PER_M:.1f} mm and {turn_deg:.1f} degrees from it: move the arm"
                    " to another view"
                )


def _check_images(rgb: np.ndarray, depth_m: np.ndarray | None, lens: Lens) -> np.ndarray | None:
    """(height, width) float64 depth in mm, 0 where nothing was measured. Raises StepError for images that do not fit the lens."""
    expected = (lens.height_px, lens.width_px)
    if not isinstance(rgb, np.ndarray) or rgb.dtype != np.uint8 or rgb.shape != (*expected, 3):
        found = f"{rgb.dtype} of the shape {rgb.shape}" if isinstance(rgb, np.ndarray) else type(rgb).__name__
        raise StepError(f"the photo is {found}; expected uint8 of the shape {(*expected, 3)}, as the lens says")
    if depth_m is None:
        return None
    if depth_m.shape != expected:
        raise StepError(f"depth has the shape {depth_m.shape}, the photo {expected}; expected depth that is aligned with the photo")
    measured = np.isfinite(depth_m) & (depth_m > 0)
    if not measured.any():
        raise StepError("the depth image is empty: no pixel was measured; is the camera too near, or is its depth stream off?")
    depth_mm = np.where(measured, depth_m, 0.0).astype(float) * MM_PER_M
    check_unit(depth_mm, "the depth image", "give metres")
    return np.where(depth_mm <= FARTHEST_MM, depth_mm, 0.0)


def _difference(one: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """Shift in metres and turn in degrees between two poses."""
    return float(np.linalg.norm(one[:3, 3] - other[:3, 3])), measure_turn_deg(one[:3, :3], other[:3, :3])
