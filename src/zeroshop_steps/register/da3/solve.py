"""From images to a registration: predict; refine by matches, or take what confident depths confirm; check; undistort."""

import argparse
from collections.abc import Collection
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pycolmap
import torch
from safetensors import SafetensorError, safe_open

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.networks.da3.camera_tokens import invert_encodings
from zeroshop_steps.networks.da3.model import DepthAnything3, adapt_names
from zeroshop_steps.networks.da3.settings import BASE, SMALL, Da3Settings
from zeroshop_steps.networks.devices import PROCESS_BYTES
from zeroshop_steps.networks.weights import load_strictly
from zeroshop_steps.register.colmap import match_and_reconstruct, read_colmap_options
from zeroshop_steps.register.da3.options import Da3Options
from zeroshop_steps.register.da3.refinement import RoughScene, TooFewMatches, start_from_cameras
from zeroshop_steps.register.features.sift import fit_to_count
from zeroshop_steps.register.registration import read_options, write_registration
from zeroshop_steps.register.scene.image_set import ImageSet, read_image_set
from zeroshop_steps.register.scene.record import Record, RegistrationFailed, describe_model
from zeroshop_steps.register.scene.undistortion import undistort
from zeroshop_steps.register.vggt.feed_forward import build_feed_forward_model, check_feed_forward, decode_cameras, find_confirmed_points
from zeroshop_steps.register.vggt.frames import Frames, find_usable_pixels, fit_size, read_frames
from zeroshop_steps.register.vggt.memory import DENSE_MAPS, TOKEN_WIDTHS, VALUE_BYTES, load_network
from zeroshop_steps.register.vggt.network import VggtOutput, memory_errors, read_settings, resolve_published
from zeroshop_steps.runtime.files import scratch_directory
from zeroshop_steps.runtime.progress import ProgressReport

WIDTH_OF = "cls_token"  # ends the name of a tensor whose last dimension is the width of a token
REMEDY = "take more pictures in between, or put the object on a strongly textured surface"
REFINE = "refine by matches (register.da3.refine), or "


def find_size(weights: Path) -> Da3Settings:
    """The published size of a checkpoint, by the width of its tokens; small where that does not tell."""
    try:
        with safe_open(weights, "pt") as opened:
            widths = {opened.get_slice(name).get_shape()[-1] for name in opened.keys() if name.endswith(WIDTH_OF)}  # noqa: SIM118
    except SafetensorError:  # damaged, which loading it tells
        return SMALL
    return BASE if widths == {BASE.width} else SMALL


