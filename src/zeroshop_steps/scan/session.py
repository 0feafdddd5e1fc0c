"""A scan from its first view to its last: recording, the map of what was measured, and where to look next. It needs no ROS.

scan = Scan(ScanRecorder(folder, "our arm"), MeasuredSurface(box), ViewSphere(camera))
while not (advice := scan.propose(reach)).enough:
    drive_to(advice.proposals[0].move)  # your arm
    scan.record(rgb, depth_m, lens, world_from_camera)
"""

import numpy as np

from zeroshop_steps.capture.cameras_json import Lens
from zeroshop_steps.scan.next_views import Advice, propose
from zeroshop_steps.scan.pinhole_depth import flatten_depth, pinhole_camera
from zeroshop_steps.scan.reach import Reach
from zeroshop_steps.scan.recorder import RecordedView, ScanRecorder
from zeroshop_steps.scan.surface_map import SurfaceMap
from zeroshop_steps.scan.viewpoints import ViewSphere


class Scan:
    """Records views and proposes the next; views that the recorder's folder already has are taken into the map.

    Args:
        recorder: writes the views.
        surface: a new map.
        sphere: the viewpoints to choose from.
    """

    def __init__(self, recorder: ScanRecorder, surface: SurfaceMap, sphere: ViewSphere) -> None:
        self.recorder, self.surface, self.sphere = recorder, surface, sphere
        self._refused: list[np.ndarray] = []
        for view in recorder.views:
            self._add(view, recorder.read_depth_m(view))

    @property
    def views(self) -> list[RecordedView]:
        """All views so far."""
        return self.recorder.views

    def record(
        self, rgb: np.ndarray, depth_m: np.ndarray | None, lens: Lens, world_from_camera: np.ndarray, stamp_s: float | None = None
    ) -> RecordedView:
        """Record a view and take it into the map; for arguments and errors see `ScanRecorder.record`."""
        view = self.recorder.record(rgb, depth_m, lens, world_from_camera, stamp_s)
        self._add(view, self.recorder.read_depth_m(view))
        self._refused = []
        return view

    def propose(self, reach: Reach) -> Advice:
        """The next views, the best first, and whether it is enough."""
        taken = [view.world_from_camera for view in self.views]
        return propose(self.surface, self.sphere, reach, taken, self._refused)

    def refuse(self, world_from_camera: np.ndarray) -> None:
        """Note that a proposed view could not be taken: it is not proposed again before another one was recorded."""
        self._refused.append(world_from_camera)

    def _add(self, view: RecordedView, depth_m: np.ndarray | None) -> None:
        camera = pinhole_camera(view.lens, np.linalg.inv(view.world_from_camera), view.name)
        self.surface.add_view(camera, None if depth_m is None else flatten_depth(view.lens, depth_m))
