"""Recordings of ROS 1 (.bag) and ROS 2 (.mcap, or a bag's folder): colour, the camera's message, its way by tf, and aligned depth.

Frames are chosen as in a film: the sharpest of each stretch of the view's change, more of them where neighbours share little.
"""

import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.capture.adapters.form import Adapter, GivenFrame, ImportedCapture, ImportOptions
from zeroshop_steps.capture.adapters.tf_tree import TransformTree
from zeroshop_steps.capture.bridging import bridge_gaps
from zeroshop_steps.capture.cameras_json import Lens
from zeroshop_steps.capture.upright import make_upright
from zeroshop_steps.capture.video import FRAMES, MOST_FRAMES, choose_frames, measure_frames
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.ros.bags import MOST_APART_NS, RECTIFIED, require_rosbags, stamp_of
from zeroshop_steps.ros.camera_info import FISHEYE, choose_matrix, read_matrices
from zeroshop_steps.ros.compressed_images import is_compressed
from zeroshop_steps.ros.image_messages import DEPTHS, read_color, read_depth
from zeroshop_steps.runtime.errors import StepError

IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
INFO, TRANSFORMS = "sensor_msgs/msg/CameraInfo", ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
FIXED = "tf_static"
PLUGINS = ("/compressed", "/compressedDepth")  # ends of the topics of image_transport
LEAST_KNOWN = 0.5  # share of the images at whose times tf must know the camera
STILL_M, STILL_TURN = 0.001, 0.001  # a camera that moves and turns by no more, in matrix entries, stands still


@dataclass(frozen=True)
class Stream:
    """Images of one topic, as its first message has them.

    Attributes:
        topic: its name.
        is_depth: whether they are depth.
        is_grey: whether they are pictures without colour, such as those of an infrared camera.
        size_px: (width, height).
        frame_id: of the camera.
        count: how many there are.
    """

    topic: str
    is_depth: bool
    is_grey: bool
    size_px: tuple[int, int]
    frame_id: str
    count: int


class Recording:
    """A bag that is open for reading."""

    def __init__(self, reader: Any) -> None:
        self._reader = reader
        self.types = {one.topic: one.msgtype for one in reader.connections}
        self.counts = {topic: reader.topics[topic].msgcount for topic in self.types}

    def read(self, *topics: str) -> Iterator[tuple[str, Any]]:
        """The messages of some topics in their order."""
        for connection, _, raw in self._reader.messages([one for one in self._reader.connections if one.topic in topics]):
            yield connection.topic, self._reader.deserialize(raw, connection.msgtype)

    def first(self, topic: str) -> Any:
        """The first message of a topic."""
        return next(message for _, message in self.read(topic))

    def list_streams(self) -> list[Stream]:
        """All topics with images."""
        found = []
        for topic in sorted(topic for topic, kind in self.types.items() if kind in IMAGES and self.counts[topic]):
            message = self.first(topic)
            if is_compressed(message):
                is_depth = "compressedDepth" in message.format or message.format.startswith(tuple(DEPTHS))
            else:
                is_depth = message.encoding in DEPTHS and (message.encoding != "mono16" or "depth" in topic)
            image = read_depth(message) if is_depth else read_color(message)
            if image is not None:
                is_grey = not is_depth and not np.ptp(image, axis=2).any()
                size_px, frame_id = (image.shape[1], image.shape[0]), message.header.frame_id.lstrip("/")
                found.append(Stream(topic, is_depth, is_grey, size_px, frame_id, self.counts[topic]))
        return found

    def find_info(self, stream: Stream) -> str | None:
        """The topic of the camera's message that lies beside that of its images."""
        topic = stream.topic
        for plugin in PLUGINS:
            topic = topic.removesuffix(plugin)
        beside = f"{topic.rpartition('/')[0]}/camera_info"
        return beside if self.types.get(beside) == INFO and self.counts[beside] else None

    def read_transforms(self) -> TransformTree:
        """All of tf."""
        tree = TransformTree()
        for topic, message in self.read(*(topic for topic, kind in self.types.items() if kind in TRANSFORMS)):
            tree.add(message, topic.endswith(FIXED))
        tree.sort()
        return tree


