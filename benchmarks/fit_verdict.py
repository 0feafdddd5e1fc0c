"""Fit the verdict on cameras, on models whose truth is known.

    python benchmarks/fit_verdict.py alike --out CAPTURES
    python benchmarks/fit_verdict.py sample --captures FOLDER... --network u2netp.onnx --out SAMPLES
    python benchmarks/fit_verdict.py fit --samples SAMPLES --half tune

`alike` renders captures of objects whose sides look alike. `sample` makes models of rendered captures (see verdict_samples.py) and writes a
JSON for each; captures that have one are passed over. `fit` writes register/verification/verdict_weights.json from the objects of one half.
It prints how these and equal weights do on objects that were left out in turn, without each measure, and on the other half.
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

from alike_objects import ALIKE_OBJECTS, write_alike_capture
from capture_benchmark.table import choose_half
from verdict_samples import sample
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.register.verification.verdict import MAX_WRONG_PROBABILITY, MEASURES, MOST_STRENGTH, WEIGHTS

MOST_MEAN, MOST_WORST = 0.01, 0.05  # errors of right cameras, of the object's diameter
PHOTOS = (10, 12, 14)  # of captures all around an object
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
    makes.add_argument("--network", type=Path, help="ONNX file of a salient-object network; without, for captures of `alike`")
    makes.add_argument("--out", type=Path, required=True, help="folder of the samples")
    makes.add_argument("--quick", action="store_true", help="neither repair nor refine the models, in a third of the time")
    makes.set_defaults(run=make_samples)
    alikes = commands.add_parser("alike", help="render captures of objects whose sides look alike")
    alikes.add_argument("--out", type=Path, required=True, help="folder of the captures")
    alikes.set_defaults(run=lambda args: render_alike(args.out))
    fits = commands.add_parser("fit", help="fit the weights")
    fits.add_argument("--samples", type=Path, required=True, help="folder of the samples")
    fits.add_argument("--half", choices=("tune", "judge", "both"), default="tune", help="objects to fit on (default: %(default)s)")
    fits.set_defaults(run=fit_verdict)
    args = parser.parse_args()
    args.run(args)


def render_alike(out: Path) -> None:
    """Render two captures of each object, with print below it and without, each unless it is there."""
    for place, name in enumerate(ALIKE_OBJECTS):
        for number in (1, 2):
            if not (out / f"{name}_{number}").is_dir():
                photos = PHOTOS[(place + number) % len(PHOTOS)]
                write_alike_capture(name, number, out / f"{name}_{number}", photos, printed=(place + number) % 2 == 0)


def make_samples(args: argparse.Namespace) -> None:
    """Write the samples of each capture."""
    pycolmap.logging.minloglevel = pycolmap.logging.ERROR
    network = SalientObjectNetwork(args.network) if args.network else None
    args.out.mkdir(parents=True, exist_ok=True)
    for capture in args.captures:
        path = args.out / f"{capture.name}.json"
        if path.is_file():
            continue
        with tempfile.TemporaryDirectory() as scratch:
            rows = []
            for row in sample(capture, network, Path(scratch), refined=not args.quick):
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
    rows = read_samples(args.samples)
    measures = list(MEASURES)
    strengths = np.array([[min(row["strengths"].get(name, 0.0), MOST_STRENGTH) for name in measures] for row in rows])
    wrong, objects = np.array([is_wrong(row) for row in rows]), np.array([row["object"] for row in rows])
    halves = np.array([choose_half(name) for name in objects])
    fitted = (halves == args.half) | (args.half == "both")
    print(f"{fitted.sum()} models of {len(set(objects[fitted]))} objects, {wrong[fitted].sum()} wrong")
    values, truth, names = strengths[fitted], wrong[fitted], objects[fitted]
    losses = {}
    for power in POWERS:
        left_out = leave_out_objects(values**power, truth, names)
        losses[power] = measure_loss(left_out, truth)
        print(f"power {power:.0f}: cross entropy {losses[power]:.3f}; {describe(left_out, truth)}")
    power = min(losses, key=losses.__getitem__)
    for number, name in enumerate(measures):
        left_out = leave_out_objects(np.delete(values, number, 1) ** power, truth, names)
        print(f"  without {name}: cross entropy {measure_loss(left_out, truth):.3f}; {describe(left_out, truth)}")
    parameters = fit_logistic(values**power, truth)
    weights = {name: round(float(value), 3) for name, value in zip(measures, parameters[:-1], strict=True)}
    WEIGHTS.write_text(json.dumps({"power": power, "offset": round(float(parameters[-1]), 3), "weights": weights}) + "\n")
    print(f"power {power:.0f}, offset {parameters[-1]:.2f}, {weights}")
    equal = np.append(np.full(len(measures), COMMON), OFFSET)
    for half, among in (("fitted", fitted), ("judged", ~fitted)):
        for what, chosen, raised in (("equal", equal, POWERS[-1]), ("fitted", parameters, power)):
            if among.any():
                judged = predict(strengths[among] ** raised, chosen)
                print(f"{half} half, {what} weights, {among.sum()} models: {describe(judged, wrong[among])}")
                print_calibration(judged, wrong[among])


def read_samples(folder: Path) -> list[dict[str, Any]]:
    """The rows of all samples, with their `object`. Photos of every second capture count as frames of a film, which has a `jump`."""
    rows = []
    for path in sorted(folder.glob("*.json")):
        name, _, number = path.stem.rpartition("_")
        for row in json.loads(path.read_text()):
            jump = {"jump": row["jump"]} if int(number) % 2 == 0 else {}
            rows.append(row | {"object": name, "strengths": row["strengths"] | jump})
    return rows


def measure_loss(probability: np.ndarray, wrong: np.ndarray) -> float:
    """Cross entropy of a prediction."""
    return -float(np.mean(xlogy(wrong, probability) + xlogy(~wrong, 1 - probability)))


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
