"""From images to a registration: predict, refine, check, undistort."""

import argparse
import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pycolmap
import torch

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.networks.vggt.settings import VggtSettings
from zeroshop_steps.register.mapping.reregistration import remove_images
from zeroshop_steps.register.pipeline import read_structure_options
from zeroshop_steps.register.registration import read_options, write_registration
from zeroshop_steps.register.scene.image_set import ImageSet, read_image_set
from zeroshop_steps.register.scene.record import (
    Evidence,
    Record,
    RegistrationFailed,
    describe_model,
)
from zeroshop_steps.register.scene.undistortion import undistort
from zeroshop_steps.register.verification.consistency import check_consistency
from zeroshop_steps.register.verification.verdict import verify
from zeroshop_steps.register.vggt.bundle import adjust_cameras, drop_weak_images, write_database
from zeroshop_steps.register.vggt.feed_forward import build_feed_forward_model, check_feed_forward, decode_cameras, find_confirmed_points
from zeroshop_steps.register.vggt.frames import Frames, find_usable_pixels, fit_size, read_frames
from zeroshop_steps.register.vggt.memory import load_network, predict_peak_bytes
from zeroshop_steps.register.vggt.network import VggtNetwork, VggtOutput, read_settings, resolve_published
from zeroshop_steps.register.vggt.options import VggtOptions
from zeroshop_steps.register.vggt.tracks import choose_query_points, choose_query_views, gather_observations
from zeroshop_steps.runtime.files import scratch_directory

REMEDY = "refine by tracks (register.vggt.refine), take more pictures in between, or use the registration colmap"


class CameraPredictor(Protocol):
    """What the network does for a registration."""

    def predict(self, pixels: np.ndarray) -> VggtOutput: ...

    def track(self, pixels: np.ndarray, view: int, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]: ...


@dataclass(frozen=True)
class Solution:
    """Cameras before they are undistorted, what was found about them, and what is written of them."""

    model: pycolmap.Reconstruction
    evidence: Evidence
    entries: dict[str, Any]


def solve(args: argparse.Namespace, published: Collection[str]) -> None:
    """Write the cameras folder of the command line's arguments; checkpoints are checked that are `published`, below resources/weights."""
    structure = replace(read_structure_options(args), max_dropped=VggtOptions().structure.max_dropped)
    options = read_options(VggtOptions, args, lens=args.lens.upper(), structure=structure)
    image_set = read_image_set(args.capture)
    weights = resolve_published(args.weights, published)
    settings = read_settings(weights, VggtSettings())
    (width, height), left = fit_size(image_set.size_px, settings.image_px, settings.patch_px)
    points = options.tracked_points if options.refine == "tracks" else 0
    size_px = (width + 2 * left, height)

    def predict(count: int, chunk: int, half: bool) -> int:
        return predict_peak_bytes(settings, weights.stat().st_size, count, size_px, points, chunk, half)

    network, figures = load_network("VGGT", partial(VggtNetwork, weights, settings), predict, image_set, size_px, args)
    write_registration(
        args.out,
        lambda folder: register(image_set, folder, options, network, settings.image_px, settings.patch_px, figures),
    )


