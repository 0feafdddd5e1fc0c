"""Fit what the cues of the masks mean together, and the score that chooses and refuses, on captures whose masks are known.

    python benchmarks/fit_masks.py cues --scenes FOLDER... --network u2netp.onnx --segmenter mobile_sam.pt
    python benchmarks/fit_masks.py score --scenes FOLDER... --network u2netp.onnx --segmenter mobile_sam.pt

A folder has scene/ (registered photos) and reference masks of some of them in capture/truth/masks/ or reference/, named like the photos, 0
or 255. Captures of one object are named OBJECT_NUMBER: they are left out together where the fit is judged (k-fold over objects). `cues`
writes segment/cues/cue_weights.json, `score` segment/quality/score_weights.json. Give the captures of the tune half alone.
"""

import argparse
import contextlib
import json
from dataclasses import asdict, fields, replace
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from scipy.optimize import minimize
from scipy.special import expit

from capture_benchmark.scores import WRONG_MEDIAN
from mask_samples import Truth, mislead, name_object, read_truth, sample, scale_to
from zeroshop_steps.geometry.imaging.images import compute_overlap
from zeroshop_steps.networks.mobile_sam.model import MobileSam
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.segment import finder
from zeroshop_steps.segment.cues import fusion
from zeroshop_steps.segment.finder import Hypothesis, try_support
from zeroshop_steps.segment.objects import NothingFound
from zeroshop_steps.segment.outlines.prompts import PromptedSegmenter
from zeroshop_steps.segment.quality import mask_scores
from zeroshop_steps.segment.support import propose_supports

HIDDEN_UNITS, EPOCHS, BATCH, RATE, DECAY = 24, 12, 8192, 5e-3, 1e-4
FOLDS = 5
PLANES, HYPOTHESES = 2, 6  # of a capture, and on each plane, that are rated
COMMON_WEIGHT, COMMON_STRENGTH = 5.0, 1.0  # of a measure between 0 and 1; the strength is that of all hypotheses together
REFUSALS = 5  # of right masks that wrong and accepted ones cost: people see a refusal at once


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


def join(parts: list[tuple[np.ndarray, np.ndarray]], chosen: list[bool]) -> tuple[np.ndarray, np.ndarray]:
    """The channels and labels of the chosen parts together."""
    channels, labels = zip(*(part for part, wanted in zip(parts, chosen, strict=True) if wanted), strict=True)
    return np.concatenate(channels), np.concatenate(labels)


def fit_cues(args: argparse.Namespace) -> None:
    """Fit the network, and print how it does on objects that were left out."""
    network, segmenter = SalientObjectNetwork(args.network), MobileSam(args.segmenter)
    parts, names = [], []
    for folder in args.scenes:
        cached = args.cache / f"{folder.name}.npz"
        if not cached.is_file():
            args.cache.mkdir(parents=True, exist_ok=True)
            truth = read_truth(folder, network, args.cache)
            channels, labels = sample(truth, network, PromptedSegmenter(segmenter), np.random.default_rng(0))
            np.savez(cached, channels=channels, labels=labels)
        stored = np.load(cached)
        known = stored["channels"], stored["labels"]
        parts.append(join([known, mislead(*known, np.random.default_rng(1))], [True, True]))
        names.append(name_object(folder))
        print(folder.name, len(parts[-1][1]), flush=True)
    objects = sorted(set(names))
    for fold in range(min(FOLDS, len(objects))):
        left_out = set(objects[fold::FOLDS])
        train, test = (join(parts, [(name in left_out) == tests for name in names]) for tests in (False, True))
        loss, wrong = judge(fit_network(*train), *test)
        print(f"left out: {', '.join(sorted(left_out))}: cross entropy {loss:.4f}, {wrong:.4f} of the pixels wrong")
    net = fit_network(*join(parts, [True] * len(parts)))
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
    """The measures of the masks that the finder tries, right and wrong ones, and how they overlap with the truth."""
    rows: list[dict[str, Any]] = []
    for candidate in islice(propose_supports(truth.scene.model, truth.scene.views, truth.scene.planes), PLANES):
        with contextlib.suppress(NothingFound):
            for found in islice(try_support(truth.scene, candidate, network), HYPOTHESES):
                rows.append(
                    {"measures": asdict(found.measures), "overlap": measure_overlap(found, truth), "probability": found.score.probability}
                )
        if any(row["probability"] >= finder.LEAST for row in rows):
            break
    return rows


