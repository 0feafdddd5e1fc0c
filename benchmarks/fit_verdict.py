"""Fit the verdict on cameras, on models whose truth is known.

    python benchmarks/fit_verdict.py sample --captures FOLDER... --network u2netp.onnx --out SAMPLES
    python benchmarks/fit_verdict.py fit --samples SAMPLES --half tune

`sample` makes models of rendered captures (see verdict_samples.py) and writes a JSON for each; captures that have one are passed over.
`fit` writes register/verification/verdict_weights.json from the objects of one half, and prints how it does on objects that were left out
in turn, and on those of the other half.
"""

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from scipy.optimize import minimize
from scipy.special import expit, xlogy

from capture_benchmark.table import choose_half
from verdict_samples import sample
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.register.verification.verdict import MAX_WRONG_PROBABILITY, MEASURES, MOST_STRENGTH, WEIGHTS

MOST_MEAN, MOST_WORST = 0.01, 0.05  # errors of right cameras, of the object's diameter
POWERS = (1.0, 2.0, 3.0, 4.0)
COMMON, OFFSET, PULL = 4.0, -4.0, 0.1
"""Weights are drawn to a common one by this much, and the offset likewise: then each measure convinces alone at its limit, as if none had
been seen. What no model here was wrong by counts, too."""


def main() -> None:
    """Sample or fit."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    makes = commands.add_parser("sample", help="make models")
    makes.add_argument("--captures", type=Path, nargs="+", required=True, help="folders of rendered captures, named OBJECT_NUMBER")
    makes.add_argument("--network", type=Path, required=True, help="ONNX file of a salient-object network")
    makes.add_argument("--out", type=Path, required=True, help="folder of the samples")
    makes.set_defaults(run=make_samples)
    fits = commands.add_parser("fit", help="fit the weights")
    fits.add_argument("--samples", type=Path, required=True, help="folder of the samples")
    fits.add_argument("--half", choices=("tune", "judge", "both"), default="tune", help="objects to fit on (default: %(default)s)")
    fits.set_defaults(run=fit_verdict)
    args = parser.parse_args()
    args.run(args)


def make_samples(args: argparse.Namespace) -> None:
    """Write the samples of each capture."""
    pycolmap.logging.minloglevel = pycolmap.logging.ERROR
    network = SalientObjectNetwork(args.network)
    args.out.mkdir(parents=True, exist_ok=True)
    for capture in args.captures:
        path = args.out / f"{capture.name}.json"
        if path.is_file():
            continue
        with tempfile.TemporaryDirectory() as scratch:
            rows = []
            for row in sample(capture, network, Path(scratch)):
                rows.append(row)
                wrong = "wrong" if is_wrong(row) else "right"
                strengths = " ".join(f"{name} {value:.2f}" for name, value in row["strengths"].items())
                print(f"{capture.name} {row['matches']} {row['kind']} {row['registered']}/{row['images']} {wrong}: {strengths}", flush=True)
        path.write_text(json.dumps(rows) + "\n")


def is_wrong(row: dict[str, Any]) -> bool:
    """Whether a model is."""
    return bool(row["mean_error"] > MOST_MEAN or row["worst_error"] > MOST_WORST)


def fit_verdict(args: argparse.Namespace) -> None:
    """Write the weights, and print what they do."""
    rows = []
    for path in sorted(args.samples.glob("*.json")):
        rows += [row | {"object": path.stem.rpartition("_")[0]} for row in json.loads(path.read_text())]
    measures = list(MEASURES)
    strengths = np.array([[min(row["strengths"].get(name, 0.0), MOST_STRENGTH) for name in measures] for row in rows])
    wrong, objects = np.array([is_wrong(row) for row in rows]), np.array([row["object"] for row in rows])
    halves = np.array([choose_half(name) for name in objects])
    fitted = (halves == args.half) | (args.half == "both")
    print(f"{fitted.sum()} models of {len(set(objects[fitted]))} objects, {wrong[fitted].sum()} wrong")
    losses = {}
    for power in POWERS:
        left_out = leave_out_objects(strengths[fitted] ** power, wrong[fitted], objects[fitted])
        losses[power] = -float(np.mean(xlogy(wrong[fitted], left_out) + xlogy(~wrong[fitted], 1 - left_out)))
        print(f"power {power:.0f}: cross entropy {losses[power]:.3f}; {describe(left_out, wrong[fitted])}")
    power = min(losses, key=losses.__getitem__)
    parameters = fit_logistic(strengths[fitted] ** power, wrong[fitted])
    weights = {name: round(float(value), 3) for name, value in zip(measures, parameters[:-1], strict=True)}
    WEIGHTS.write_text(json.dumps({"power": power, "offset": round(float(parameters[-1]), 3), "weights": weights}) + "\n")
    print(f"power {power:.0f}, offset {parameters[-1]:.2f}, {weights}")
    if not fitted.all():
        judged = predict(strengths[~fitted] ** power, parameters)
        print(f"the other half, {(~fitted).sum()} models, {wrong[~fitted].sum()} wrong: {describe(judged, wrong[~fitted])}")
        print_calibration(judged, wrong[~fitted])


def fit_logistic(values: np.ndarray, wrong: np.ndarray) -> np.ndarray:
    """(M + 1,) weights, none below 0, and the offset, for (N, M) values and (N,) bool."""

    def loss(parameters: np.ndarray) -> tuple[float, np.ndarray]:
        odds = values @ parameters[:-1] + parameters[-1]
        away = np.append(parameters[:-1] - COMMON, parameters[-1] - OFFSET)
        residual = expit(odds) - wrong
        cost = float((np.logaddexp(0, odds) - wrong * odds).sum() + PULL * (away**2).sum())
        return cost, np.append(values.T @ residual, residual.sum()) + 2 * PULL * away

    start = np.append(np.full(values.shape[1], COMMON), OFFSET)
    return np.asarray(minimize(loss, start, jac=True, method="L-BFGS-B", bounds=[(0, None)] * values.shape[1] + [(None, None)]).x)


def predict(values: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """(N,) probabilities of being wrong."""
    return np.asarray(expit(values @ parameters[:-1] + parameters[-1]))


def leave_out_objects(values: np.ndarray, wrong: np.ndarray, objects: np.ndarray) -> np.ndarray:
    """(N,) probabilities, those of each object by a fit to all others."""
    found = np.zeros(len(wrong))
    for name in np.unique(objects):
        own = objects == name
        found[own] = predict(values[own], fit_logistic(values[~own], wrong[~own]))
    return np.clip(found, 1e-6, 1 - 1e-6)


def describe(probability: np.ndarray, wrong: np.ndarray) -> str:
    """What is accepted and refused, and the area below the ROC curve."""
    refused = probability >= MAX_WRONG_PROBABILITY
    ranks = (probability[wrong][:, None] > probability[~wrong]) + 0.5 * (probability[wrong][:, None] == probability[~wrong])
    return (
        f"{(wrong & ~refused).sum()} of {wrong.sum()} wrong ones accepted, {(~wrong & refused).sum()} of {(~wrong).sum()} right ones"
        f" refused, area below the ROC curve {ranks.mean():.3f}"
    )


def print_calibration(probability: np.ndarray, wrong: np.ndarray) -> None:
    """How many models of each predicted probability are wrong."""
    for low, high in ((0, 0.05), (0.05, 0.2), (0.2, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 1.01)):
        among = (probability >= low) & (probability < high)
        if among.any():
            print(f"  predicted {low:.2f} to {min(high, 1):.2f}: {wrong[among].sum()} of {among.sum()} wrong")


if __name__ == "__main__":
    main()