def register(
    image_set: ImageSet, out: Path, options: VggtOptions, network: CameraPredictor, image_px: int, patch_px: int, known: dict[str, Any]
) -> dict[str, Any]:
    """Estimate cameras and write images/, sparse/ and, where there are masks, masks/ to `out`.

    Args:
        image_set: what to register.
        out: folder to fill.
        options: see `VggtOptions`.
        network: predicts cameras, depth and tracks.
        image_px, patch_px: longer side of what it sees, and what both sides are multiples of.
        known: figures of the device, for the record.

    Returns:
        The record for registration.json.

    Raises:
        RegistrationFailed: no cameras, too few, or cameras that the images contradict.
    """
    count = len(image_set.images)
    structure = options.structure
    needed = max(structure.min_images, math.ceil(structure.min_share * count))
    record = Record.begin("vggt", image_set, options, torch, pycolmap, **known)
    frames = read_frames(image_set, image_px, patch_px, structure.object_only)
    usable = find_usable_pixels(frames, image_set, structure.object_only)
    predicted = network.predict(frames.pixels)
    record.stopwatch.lap("predict")
    try:
        cameras = decode_cameras(predicted.encodings, frames)
    except RegistrationFailed as failure:
        raise failure.after(record) from None
    with scratch_directory(out, "vggt") as scratch:
        if options.refine == "tracks":
            solution = _solve_by_tracks(cameras, frames, usable, predicted, image_set, scratch / "database.db", options, network)
        else:
            solution = _solve_feed_forward(cameras, frames, usable, predicted, image_set, options)
    record.stopwatch.lap("solve")
    record = record.add(**solution.entries)
    registered = solution.model.num_reg_images()
    if registered < needed:
        raise record.fail(
            f"{registered} of {count} images registered, at least {needed} are needed: the network's tracks and cameras do not fit each "
            "other there; take pictures that show the object from nearer together, or use the registration colmap"
        )
    pinhole_model, lenses = undistort(solution.model, image_set, out)
    record = record.judge(lenses).add(**describe_model(pinhole_model))
    record.stopwatch.stop()
    return dict(verify(record, [lambda: solution.evidence], pinhole_model, structure.limits.max_wrong_probability).entries)


def _solve_by_tracks(
    cameras: list[Camera],
    frames: Frames,
    usable: np.ndarray,
    predicted: VggtOutput,
    image_set: ImageSet,
    database: Path,
    options: VggtOptions,
    network: CameraPredictor,
) -> Solution:
    """Follow points from several views, and refine the cameras until the points fit."""
    structure, queries, tracks = options.structure, {}, {}
    views = choose_query_views(cameras, options.query_views)
    for view in views:
        points = choose_query_points(frames.pixels[view], usable[view], options.tracked_points)
        if len(points):
            queries[view], tracks[view] = points, network.track(frames.pixels, view, points)
    seen = gather_observations(frames, usable, queries, tracks, options.min_visibility)
    focal_px = float(np.median([camera.intrinsics[0, 0] for camera in cameras]))
    write_database(database, frames.names, seen, frames.size_px, focal_px, structure.seed)
    model = adjust_cameras(cameras, seen, options.lens, options.max_error_px)
    model = drop_weak_images(model, options.min_observations, options.max_error_px)
    entries = {"query_views": [frames.names[view] for view in views], "tracks": seen.seen.shape[1]}
    if model.num_reg_images() < 2 or not model.num_points3D():
        return Solution(pycolmap.Reconstruction(), Evidence(), {**entries, "left_out": []})
    left_out: list[str] = []
    report = check_consistency(model, image_set, database, structure.limits)
    for _ in range(structure.max_dropped):
        if not report.culprits or model.num_reg_images() - len(report.culprits) < max(structure.min_images, 2):
            break
        left_out += report.culprits
        model = remove_images(model, list(report.culprits))
        model = drop_weak_images(model, options.min_observations, options.max_error_px)
        report = check_consistency(model, image_set, database, structure.limits)
    return Solution(model, report.gather(), {**entries, "left_out": left_out})


def _solve_feed_forward(
    cameras: list[Camera], frames: Frames, usable: np.ndarray, predicted: VggtOutput, image_set: ImageSet, options: VggtOptions
) -> Solution:
    """Take the cameras as they are, with the points on which the depth of several views agrees."""
    points = find_confirmed_points(cameras, frames, predicted.depth, usable & (predicted.confidence >= options.min_confidence))
    model = build_feed_forward_model(cameras, points)
    return Solution(model, check_feed_forward(cameras, points, image_set, options.unrefined_px, options.min_agreement, REMEDY), {})
