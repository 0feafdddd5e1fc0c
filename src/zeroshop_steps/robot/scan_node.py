"""A node of ROS that records a scan and says where to look next, without ROS: it takes messages, and answers services.

Poses are of the colour camera's optical frame in a base frame, by tf at the stamp of the image.
"""

import argparse
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.capture.adapters.ros_bag import read_camera_message
from zeroshop_steps.capture.adapters.tf_tree import TransformTree
from zeroshop_steps.capture.cameras_json import Lens
from zeroshop_steps.ros.bags import MOST_APART_NS, RECTIFIED, stamp_of
from zeroshop_steps.ros.image_messages import read_color, read_depth
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.scan.reach import Reach
from zeroshop_steps.scan.recorder import REST_S, ScanRecorder
from zeroshop_steps.scan.session import Scan
from zeroshop_steps.scan.setup import add_setup_arguments, make_reach, make_scan, make_surface

NODE = "zeroshop_scan"
KEPT_IMAGES = 10  # of each topic: a third of a second, in which partners and transforms come
KEPT_NS = 10_000_000_000  # of tf
FORGET_EVERY = 500  # messages of tf
STALE_S = 2.0  # an image that came longer ago is no answer to "now"
NS_PER_S = 1_000_000_000


@dataclass(frozen=True)
class Reply:
    """The answer of a service.

    Attributes:
        success: whether it did what it was asked for.
        message: what was done, or why not and what to do.
        base_from_camera: (4, 4) m of the proposed view; None without one.
    """

    success: bool
    message: str
    base_from_camera: np.ndarray | None = None


class ScanNode:
    """Takes messages in any thread; one service is answered at a time.

    Args:
        make_scan: makes the scan once the lens is known.
        reach: where the camera can be brought.
        base_frame: tf's frame that poses are in.
        topics: of `image`, `info` and `depth`, for messages; no depth is used without one.
    """

    def __init__(self, make_scan: Callable[[Lens], Scan], reach: Reach, base_frame: str, topics: dict[str, str]) -> None:
        self._make_scan, self._reach, self.base_frame, self.topics = make_scan, reach, base_frame.lstrip("/"), topics
        self._images: deque[tuple[float, Any]] = deque(maxlen=KEPT_IMAGES)
        self._depths: deque[Any] = deque(maxlen=KEPT_IMAGES)
        self._info: Any = None
        self._tree, self._transforms = TransformTree(), 0
        self._scan: Scan | None = None
        self._proposed: np.ndarray | None = None
        self._lock, self._turn = threading.Lock(), threading.Lock()

    def take_image(self, message: Any) -> None:
        """Take a sensor_msgs/Image or CompressedImage of colour."""
        with self._lock:
            self._images.append((time.monotonic(), message))

    def take_depth(self, message: Any) -> None:
        """Take a sensor_msgs/Image of depth, aligned with colour."""
        with self._lock:
            self._depths.append(message)

    def take_info(self, message: Any) -> None:
        """Take a sensor_msgs/CameraInfo of the colour camera."""
        with self._lock:
            self._info = message

    def take_transforms(self, message: Any, fixed: bool) -> None:
        """Take a tf2_msgs/TFMessage of /tf, or of /tf_static."""
        with self._lock:
            self._tree.add(message, fixed)
            self._transforms += 1
            if not fixed and self._transforms % FORGET_EVERY == 0 and message.transforms:
                self._tree.forget_before(stamp_of(message.transforms[0]) - KEPT_NS)

    def record(self) -> Reply:
        """Record the latest image, with depth and the camera's pose."""
        return self._answer(self._record)

    def next_view(self) -> Reply:
        """Propose a view. Asked again without a record between, it proposes another one: the former could not be reached."""
        return self._answer(self._next_view)

    def _answer(self, serve: Callable[[], Reply]) -> Reply:
        with self._turn:
            try:
                return serve()
            except StepError as error:
                return Reply(False, str(error))

    def _record(self) -> Reply:
        with self._lock:
            image, depth = self._choose_images()
            lens, photo = self._read_lens(image)
            self._tree.sort()
            frame, stamp_ns = image.header.frame_id.lstrip("/"), stamp_of(image)
            pose = self._look_up(frame, stamp_ns)
            history = [(stamp_ns - round(share * REST_S * NS_PER_S)) for share in (1.0, 0.5)]
            earlier = [(time_ns, self._find_pose(frame, time_ns)) for time_ns in history]
        scan = self._scan = self._scan or self._make_scan(lens)
        for time_ns, known in earlier:
            if known is not None:
                scan.recorder.watch(known, time_ns / NS_PER_S)
        depth_mm = None if depth is None else read_depth(depth)
        if depth is not None and depth_mm is None:
            raise StepError(f"the depth image on {self.topics['depth']} is empty; check that its topic sends images")
        view = scan.record(photo, None if depth_mm is None else depth_mm / np.float32(1000), lens, pose, stamp_ns / NS_PER_S)
        self._proposed = None
        return Reply(True, f"recorded {view.name} in {scan.recorder.folder}, view {len(scan.views)}")

    def _next_view(self) -> Reply:
        if self._scan is None:
            with self._lock:
                image, _ = self._choose_images()
                lens, _ = self._read_lens(image)
            self._scan = self._make_scan(lens)
        if self._proposed is not None:
            self._scan.refuse(self._proposed)
        advice = self._scan.propose(self._reach)
        self._proposed = None
        if advice.enough:
            return Reply(True, advice.reason)
        if not advice.proposals:
            return Reply(False, f"no view that can be reached adds anything; {advice.reason}: bring the camera there by hand, and record")
        self._proposed = advice.proposals[0].move.world_from_camera
        return Reply(True, advice.reason, self._proposed)

    def _choose_images(self) -> tuple[Any, Any]:
        """The newest image, and the depth of its time."""
        if not self._images:
            raise StepError(f"no image has come on {self.topics['image']}; check the topic with `topic hz`")
        came_s, newest = self._images[-1]
        if time.monotonic() - came_s > STALE_S:
            raise StepError(
                f"the last image on {self.topics['image']} came {time.monotonic() - came_s:.0f} s ago; does the camera still run?"
            )
        if not self.topics.get("depth"):
            return newest, None
        for _, image in reversed(self._images):
            for depth in reversed(self._depths):
                if abs(stamp_of(depth) - stamp_of(image)) <= MOST_APART_NS:
                    self._require_aligned(depth, image)
                    return image, depth
        raise StepError(
            f"no depth on {self.topics['depth']} within {MOST_APART_NS / 1e6:g} ms of an image; check the topic, or leave it out and give"
            " --without-depth"
        )

    def _require_aligned(self, depth: Any, image: Any) -> None:
        if depth.header.frame_id.lstrip("/") != image.header.frame_id.lstrip("/"):
            raise StepError(
                f"depth on {self.topics['depth']} is of the frame {depth.header.frame_id!r}, the image of {image.header.frame_id!r}; take"
                " the topic of depth that is aligned to colour, such as aligned_depth_to_color"
            )

    def _read_lens(self, image: Any) -> tuple[Lens, np.ndarray]:
        if self._info is None:
            raise StepError(f"no camera message has come on {self.topics['info']}; check the topic")
        photo = read_color(image)
        rectified = RECTIFIED in self.topics["image"].rpartition("/")[2]
        return read_camera_message(self._info, (photo.shape[1], photo.shape[0]), rectified, self.topics["info"]), photo

    def _look_up(self, frame: str, stamp_ns: int) -> np.ndarray:
        """(4, 4) base_from_camera at a time."""
        if not self._tree.find_chain(frame):
            raise StepError(f"tf does not know the camera's frame {frame!r}; publish its place on the hand (static_transform_publisher)")
        if not self._knows(self.base_frame):
            raise StepError(f"tf does not know the base frame {self.base_frame!r}; name another with --base-frame")
        pose = self._find_pose(frame, stamp_ns)
        if pose is None:
            span_ns = self._tree.find_span_ns(frame)
            known = f"it knows it from {span_ns[0] / NS_PER_S:.2f} to {span_ns[1] / NS_PER_S:.2f} s" if span_ns else "it does not say where"
            raise StepError(
                f"tf does not know {frame!r} at the image's time, {stamp_ns / NS_PER_S:.2f} s; {known}: if the clocks differ, synchronize"
                " them (chrony, use_sim_time)"
            )
        return pose

    def _find_pose(self, frame: str, time_ns: int) -> np.ndarray | None:
        root_from_camera = self._tree.look_up(frame, time_ns)
        if root_from_camera is None:
            return None
        if not self._tree.find_chain(self.base_frame):
            return root_from_camera  # the base is the root
        root_from_base = self._tree.look_up(self.base_frame, time_ns)
        return None if root_from_base is None else np.linalg.inv(root_from_base) @ root_from_camera

    def _knows(self, frame: str) -> bool:
        return bool(self._tree.find_chain(frame)) or self._tree.is_parent(frame)


