"""Where frames of ROS's tf are: each has a parent, and transforms to it that are fixed or recorded at times."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from zeroshop_steps.ros.bags import stamp_of

REACH_NS = 100_000_000  # before its first and after its last transform, a frame counts as unmoved


@dataclass
class Link:
    """From a frame to its parent: (4, 4) transforms parent_from_child in metres by their times in ns; a fixed one has the time None."""

    parent: str
    fixed: np.ndarray | None = None
    times_ns: list[int] = field(default_factory=list)
    transforms: list[np.ndarray] = field(default_factory=list)

    def find(self, time_ns: int) -> np.ndarray | None:
        """(4, 4) at a time: rotations interpolated on the sphere, places along a line; None outside the times that are known."""
        if self.fixed is not None:
            return self.fixed
        times = np.array(self.times_ns)
        if not times[0] - REACH_NS <= time_ns <= times[-1] + REACH_NS:
            return None
        after = int(np.clip(np.searchsorted(times, time_ns), 1, max(len(times) - 1, 1)))
        if len(times) == 1:
            return self.transforms[0]
        share = float(np.clip((time_ns - times[after - 1]) / max(times[after] - times[after - 1], 1), 0.0, 1.0))
        ends = np.array(self.transforms[after - 1 : after + 1])
        pose = np.eye(4)
        pose[:3, :3] = Slerp([0.0, 1.0], Rotation.from_matrix(ends[:, :3, :3]))(share).as_matrix()
        pose[:3, 3] = (1 - share) * ends[0, :3, 3] + share * ends[1, :3, 3]
        return pose


class TransformTree:
    """What a recording says of its frames."""

    def __init__(self) -> None:
        self._links: dict[str, Link] = {}

    def add(self, message: object, fixed: bool) -> None:
        """Take a tf2_msgs/TFMessage; of a frame with several parents, the last counts."""
        for one in message.transforms:  # type: ignore[attr-defined]
            child, parent = one.child_frame_id.lstrip("/"), one.header.frame_id.lstrip("/")
            turn, place = one.transform.rotation, one.transform.translation
            pose = np.eye(4)
            pose[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
            pose[:3, 3] = place.x, place.y, place.z
            if child not in self._links or self._links[child].parent != parent:
                self._links[child] = Link(parent)
            link = self._links[child]
            if fixed:
                link.fixed = pose
            else:
                link.times_ns.append(stamp_of(one))
                link.transforms.append(pose)

    def sort(self) -> None:
        """Bring the transforms of each frame into the order of their times; once all were added."""
        for link in self._links.values():
            order = np.argsort(link.times_ns, kind="stable")
            link.times_ns = [link.times_ns[index] for index in order]
            link.transforms = [link.transforms[index] for index in order]

    def forget_before(self, time_ns: int) -> None:
        """Drop older transforms, but for the last of each frame."""
        self.sort()
        for link in self._links.values():
            kept = max(0, min(int(np.searchsorted(link.times_ns, time_ns)), len(link.times_ns) - 1))
            link.times_ns, link.transforms = link.times_ns[kept:], link.transforms[kept:]

    def is_parent(self, frame: str) -> bool:
        """Whether other frames are placed in a frame."""
        return any(link.parent == frame for link in self._links.values())

    def find_chain(self, frame: str) -> list[Link]:
        """The links from a frame up to the root of its tree; none where the frame is not known."""
        chain, seen = [], set()
        while frame in self._links and frame not in seen:
            seen.add(frame)
            chain.append(self._links[frame])
            frame = self._links[frame].parent
        return chain

    def look_up(self, frame: str, time_ns: int) -> np.ndarray | None:
        """(4, 4) root_from_frame in metres at a time; None where a link of its chain is not known then, or the frame not at all."""
        chain = self.find_chain(frame)
        pose = np.eye(4)
        for link in chain:
            step = link.find(time_ns)
            if step is None:
                return None
            pose = step @ pose
        return pose if chain else None

    def find_span_ns(self, frame: str) -> tuple[int, int] | None:
        """First and last time at which all moving links of a frame's chain are known; None where nothing in it moves."""
        moving = [link.times_ns for link in self.find_chain(frame) if link.fixed is None]
        return (max(times[0] for times in moving), min(times[-1] for times in moving)) if moving else None