def recognizes(path: Path) -> bool:
    """Whether a file or folder is a bag."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() and any(any(path.glob(f"*.{end}")) for end in ("mcap", "db3"))
    return path.is_file() and path.suffix.lower() in (".bag", ".mcap")


def read(path: Path, options: ImportOptions) -> ImportedCapture:
    """The chosen frames, with poses where tf knows the camera, and depth where it is aligned.

    Raises:
        StepError: the bag cannot be read, has no colour images with a camera's message, or tf and images have different clocks.
    """
    require_rosbags()
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_typestore

    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            return _read(Recording(reader), path, options)
    except (AnyReaderError, OSError, ValueError) as error:
        raise StepError(
            f"the bag {path} cannot be read: {error}; record it again, or repair it (ros2 bag reindex, rosbag reindex)"
        ) from None


def _read(recording: Recording, path: Path, options: ImportOptions) -> ImportedCapture:
    streams = recording.list_streams()
    color, info = _choose_color(recording, streams, path, options.topic)
    lens = read_camera_message(recording.first(info), color.size_px, RECTIFIED in color.topic.rpartition("/")[2], info)
    tree, said = recording.read_transforms(), list[str]()
    depth, remark = _choose_depth(streams, color)
    said += [remark] if remark else []

    stamps_ns: dict[int, int] = {}

    def all_images() -> Iterator[np.ndarray]:
        for number, (_, message) in enumerate(recording.read(color.topic)):
            stamps_ns[number] = stamp_of(message)
            yield read_color(message)

    def images(numbers: Iterable[int]) -> Iterator[tuple[int, np.ndarray]]:
        wanted = set(numbers)
        if wanted:
            yield from (
                (number, read_color(message)) for number, (_, message) in enumerate(recording.read(color.topic)) if number in wanted
            )

    scan = measure_frames(all_images())
    chosen = bridge_gaps(images, choose_frames(scan, FRAMES), scan.find_between, MOST_FRAMES)
    poses = _find_poses(tree, color, stamps_ns, path, said)
    unpacked = tempfile.TemporaryDirectory(prefix="zeroshop_bag_")
    folder, depths = Path(unpacked.name), list(_match_depth(recording, depth, [stamps_ns[number] for number in chosen]))
    if depth and 2 * len(depths) < len(chosen):
        said.append(
            f"only {len(depths)} of {len(chosen)} images have depth on {depth.topic} within {MOST_APART_NS / 1e6:g} ms: if the clocks of"
            " both differ, synchronize them (hardware trigger, use_sim_time) and record again"
        )
    views = [_turn(lens, poses[number]) for number in chosen]
    for index, measured in depths:
        np.save(folder / f"{index:06d}.npy", np.rot90(measured, views[index][0]))
    frames = []
    for index, (_, image) in enumerate(images(chosen)):
        turns, turned, pose = views[index]
        place = folder / f"{index:06d}.png"
        write_image(place, np.rot90(image, turns))
        measured_file = place.with_suffix(".npy")
        frames.append(GivenFrame(place, turned, pose, None, measured_file if measured_file.is_file() else None))
    return ImportedCapture(frames, f"{color.count} images on {color.topic} of the bag {path.name}", 1.0, tuple(said), unpacked)


def _turn(lens: Lens, camera_from_root: np.ndarray | None) -> tuple[int, Lens, np.ndarray | None]:
    """Quarter turns until z is up, as in all of ROS (REP 103), for `np.rot90`; the lens and the pose after them."""
    if camera_from_root is None:
        return 0, lens, None
    turns, turned, root_from_camera = make_upright(lens, np.linalg.inv(camera_from_root))
    return turns, turned, np.linalg.inv(root_from_camera)


def _choose_color(recording: Recording, streams: list[Stream], path: Path, wanted: str | None) -> tuple[Stream, str]:
    """The colour images that are taken, and the topic of their camera's message: of several, coloured ones with most pixels."""
    colors = [stream for stream in streams if not stream.is_depth]
    listed = ", ".join(f"{stream.topic} ({stream.count} images)" for stream in colors) or "none"
    if wanted is not None and (colors := [stream for stream in colors if stream.topic == wanted]) == []:
        raise StepError(f"the bag {path} has no colour images on {wanted}; it has {listed}")
    calibrated = [(stream, info) for stream in colors if (info := recording.find_info(stream))]
    if not calibrated:
        raise StepError(
            f"the bag {path} has no colour images with a sensor_msgs/CameraInfo on camera_info beside them; colour images: {listed}."
            " Record the topic camera_info, too, or give the images alone, as a folder"
        )
    return max(calibrated, key=lambda one: (not one[0].is_grey, one[0].size_px[0] * one[0].size_px[1], one[0].count))


