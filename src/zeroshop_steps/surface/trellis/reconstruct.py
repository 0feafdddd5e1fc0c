"""From registered photos to the best of several generated meshes, in the frame of the cameras."""

import argparse
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from zeroshop_steps.capture.known_height import read_known_height_m
from zeroshop_steps.geometry.cameras.object_crops import fit_object_sphere
from zeroshop_steps.geometry.cameras.registered_views import View, read_views
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.geometry.meshes.triangle_meshes import MIN_FACES, Mesh, write_ply
from zeroshop_steps.geometry.support.ground_plane import estimate_up_from_roll
from zeroshop_steps.networks.devices import check_memory, choose_device
from zeroshop_steps.networks.pretrained import require_model
from zeroshop_steps.networks.trellis.conditioning import frame_object
from zeroshop_steps.networks.trellis.flexible_surface import ColoredSurface
from zeroshop_steps.networks.trellis.generator import Generator, encode_pictures, read_settings
from zeroshop_steps.networks.trellis.memory import predict_memory
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import write_json
from zeroshop_steps.surface.rendering.training_views import read_camera_set
from zeroshop_steps.surface.trellis.alignment import PhotoAligner, describe_fit
from zeroshop_steps.surface.trellis.photo_fit import PhotoFit
from zeroshop_steps.surface.trellis.uncalibrated import as_generated, choose_likeliest, read_pictures, scale_by_height

ELEVATION_DEG, APART_DEG = 45.0, 180.0
LEAST_OVERLAP = 0.5
"""Of its outlines with the masks, intersection over union; below, the network made another thing."""

Generate = Callable[[int], ColoredSurface]
Start = Callable[[Sequence[np.ndarray]], Generate]
"""Loads the networks and encodes pictures of `frame_object`; gives what makes a mesh of each seed."""


@dataclass(frozen=True)
class BestGeneration:
    """The generated mesh that fits the photos best.

    Attributes:
        mesh: with colours, in the frame of the cameras.
        seed: of its noise.
        fit: how it fits.
        tried: for each seed, its figures for the record.
    """

    mesh: Mesh
    seed: int
    fit: PhotoFit
    tried: list[dict[str, Any]]


def reconstruct(args: argparse.Namespace, files: Mapping[str, tuple[str, ...]]) -> None:
    """Write the raw mesh and its figures; `files` are those of the networks and of the encoder."""
    start_s = time.monotonic()
    if args.generations < 1 or args.steps < 1:
        raise StepError(f"--generations is {args.generations} and --steps {args.steps}; at least one of each is needed")
    if (args.cameras is None) == (args.capture is None):
        raise StepError("trellis takes either --cameras, or --capture, whose photos have no cameras")
    networks, encoder = require_model(args.networks, files["networks"]), require_model(args.encoder, files["encoder"])
    device = torch.device(choose_device(args.device))
    settings = read_settings(networks)
    settings = replace(settings, sampler=replace(settings.sampler, steps=args.steps, guidance=args.guidance))
    needs = predict_memory(settings)
    torch.set_num_threads(args.threads)
    seeds = range(args.seed, args.seed + args.generations)

    def start(pictures: Sequence[np.ndarray]) -> Generate:
        check_memory(needs, device)
        conditions = encode_pictures(encoder, pictures, device)
        generator = Generator(networks, settings, device)
        samples = generator.sample(conditions, seeds)
        return lambda seed: generator.decode(samples[seed])

    if args.cameras is None:
        mesh, facts = _from_photos_alone(args, start, seeds, settings.image_px)
    else:
        mesh, facts = _from_registered_photos(args, start, seeds, settings.image_px)
    write_ply(args.out, mesh)
    facts = {
        "seconds": round(time.monotonic() - start_s, 2),
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "generated": True,
        **facts,
        "device": device.type,
        "predicted_peak_gb": round(needs.peak_bytes / 1e9, 2),
        "parameters": {"generations": args.generations, "steps": args.steps, "guidance": args.guidance},
    }
    write_json(args.out.with_suffix(".json"), facts)