def fit_score(args: argparse.Namespace) -> None:
    """Fit the probability that masks are right."""
    network, segmenter, rows = SalientObjectNetwork(args.network), MobileSam(args.segmenter), []
    for folder in args.scenes:
        cached = args.cache / f"{folder.name}.json"
        if not cached.is_file():
            truth = read_truth(folder, network, args.cache)
            truth = replace(truth, scene=replace(truth.scene, segmenter=PromptedSegmenter(segmenter)))
            cached.write_text(json.dumps(rate_hypotheses(truth, network)))
        found = json.loads(cached.read_text())
        rows += [row | {"object": name_object(folder), "capture": folder.name} for row in found]
        print(folder.name, *(f"{row['overlap']:.2f}" for row in found), flush=True)
    measures = [field.name for field in fields(mask_scores.Measures)]
    x = np.array([[row["measures"][name] for name in measures] for row in rows])
    y, names = (np.array(part) for part in ([row["overlap"] >= mask_scores.RIGHT_OVERLAP for row in rows], [row["object"] for row in rows]))
    left_out = np.zeros(len(y))
    for name in np.unique(names):
        weights, offset = fit_logistic(x[names != name], y[names != name])
        left_out[names == name] = offset - x[names == name] @ weights
    print(f"{len(y)} hypotheses, {y.mean():.3f} right; objects left out in turn:")
    print(f"{((left_out > 0) & ~y).sum()} wrong ones accepted, {((left_out <= 0) & y).sum()} right ones refused")
    print("captures accepted from a probability on (finder.LEAST): right, wrong, right less the cost of the wrong")
    rights, wrongs, probabilities = choose_likeliest(rows, expit(left_out))
    for least in np.arange(50, 100) / 100:
        right, wrong = (rights & (probabilities >= least)).sum(), (wrongs & (probabilities >= least)).sum()
        print(f"{least:.2f}: {right}, {wrong}, {right - REFUSALS * wrong}")
    weights, offset = fit_logistic(x, y)
    stored = {"weights": dict(zip(measures, np.round(weights, 4).tolist(), strict=True)), "offset": round(offset, 4)}
    mask_scores.WEIGHTS.write_text(json.dumps(stored) + "\n")


def choose_likeliest(rows: list[dict[str, Any]], probabilities: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each capture's likeliest masks: (C,) bool whether they are right, whether they are wrong, and (C,) their probability.

    Between right and wrong masks are poor, and count for neither.
    """
    captures = np.array([row["capture"] for row in rows])
    places = [np.flatnonzero(captures == name) for name in np.unique(captures)]
    chosen = [int(place[probabilities[place].argmax()]) for place in places]
    overlaps = np.array([rows[index]["overlap"] for index in chosen])
    return overlaps >= mask_scores.RIGHT_OVERLAP, overlaps < WRONG_MEDIAN, probabilities[chosen]


def fit_logistic(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, float]:
    """Weights, none below 0, and offset of a logistic regression: the more of any measure, the less likely masks are right.

    The weights are drawn to a common one: what no masks here were wrong by counts, too.
    """
    count = x.shape[1]

    def measure_loss(weights_offset: np.ndarray) -> tuple[float, np.ndarray]:
        away = weights_offset[:count] - COMMON_WEIGHT
        odds = weights_offset[count] - x @ weights_offset[:count]
        loss = np.logaddexp(0, np.where(y, -odds, odds)).sum() + COMMON_STRENGTH * (away**2).sum()
        slope = expit(odds) - y
        return float(loss), np.append(2 * COMMON_STRENGTH * away - x.T @ slope, slope.sum())

    bounds = [(0.0, None)] * count + [(None, None)]
    found = minimize(measure_loss, np.full(count + 1, COMMON_WEIGHT), jac=True, bounds=bounds).x
    return found[:count], float(found[count])


def measure_overlap(found: Hypothesis, truth: Truth) -> float:
    """Intersection over union with the reference, of the median photo."""
    if all(true is None for true in truth.masks):
        return 0.0  # there is no single object
    overlaps = []
    for mask, window, view, true in zip(found.solution.masks, found.scene.windows, truth.scene.views, truth.masks, strict=True):
        if true is None:
            continue
        part, whole = scale_to(true, window, view), np.zeros_like(true)
        whole[part.slices] = cv2.resize(mask, (part.right - part.left, part.bottom - part.top)) > 0.5
        overlaps.append(compute_overlap(whole, true))
    return float(np.median(overlaps))


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("cues", "score"))
    parser.add_argument("--scenes", type=Path, nargs="+", required=True, help="folders with scene/ and reference/")
    parser.add_argument("--network", type=Path, required=True, help="ONNX file of a salient-object network")
    parser.add_argument("--segmenter", type=Path, required=True, help="file of MobileSAM")
    parser.add_argument("--cache", type=Path, default=Path("results/fit_masks"), help="delete it when cues or measures change")
    args = parser.parse_args()
    {"cues": fit_cues, "score": fit_score}[args.what](args)


if __name__ == "__main__":
    main()
