"""Fit what the cues of the masks mean together, and the score that chooses and refuses, on captures whose masks are known.

    python benchmarks/fit_masks.py cues --scenes FOLDER... --network u2netp.onnx
    python benchmarks/fit_masks.py score --scenes FOLDER... --network u2netp.onnx

A folder has scene/ (registered photos) and reference masks of some of them in capture/truth/masks/ or reference/, named like the photos, 0
or 255. Captures of one object are named OBJECT_NUMBER: they are left out together where the fit is judged (k-fold over objects). `cues`
writes segment/cue_weights.json, `score` segment/score_weights.json. Give the captures of the tune half alone.
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from scipy import ndimage

from zeroshop_steps.geometry.images import compute_overlap
from zeroshop_steps.geometry.registered_views import read_views
from zeroshop_steps.networks.salient_object import SalientObjectNetwork
from zeroshop_steps.segment import fusion, scores
from zeroshop_steps.segment.exposure import estimate_exposure
from zeroshop_steps.segment.finder import WIDTH_PX, Hypothesis, find_focus, try_support
from zeroshop_steps.segment.objects import NothingFound
from zeroshop_steps.segment.scene import Guess, MaskScene, read_mask_scene, start_guess
from zeroshop_steps.segment.solve import make_guess
from zeroshop_steps.segment.support import propose_supports
from zeroshop_steps.segment.voxels import VoxelGrid, carve, render_silhouettes
from zeroshop_steps.segment.windows import CLOSER, choose_windows, scale_windows

PIXELS = 300  # of a view for each guess; half of them near the outline
VOXELS = 72
HIDDEN_UNITS, EPOCHS, BATCH, RATE, DECAY = 24, 12, 8192, 5e-3, 1e-4
DROPPED = ((), ("network",), ("ground",))
"""Cues that know nothing in a part of the samples, so that one network serves without them."""
FOLDS = 5
RING = 0.5  # around the object, of its size, the ground is known to be empty in most captures
KINDS = ("right", "large", "small", "lacks", "more")  # of hulls that are tried


@dataclass(frozen=True)
class Truth:
    """A capture whose masks are known: (h, w) bool of the scene's cameras, None where there is no reference."""

    name: str
    scene: MaskScene
    masks: list[np.ndarray | None]

    @property
    def object_name(self) -> str:
        """What it shows."""
        return self.name.rpartition("_")[0]


def read_truth(folder: Path, network: SalientObjectNetwork, cache: Path) -> Truth:
    """The capture of a folder; what the network sees is kept in `cache`."""
    views, model = read_views(folder / "scene")
    kept = cache / "saliency" / f"{folder.name}.npz"
    if not kept.is_file():
        kept.parent.mkdir(parents=True, exist_ok=True)
        maps = network.find_maps([view.image_path for view in views], WIDTH_PX)
        np.savez_compressed(kept, *(np.round(255 * seen).astype(np.uint8) for seen in maps))
    with np.load(kept) as stored:
        saliency = [stored[name].astype(np.float32) / 255 for name in stored.files]
    scene = read_mask_scene(views, model, estimate_exposure(folder / "scene", views), saliency, WIDTH_PX)
    masks_folder = folder / "capture/truth/masks"
    masks_folder = masks_folder if masks_folder.is_dir() else folder / "reference"
    paths = [masks_folder / f"{Path(view.camera.name).stem}.png" for view in views]
    masks = [
        resize_mask(path, camera.width_px, camera.height_px) if path.is_file() else None
        for path, camera in zip(paths, scene.cameras, strict=True)
    ]
    return Truth(folder.name, scene, masks)


def resize_mask(path: Path, width_px: int, height_px: int) -> np.ndarray:
    """A reference mask at another size, (height, width) bool."""
    mask = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    return cv2.resize((mask > 127).astype(np.float32), (width_px, height_px), interpolation=cv2.INTER_AREA) > 0.5