def _choose_depth(streams: list[Stream], color: Stream) -> tuple[Stream | None, str]:
    """The depth of the colour camera's own pixels, and what the user must know."""
    depths = [stream for stream in streams if stream.is_depth]
    aligned = [stream for stream in depths if stream.size_px == color.size_px and stream.frame_id == color.frame_id]
    if aligned:
        return max(aligned, key=lambda stream: stream.count), ""
    if not depths:
        return None, ""
    named = ", ".join(stream.topic for stream in depths)
    return None, f"depth on {named} is of another camera than {color.topic}, and left out; record depth that is aligned to colour"


def _find_poses(tree: TransformTree, color: Stream, stamps_ns: dict[int, int], path: Path, said: list[str]) -> dict[int, np.ndarray | None]:
    """(4, 4) camera_from_root of the images, None where tf does not know it; adds to what is said."""
    if not tree.find_chain(color.frame_id):
        said.append(f"tf does not know the camera's frame {color.frame_id!r}: cameras are estimated")
        return dict.fromkeys(stamps_ns)
    found = {number: tree.look_up(color.frame_id, stamp_ns) for number, stamp_ns in stamps_ns.items()}
    known = np.array([pose for pose in found.values() if pose is not None])
    span_ns = tree.find_span_ns(color.frame_id)
    if len(known) < LEAST_KNOWN * len(found) and span_ns:
        first_s, last_s = (edge(stamps_ns.values()) / 1e9 for edge in (min, max))
        raise StepError(
            f"the bag {path}: images were taken from {first_s:.1f} to {last_s:.1f} s, tf knows the camera from {span_ns[0] / 1e9:.1f} to"
            f" {span_ns[1] / 1e9:.1f} s, at the times of {len(known)} of {len(found)} images: two clocks."
            " Synchronize them (chrony, use_sim_time) and record again, or record without /tf"
        )
    if len(known) < len(found):
        said.append(f"tf knows the camera at the times of {len(known)} of {len(found)} images; the poses of the others count as unknown")
    spread = np.ptp(known, axis=0)
    if spread[:3, 3].max() <= STILL_M and spread[:3, :3].max() <= STILL_TURN:
        said.append(f"the camera's frame {color.frame_id!r} does not move in tf: cameras are estimated")
        return dict.fromkeys(stamps_ns)
    return {number: None if pose is None else np.linalg.inv(pose) for number, pose in found.items()}


def _match_depth(recording: Recording, depth: Stream | None, stamps_ns: list[int]) -> Iterator[tuple[int, np.ndarray]]:
    """(height, width) float32 mm of the images of these times that have one of their own time, with their places in the list."""
    if depth is None:
        return
    times = np.array([stamp_of(message) for _, message in recording.read(depth.topic)])
    nearest = {int(np.abs(times - stamp_ns).argmin()): index for index, stamp_ns in enumerate(stamps_ns)}
    for number, (_, message) in enumerate(recording.read(depth.topic)):
        if number in nearest and abs(int(times[number]) - stamps_ns[nearest[number]]) <= MOST_APART_NS:
            measured = read_depth(message)
            if measured is not None:
                yield nearest[number], measured


def read_camera_message(message: Any, size_px: tuple[int, int], rectified: bool, topic: str) -> Lens:
    """The lens of a sensor_msgs/CameraInfo, of ROS 1 or ROS 2, by COLMAP's models.

    Raises:
        StepError: it is of another image size, was never calibrated, or has a distortion that COLMAP's models lack.
    """
    distortion = read_matrices(message)[2]
    matrix = choose_matrix(message, size_px, rectified, topic, "calibrate the camera, and record again")
    lens = Lens.pinhole(matrix, size_px, 0.5)
    if rectified or not distortion.any():
        return lens
    if message.distortion_model in FISHEYE and len(distortion) == 4:
        return Lens("OPENCV_FISHEYE", *size_px, (*lens.params, *distortion.tolist()))
    if (
        message.distortion_model not in ("", "plumb_bob", "rational_polynomial")
        or distortion[8:].any()
        or not np.isfinite(distortion).all()
    ):
        raise StepError(
            f"{topic} has the distortion {message.distortion_model!r} with {len(distortion)} coefficients, which COLMAP's lenses lack:"
            " record rectified images (image_proc)"
        )
    radial = np.zeros(8)
    radial[: min(len(distortion), 8)] = distortion[:8]
    return (
        Lens("FULL_OPENCV", *size_px, (*lens.params, *radial.tolist()))
        if radial[4:].any()
        else Lens("OPENCV", *size_px, (*lens.params, *radial[:4].tolist()))
    )


ADAPTER = Adapter("a bag of ROS", "a .bag or .mcap file, or a bag's folder with metadata.yaml", recognizes, read, 1)