class Da3Network:
    """Depth Anything 3 with its weights on a device.

    Args:
        weights: file of a checkpoint.
        settings: its sizes.
        device: "cpu" or "cuda".
        precision: of the backbone.
        chunk: images at a time in the head.
    """

    def __init__(self, weights: Path, settings: Da3Settings, device: str, precision: torch.dtype, chunk: int) -> None:
        with torch.device("meta"):
            self.module = DepthAnything3(settings)
        load_strictly(self.module, weights, adapt_names)
        with memory_errors():
            self.module.to(device).requires_grad_(False).eval()
        self.device, self.precision, self.chunk = device, precision, chunk

    def predict(self, pixels: np.ndarray) -> VggtOutput:
        """Cameras and depth of (S, 3, height, width) images, in the frame of the reference camera."""
        with torch.inference_mode(), memory_errors():
            images = torch.from_numpy(pixels).to(self.device)
            with ProgressReport("attention (blocks)", self.module.settings.depth) as report:
                tokens = self.module.tokens(images, self.precision, after_block=report.advance)
            with ProgressReport("depth (groups of images)", -(-len(pixels) // self.chunk)) as report:
                found = self.module.cameras_and_depth(tokens, (images.shape[2], images.shape[3]), self.chunk, report.advance)
            encodings, depth, confidence = (values.float().cpu().numpy() for values in (invert_encodings(found[0]), *found[1:]))
            return VggtOutput(encodings, depth, confidence)


def predict_peak_bytes(settings: Da3Settings, weights_bytes: int, frames: int, size_px: tuple[int, int], chunk: int, half: bool) -> int:
    """The most memory that a run takes; the arguments are those of `register.vggt.memory.predict_peak_bytes`."""
    pixels = size_px[0] * size_px[1]
    tokens = frames * (pixels // settings.patch_px**2 + 1)
    kept = tokens * len(settings.layers) * 2 * settings.width
    attention = kept + tokens * settings.width * TOKEN_WIDTHS[half]
    dense = kept + min(chunk, frames) * pixels * settings.dense_features * DENSE_MAPS + 2 * frames * pixels
    return int(PROCESS_BYTES + weights_bytes + VALUE_BYTES * (max(attention, dense) + 3 * frames * pixels))


class CameraPredictor(Protocol):
    """What the network does for a registration."""

    def predict(self, pixels: np.ndarray) -> VggtOutput: ...


def solve(args: argparse.Namespace, published: Collection[str]) -> None:
    """Write the cameras folder of the command line's arguments; checkpoints are checked that are `published`, below resources/weights."""
    options = read_options(Da3Options, args, colmap=read_colmap_options(args))
    image_set = read_image_set(args.capture)
    weights = resolve_published(args.weights, published)
    settings = read_settings(weights, find_size(weights))
    size_px, _ = fit_size(image_set.size_px, settings.image_px, settings.patch_px, upright=True)

    def predict(count: int, chunk: int, half: bool) -> int:
        return predict_peak_bytes(settings, weights.stat().st_size, count, size_px, chunk, half)

    network, figures = load_network("Depth Anything 3", partial(Da3Network, weights, settings), predict, image_set, size_px, args)
    write_registration(
        args.out,
        lambda folder: register(image_set, folder, options, network, settings.image_px, settings.patch_px, figures),
    )


def register(
    image_set: ImageSet, out: Path, options: Da3Options, network: CameraPredictor, image_px: int, patch_px: int, known: dict[str, Any]
) -> dict[str, Any]:
    """Estimate cameras and write images/, sparse/ and, where there are masks, masks/ to `out`.

    Args:
        image_set: what to register.
        out: folder to fill.
        options: see `Da3Options`.
        network: predicts cameras and depth.
        image_px, patch_px: longer side of what it sees, and what both sides are multiples of.
        known: figures of the device, for the record.

    Returns:
        The record for registration.json.

    Raises:
        RegistrationFailed: no cameras, too few, or cameras that the images contradict.
    """
    count = len(image_set.images)
    record = Record.begin("da3", image_set, options, torch, pycolmap, **known)
    object_only = options.colmap.structure.object_only
    frames = read_frames(image_set, image_px, patch_px, object_only, upright=True)
    predicted = network.predict(frames.pixels)
    record.stopwatch.lap("predict")
    try:
        cameras = decode_cameras(predicted.encodings, frames)
    except RegistrationFailed as failure:
        raise failure.after(record) from None
    record, lack = record.add(refined_by=options.refine), ""
    if options.refine == "matches":
        colmap = replace(options.colmap, sift=fit_to_count(options.colmap.sift, count))
        start = partial(start_from_cameras, RoughScene(cameras, frames, predicted.depth), image_set, options)
        try:
            with scratch_directory(out, "matches") as scratch:
                return dict(match_and_reconstruct(image_set, out, scratch / "database.db", colmap, record, start).entries)
        except TooFewMatches as few:
            lack = f"{few}; and "
            found = f"{few}: the cameras are the network's own, which are less exact"
            record = Record(few.figures, record.stopwatch).add(refined_by="none").warn(found)
    usable = find_usable_pixels(frames, image_set, object_only)
    try:
        return dict(_take_cameras(cameras, frames, usable, predicted, image_set, out, options, record).entries)
    except RegistrationFailed as failure:
        raise failure.because(f"{lack}{failure}") from None


def _take_cameras(
    cameras: list[Camera],
    frames: Frames,
    usable: np.ndarray,
    predicted: VggtOutput,
    image_set: ImageSet,
    out: Path,
    options: Da3Options,
    record: Record,
) -> Record:
    """Write the cameras as they are, with the points on which the surer depths of several views agree."""
    known = predicted.confidence[usable & np.isfinite(predicted.confidence)]
    least = np.quantile(known, options.unsure_share) if known.size else np.inf
    points = find_confirmed_points(cameras, frames, predicted.depth, usable & (predicted.confidence >= least))
    model = build_feed_forward_model(cameras, points)
    remedy = REMEDY if options.refine == "matches" else REFINE + REMEDY
    evidence = check_feed_forward(cameras, points, image_set, options.unrefined_px, options.min_agreement, remedy)
    pinhole_model, lenses = undistort(model, image_set, out)
    record = record.judge(lenses).add(**evidence.entries, **describe_model(pinhole_model))
    record.stopwatch.lap("depth")
    record.stopwatch.stop()
    return record.judge(evidence, pinhole_model)