def propose_guesses(truth: Truth, rng: np.random.Generator) -> Iterator[tuple[MaskScene, Guess, list[np.ndarray | None]]]:
    """What the network meets: nothing known yet; and hulls that are right, too large, too small, and lack a part or have too much."""
    focus, distance = find_focus(truth.scene)
    candidates = list(propose_supports(truth.scene.model, truth.scene.views, 0))
    for candidate in (candidates[0], candidates[-1]):
        support = candidate.support and replace(candidate.support, focus=focus, distance=distance)
        yield truth.scene, start_guess(truth.scene, support), truth.masks
        if any(mask is None for mask in truth.masks):
            continue  # a hull needs all masks
        for kind in rng.choice(KINDS, 3 if support is not None else 1, replace=False):
            yield from make_hull_guess(truth, support, [perturb(mask, kind, rng) for mask in truth.masks], focus, distance)


def perturb(mask: np.ndarray, kind: str, rng: np.random.Generator) -> np.ndarray:
    """A wrong mask of a view."""
    if not mask.any() or kind == "right":
        return mask
    size = float(np.sqrt(mask.sum()))
    radius = max(1, round(size * rng.uniform(0.02, 0.08)))
    window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2)
    if kind == "large":
        return cv2.dilate(mask.astype(np.uint8), window) > 0
    if kind == "small":
        return cv2.erode(mask.astype(np.uint8), window) > 0
    rows, columns = np.nonzero(mask)
    # A part of the height, the same in all views, is missing, or a block beside the object is taken along.
    if kind == "lacks":
        cut = rows.min() + 0.3 * np.ptp(rows)
        return mask & (np.arange(mask.shape[0])[:, None] > cut)
    more = mask.copy()
    more[rows.max() - int(0.4 * np.ptp(rows)) : rows.max(), columns.max() : columns.max() + int(0.3 * size)] = True
    return more


def make_hull_guess(truth, support, masks, focus, distance):
    """The guess whose hull masks share, seen in windows around it."""
    scene = truth.scene
    axes = np.eye(3) if support is None else np.vstack([support.axes(), support.normal])
    extent = 0.5 * distance
    grid = VoxelGrid(axes, focus - extent * axes.sum(0), 2 * extent / VOXELS, (VOXELS,) * 3)
    index = np.argwhere(np.ones(grid.shape, bool))
    occupied = carve(grid, index, scene.cameras, [2 * mask.astype(np.float32) - 1 for mask in masks], 1.0)
    if not occupied.any():
        return
    silhouettes = render_silhouettes(grid, occupied, scene.cameras)
    windows, closer = choose_windows(silhouettes)
    known = truth.masks
    if closer <= CLOSER:
        whole = [scene.cameras, known]
        scaled = scale_windows(windows, scene.cameras, scene.views)
        scene = scene.look_closer(scaled, None)
        known = [
            cv2.resize(mask[window.slices].astype(np.float32), (camera.width_px, camera.height_px), interpolation=cv2.INTER_LINEAR) > 0.5
            for mask, window, camera in zip(whole[1], windows, scene.cameras, strict=True)
        ]
        if support is not None:
            middle = grid.centres(np.argwhere(occupied)).mean(0)
            support = replace(support, focus=middle, distance=closer * support.distance)
    hulls = render_silhouettes(grid, occupied, scene.cameras)
    nothing = [np.zeros_like(hull) for hull in hulls]
    yield scene, make_guess(scene, support, grid, occupied, hulls, nothing), known


