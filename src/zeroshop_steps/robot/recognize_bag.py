"""Detect objects in a recorded bag and estimate their poses, without any ROS, into a bag that Foxglove opens.

Reads bags of ROS 1 (.bag) and ROS 2 (a folder, or MCAP). Writes a folder with an MCAP file of ROS 2: images, camera, results, masks laid
over the images, boxes of the objects, and their frames. Needs the package rosbags.
"""

import argparse
import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from zeroshop_steps.robot.bags import RecognitionBag, read_requests
from zeroshop_steps.robot.object_store import ObjectStore
from zeroshop_steps.robot.prepared import add_recognizer_arguments, prepare_recognizers
from zeroshop_steps.robot.recognition import Recognition, RecognitionRequest
from zeroshop_steps.robot.recognizers import Recognizer
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_directory
from zeroshop_steps.runtime.progress import track


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_recognizer_arguments(parser)
    parser.add_argument("--bag", type=Path, required=True, help="recorded bag")
    parser.add_argument("--rgb-topic", required=True, help="topic of the colour images, sensor_msgs/Image")
    parser.add_argument("--depth-topic", required=True, help="topic of the depth images, aligned with them")
    parser.add_argument("--camera-info-topic", required=True, help="topic of the colour camera's matrix")
    parser.add_argument("--every", type=int, default=1, help="take every so many images (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")


def run(args: argparse.Namespace) -> None:
    """Recognize in every image that is taken."""
    if args.every < 1:
        raise StepError(f"--every is {args.every}; expected 1 or more: every image, every second one, and so on")
    requests = read_requests(args.bag, args.rgb_topic, args.depth_topic, args.camera_info_topic)
    taken = list(itertools.islice(requests, 0, None, args.every))
    if not taken:
        raise StepError(f"{args.bag} has no colour image with a depth image of its time on {args.rgb_topic} and {args.depth_topic}")
    store, recognizers = prepare_recognizers(args)
    detector, estimator = (_one_of(recognizers, kind) for kind in ("/object_detector/", "/pose_estimator/"))
    found = 0
    with atomic_directory(args.out) as folder:
        with RecognitionBag(folder / "bag", bounds_of(store)) as bag:
            for recorded in track(taken, "images", len(taken)):
                recognition = find_poses(recorded.request, detector, estimator)
                found += len(recognition.objects)
                bag.add(recorded, recognition)
        for path in (folder / "bag").iterdir():
            path.rename(folder / path.name)
        (folder / "bag").rmdir()
    print(f"{args.out}: {found} poses in {len(taken)} images")


def find_poses(request: RecognitionRequest, detector: Recognizer, estimator: Recognizer) -> Recognition:
    """The objects that the detector finds in an image, with the poses of the estimator; one that has none is left out with a remark."""
    found = detector.recognize(request)
    if not found.objects:
        return found
    names, masks = tuple(one.name for one in found.objects), tuple(one.mask for one in found.objects)
    asked = replace(request, class_names=names, masks=masks, confidences={one.name: one.confidence for one in found.objects})
    try:
        return estimator.recognize(asked)
    except StepError as error:
        return Recognition((), (str(error),))


def bounds_of(store: ObjectStore) -> Callable[[str], np.ndarray]:
    """Gives the (2, 3) lowest and highest corners of a model in mm by its name."""

    def bounds(name: str) -> np.ndarray:
        vertices = store.find(name).model.mesh.vertices
        return np.stack([vertices.min(0), vertices.max(0)])

    return bounds


def _one_of(recognizers: dict[str, Recognizer], kind: str) -> Recognizer:
    found = [name for name in recognizers if name.startswith(kind)]
    if len(found) != 1:
        raise StepError(
            f"name one method by {'--detectors' if 'detector' in kind else '--estimators'}; there are {', '.join(found) or 'none'}"
        )
    return recognizers[found[0]]