def _from_registered_photos(args: argparse.Namespace, start: Start, seeds: range, image_px: int) -> tuple[Mesh, dict[str, Any]]:
    """The best mesh in the frame of the cameras, and its facts."""
    camera_set, (views, _) = read_camera_set(args.cameras), read_views(args.cameras)
    sphere = fit_object_sphere(camera_set.model.cameras, camera_set.masks)
    chosen = choose_opposite_views(views, sphere.centre)
    generate = start([frame_object(camera_set.images[view], camera_set.masks[view], image_px) for view in chosen])
    best = choose_generation(generate, seeds, PhotoAligner(camera_set.model.cameras, camera_set.images, camera_set.masks))
    print(f"trellis: seed {best.seed} of {len(seeds)}, overlap with the masks {best.fit.overlap:.1%}", file=sys.stderr)
    return best.mesh, {
        "views": [views[view].camera.name for view in chosen],
        "seed": best.seed,
        "generations": best.tried,
        "registration_from_generated": np.round(best.fit.photos_from_mesh, 7).tolist(),
    }


def _from_photos_alone(args: argparse.Namespace, start: Start, seeds: range, image_px: int) -> tuple[Mesh, dict[str, Any]]:
    """The mesh that is most like the photos, as high as is known, and its facts."""
    height_m = read_known_height_m(args.capture / "capture.json", args.height_m)
    named = read_pictures(args.capture)
    pictures = [(image, mask) for _, image, mask in named]
    generate = start([frame_object(image, mask, image_px) for image, mask in pictures])
    surfaces = (generate(seed) for seed in seeds)
    meshes = (as_generated(surface) if len(surface.faces) >= MIN_FACES else None for surface in surfaces)
    index, mesh, errors = choose_likeliest(meshes, pictures)
    if height_m is None:
        warn("the scale is unknown: no height is given. Give the object's height in metres as height_m in config/objects.tsv")
    print(f"trellis: seed {seeds[index]} of {len(seeds)}, likeness {1 - errors[index]:.1%}", file=sys.stderr)
    return scale_by_height(mesh, height_m), {
        "views": [name for name, _, _ in named],
        "seed": seeds[index],
        "generations": [{"seed": seed, "error": error} for seed, error in zip(seeds, errors, strict=True)],
        "unit": "unknown" if height_m is None else "millimetre",
        "scale": "unknown" if height_m is None else "known",
        "height_m": height_m,
    }


def choose_generation(generate: Generate, seeds: Iterable[int], aligner: PhotoAligner) -> BestGeneration:
    """Generate a mesh for each seed, align it, and keep the one whose outlines and colours fit the photos best.

    Raises:
        StepError: none is a surface, or none has the outlines of the masks.
    """
    best: BestGeneration | None = None
    tried: list[dict[str, Any]] = []
    for seed in seeds:
        start_s = time.monotonic()
        surface = generate(seed)
        record: dict[str, Any] = {"seed": seed, "faces": len(surface.faces)}
        tried.append(record)
        if len(surface.faces) >= MIN_FACES:
            mesh = as_generated(surface)
            fit = aligner.align(mesh)
            record |= describe_fit(fit)
            if best is None or fit.error < best.fit.error:
                moved = replace(mesh, vertices=transform_points(mesh.vertices, fit.photos_from_mesh))
                best = BestGeneration(moved, seed, fit, tried)
        record["seconds"] = round(time.monotonic() - start_s, 2)
        print(f"trellis: {record}", file=sys.stderr)
    if best is None:
        raise StepError(
            f"Trellis made no surface of these photos with any of {len(tried)} seeds; choose another --seed, or check the masks"
        )
    if best.fit.overlap < LEAST_OVERLAP:
        raise StepError(
            f"no generated mesh has the outlines of the masks: at best {best.fit.overlap:.0%} of them overlap, {LEAST_OVERLAP:.0%} are"
            " needed; choose another --seed or more --generations, or a surface method that measures (2dgs)"
        )
    return best


def choose_opposite_views(views: Sequence[View], centre: np.ndarray) -> tuple[int, int]:
    """Indices of the two, the earlier first.

    Args:
        views: two or more.
        centre: (3,) of the object, in the frame of the cameras.
    """
    up, _ = estimate_up_from_roll(list(views))
    outwards = np.array([view.camera.centre_in_world - centre for view in views])
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    elevation = np.degrees(np.arcsin(np.clip(outwards @ up, -1.0, 1.0)))
    level = outwards - (outwards @ up)[:, None] * up
    level /= np.maximum(np.linalg.norm(level, axis=1, keepdims=True), 1e-9)
    apart = np.degrees(np.arccos(np.clip(level @ level.T, -1.0, 1.0)))
    tilt = (elevation - ELEVATION_DEG) ** 2
    cost = tilt[:, None] + tilt[None] + (apart - APART_DEG) ** 2
    cost[np.tril_indices(len(views))] = np.inf
    first, second = np.unravel_index(np.round(cost, 6).argmin(), cost.shape)
    return int(first), int(second)