def sample(truth: Truth, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(N, C) channels and (N,) whether they are of the object."""
    channels, labels = [], []
    for scene, guess, masks in propose_guesses(truth, rng):
        for without in DROPPED if guess.hulls is None else ((), ("network",)):
            see = fusion.prepare_channels(scene, guess, without)
            for index in rng.choice(len(masks), min(6, len(masks)), replace=False):
                mask = masks[index]
                if mask is None or not mask.any():
                    continue
                size = np.sqrt(mask.sum())
                away = ndimage.distance_transform_edt(~mask)
                near, shown = np.abs(ndimage.distance_transform_edt(mask) - away) < 0.1 * size, see(index)
                # Before there is a hull, other things on the ground are things, too. Nobody has drawn them, so they are left out.
                ground = (shown[..., fusion.CHANNELS.index("ground_known")] > 0) & (guess.hulls is None)
                places = [rng.choice(np.flatnonzero(part), PIXELS // 2) for part in (near, ~ground | (away < RING * size))]
                flat = np.concatenate(places)
                channels.append(shown.reshape(-1, len(fusion.CHANNELS))[flat])
                labels.append(mask.ravel()[flat])
    return np.concatenate(channels), np.concatenate(labels)


def fit_network(channels: np.ndarray, labels: np.ndarray, seed: int = 0) -> torch.nn.Module:
    """The network of one hidden layer with the least cross entropy."""
    torch.manual_seed(seed)
    net = torch.nn.Sequential(torch.nn.Linear(channels.shape[1], HIDDEN_UNITS), torch.nn.ReLU(), torch.nn.Linear(HIDDEN_UNITS, 1))
    optimizer = torch.optim.AdamW(net.parameters(), RATE, weight_decay=DECAY)
    x, y = torch.from_numpy(channels), torch.from_numpy(labels.astype(np.float32))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, EPOCHS)
    for _ in range(EPOCHS):
        for batch in torch.randperm(len(x)).split(BATCH):
            loss = torch.nn.functional.binary_cross_entropy_with_logits(net(x[batch])[:, 0], y[batch])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        schedule.step()
    return net


def judge(net: torch.nn.Module, channels: np.ndarray, labels: np.ndarray) -> tuple[float, float]:
    """Cross entropy and share of wrong pixels."""
    with torch.no_grad():
        odds = net(torch.from_numpy(channels))[:, 0]
        loss = torch.nn.functional.binary_cross_entropy_with_logits(odds, torch.from_numpy(labels.astype(np.float32)))
    return float(loss), float(((odds.numpy() > 0) != labels).mean())


def fit_cues(args: argparse.Namespace) -> None:
    """Fit the network, and print how it does on objects that were left out."""
    network, rng = SalientObjectNetwork(args.network), np.random.default_rng(0)
    parts, names = [], []
    for folder in args.scenes:
        cached = args.cache / f"{folder.name}.npz"
        if not cached.is_file():
            args.cache.mkdir(parents=True, exist_ok=True)
            channels, labels = sample(read_truth(folder, network, args.cache), rng)
            np.savez(cached, channels=channels, labels=labels)
        stored = np.load(cached)
        parts.append((stored["channels"], stored["labels"]))
        names.append(folder.name.rpartition("_")[0])
        print(folder.name, len(parts[-1][1]), flush=True)
    objects = sorted(set(names))
    for fold in range(min(FOLDS, len(objects))):
        left_out = set(objects[fold::FOLDS])
        train = [part for part, name in zip(parts, names, strict=True) if name not in left_out]
        test = [part for part, name in zip(parts, names, strict=True) if name in left_out]
        net = fit_network(*(np.concatenate(each) for each in zip(*train, strict=True)))
        print(
            "left out",
            ", ".join(sorted(left_out)),
            *(f"{value:.4f}" for value in judge(net, *(np.concatenate(e) for e in zip(*test, strict=True)))),
        )
    net = fit_network(*(np.concatenate(each) for each in zip(*parts, strict=True)))
    first, second = net[0], net[2]
    stored = {
        "channels": list(fusion.CHANNELS),
        "first": np.round(first.weight.detach().numpy().T, 5).tolist(),
        "first_offset": np.round(first.bias.detach().numpy(), 5).tolist(),
        "second": np.round(second.weight.detach().numpy()[0], 5).tolist(),
        "second_offset": round(float(second.bias.detach()[0]), 5),
    }
    fusion.WEIGHTS.write_text(json.dumps(stored) + "\n")


def rate_hypotheses(truth: Truth, network: SalientObjectNetwork) -> list[dict[str, Any]]:
    """The measures of right and wrong masks: on each plane, and with some cues left out; and how they overlap with the truth."""
    rows = []
    for number, candidate in enumerate(propose_supports(truth.scene.model, truth.scene.views, 0)):
        for without in ((), ("network",), ("ground",), ("network", "own_colors"))[: None if number == 0 else 1]:
            try:
                # Another look from closer, which takes most of the time, at the first alone.
                found = try_support(truth.scene, candidate, network if number == 0 and not without else None, without)
            except NothingFound:
                continue
            rows.append({"measures": asdict(found.measures), "overlap": measure_overlap(found, truth), "without": without})
    return rows


def fit_score(args: argparse.Namespace) -> None:
    """Fit the probability that masks are right, on hypotheses with all cues and without some."""
    network, rows = SalientObjectNetwork(args.network), []
    for folder in args.scenes:
        cached = args.cache / f"{folder.name}.json"
        if not cached.is_file():
            cached.write_text(json.dumps(rate_hypotheses(read_truth(folder, network, args.cache), network)))
        rows += [row | {"object": folder.name.rpartition("_")[0]} for row in json.loads(cached.read_text())]
        print(folder.name, *(f"{row['overlap']:.2f}" for row in rows if row["object"] == folder.name.rpartition("_")[0]), flush=True)
    x = np.array([list(row["measures"].values()) for row in rows])
    y, names = (np.array(part) for part in ([row["overlap"] >= scores.RIGHT_OVERLAP for row in rows], [row["object"] for row in rows]))
    left_out = np.zeros(len(y))
    for name in np.unique(names):
        weights, offset = fit_logistic(x[names != name], y[names != name])
        left_out[names == name] = offset - x[names == name] @ weights
    print(f"{len(y)} hypotheses, {y.mean():.3f} right; objects left out in turn:")
    print(f"{((left_out > 0) & ~y).sum()} wrong ones accepted, {((left_out <= 0) & y).sum()} right ones refused")
    weights, offset = fit_logistic(x, y)
    names_of_measures = [field.name for field in fields(scores.Measures)]
    stored = {"weights": dict(zip(names_of_measures, np.round(weights, 4).tolist(), strict=True)), "offset": round(offset, 4)}
    scores.WEIGHTS.write_text(json.dumps(stored) + "\n")


def fit_logistic(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, float]:
    """Weights, none below 0, and offset of a logistic regression: the more of any measure, the less likely masks are right."""
    weights, offset = torch.zeros(x.shape[1], requires_grad=True), torch.zeros(1, requires_grad=True)
    optimizer = torch.optim.Adam([weights, offset], 0.05)
    values, truth = torch.from_numpy(x.astype(np.float32)), torch.from_numpy(y.astype(np.float32))
    for _ in range(3000):
        odds = offset - values @ weights.clamp(min=0)
        loss = torch.nn.functional.binary_cross_entropy_with_logits(odds, truth) + 1e-4 * weights.square().sum()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return weights.detach().clamp(min=0).numpy(), float(offset.detach()[0])


def measure_overlap(found: Hypothesis, truth: Truth) -> float:
    """Intersection over union with the reference, of the median photo."""
    if all(true is None for true in truth.masks):
        return 0.0  # there is no single object
    overlaps = []
    for mask, window, view, true in zip(found.solution.masks, found.scene.windows, truth.scene.views, truth.masks, strict=True):
        if true is None:
            continue
        height, width = true.shape
        x, y = width / view.camera.width_px, height / view.camera.height_px
        left, top, right, bottom = (round(v) for v in (window.left * x, window.top * y, window.right * x, window.bottom * y))
        whole = np.zeros_like(true)
        whole[top:bottom, left:right] = cv2.resize(mask, (right - left, bottom - top)) > 0.5
        overlaps.append(compute_overlap(whole, true))
    return float(np.median(overlaps))


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("cues", "score"))
    parser.add_argument("--scenes", type=Path, nargs="+", required=True, help="folders with scene/ and reference/")
    parser.add_argument("--network", type=Path, required=True, help="ONNX file of a salient-object network")
    parser.add_argument("--cache", type=Path, default=Path("results/fit_masks"))
    args = parser.parse_args()
    {"cues": fit_cues, "score": fit_score}[args.what](args)


if __name__ == "__main__":
    main()