def add_scan_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of a node, for ROS 1 and ROS 2."""
    parser.add_argument("--image-topic", required=True, help="sensor_msgs/Image of colour")
    parser.add_argument("--camera-info-topic", required=True, help="of the same camera")
    parser.add_argument("--depth-topic", help="sensor_msgs/Image of depth, aligned to colour")
    parser.add_argument("--base-frame", default="base", help="tf's frame that --box is in; of UR arms, `base` (default: %(default)s)")
    parser.add_argument("--position-deviation", type=float, help="how exact the poses are, metres (default: not known)")
    parser.add_argument("--rotation-deviation", type=float, help="the same, degrees")
    add_setup_arguments(parser)
    parser.add_argument("--out", type=Path, required=True, help="capture folder to write")


def make_node(args: argparse.Namespace) -> ScanNode:
    """The node without ROS. Raises StepError for options that contradict, and for a folder that is another capture."""
    if bool(args.depth_topic) == args.without_depth:
        raise StepError("give either --depth-topic, or --without-depth: then views are planned by the box alone")
    make_surface(args)  # so that options out of range are told of now
    recorder = ScanRecorder(args.out, f"tf of {args.base_frame}", args.position_deviation, args.rotation_deviation)

    def scan_with(lens: Lens) -> Scan:
        return make_scan(args, recorder, lens)

    topics = {"image": args.image_topic, "info": args.camera_info_topic, "depth": args.depth_topic or ""}
    return ScanNode(scan_with, make_reach(args), args.base_frame, topics)


def write_pose_stamped(make: Any, base_from_camera: np.ndarray, frame: str) -> Any:
    """A geometry_msgs/PoseStamped of a camera's optical frame; its stamp is left as it is."""
    message = make()
    message.header.frame_id = frame
    place, turn = message.pose.position, message.pose.orientation
    place.x, place.y, place.z = base_from_camera[:3, 3].tolist()
    turn.x, turn.y, turn.z, turn.w = Rotation.from_matrix(base_from_camera[:3, :3]).as_quat().tolist()
    return message
