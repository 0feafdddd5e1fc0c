"""Train U²-Net small further, on rendered captures of the half `tune` with their exact masks.

It sees whole photos and surroundings of the object, as the masks' step does. The loss is the paper's: the cross entropy of the answer and
of all side outputs. Interrupted, the same command goes on from the checkpoint beside the network that it writes.
"""

import argparse
import dataclasses
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
import torch.nn.functional as F

from masked_photos import MaskedPhoto, find_rendered
from u2net import U2Net, read_weights, write_weights
from zeroshop_steps.geometry.imaging.images import read_image, read_mask
from zeroshop_steps.networks.saliency.salient_networks import DEFAULT, NETWORKS
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write
from zeroshop_steps.runtime.progress import ProgressReport

KNOWN = NETWORKS[DEFAULT]
WHOLE_SHARE = 0.5  # of the examples; the others are surroundings
MARGIN = 0.05, 0.8  # of surroundings, beyond the object, in its longer sides; each side of the picture has its own
EXPOSURE, TINT, GAMMA = 0.35, 0.12, 0.25  # spread of factors and exponents, as logarithms
NOISE = 6.0  # of 255, at most
CHECKPOINT_EVERY = 20  # updates
SHOWN = 20  # updates whose mean loss is shown


@dataclass(frozen=True)
class Settings:
    """What the result depends on, besides the network at the start and the photos.

    Attributes:
        updates: of the weights.
        batch: examples per update.
        learning_rate: of Adam at the start; it falls to 0 along a cosine.
        frozen: how many blocks at the start keep their weights: they see edges and colours, in which rendered photos differ from others.
        seed: of the choice of examples.
    """

    updates: int
    batch: int
    learning_rate: float
    frozen: int
    seed: int


def main() -> int:
    """Run the command line and return the exit status."""
    args = parse_arguments()
    torch.set_num_threads(args.threads)
    settings = Settings(args.updates, args.batch, args.learning_rate, args.frozen, args.seed)
    try:
        train(find_rendered(args.inputs, "tune"), args.network, settings, args.out)
    except StepError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\ninterrupted; the same command goes on from the last checkpoint", file=sys.stderr)
        return 130
    return 0


def parse_arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=Path, required=True, help="the benchmark's folder of stored captures")
    parser.add_argument("--network", type=Path, default=KNOWN.path, help="to start with, an ONNX file (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="the trained network, an ONNX file")
    parser.add_argument("--updates", type=int, default=160, help="of the weights (default: %(default)s)")
    parser.add_argument("--batch", type=int, default=2, help="examples per update (default: %(default)s)")
    parser.add_argument("--learning-rate", type=float, default=5e-5, help="at the start (default: %(default)s)")
    parser.add_argument("--frozen", type=int, default=1, help="blocks at the start that keep their weights (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the choice of examples (default: %(default)s)")
    parser.add_argument("--threads", type=int, default=1, help="of the processor (default: %(default)s)")
    return parser.parse_args()


def train(photos: list[MaskedPhoto], start: Path, settings: Settings, out: Path) -> None:
    """Train the network of the file `start` and write it to `out`.

    Raises:
        StepError: a file is missing or damaged, or a checkpoint is of another run.
    """
    network = U2Net()
    read_weights(network, start)
    for block in network.down[: settings.frozen]:
        block.requires_grad_(False)
    optimizer = torch.optim.Adam([one for one in network.parameters() if one.requires_grad], settings.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, settings.updates)
    parts = {"network": network, "optimizer": optimizer, "schedule": schedule}
    about = {**dataclasses.asdict(settings), "photos": len(photos)}
    checkpoint = out.with_suffix(".checkpoint.pt")
    done = load_checkpoint(checkpoint, parts, about) if checkpoint.is_file() else 0
    losses: list[float] = []
    with ProgressReport("training", settings.updates, done=done) as report:
        for update in range(done, settings.updates):
            losses.append(take_step(network, optimizer, photos, settings, update))
            schedule.step()
            if (update + 1) % CHECKPOINT_EVERY == 0:
                save_checkpoint(checkpoint, parts, about, update + 1)
            report.advance(note=f"loss {np.mean(losses[-SHOWN:]):.3f}")
    write_weights(network, start, out)
    checkpoint.unlink(missing_ok=True)


def take_step(network: U2Net, optimizer: torch.optim.Optimizer, photos: list[MaskedPhoto], settings: Settings, update: int) -> float:
    """One update of the weights; returns the mean loss. Its examples depend on its number alone, so that a run can go on."""
    rng = np.random.default_rng([settings.seed, update])
    optimizer.zero_grad(set_to_none=True)
    total = 0.0
    for index in rng.integers(len(photos), size=settings.batch):
        image, mask = make_example(photos[index], rng)
        loss = sum(F.binary_cross_entropy_with_logits(output, mask) for output in network(image)) / settings.batch
        loss.backward()
        total += loss.item()
    optimizer.step()
    return total


def make_example(one: MaskedPhoto, rng: np.random.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """A photo or a part of it as the network takes it, (1, 3, S, S), and its mask, (1, 1, S, S), 0 to 1."""
    image = read_image(one.photo)
    mask = read_mask(one.mask, (image.shape[1], image.shape[0]))
    if rng.random() > WHOLE_SHARE and mask.any():
        part = choose_surroundings(mask, rng)
        image, mask = image[part], mask[part]
    if rng.random() < 0.5:
        image, mask = image[:, ::-1], mask[:, ::-1]
    size = KNOWN.side_px, KNOWN.side_px
    small = cv2.resize(np.ascontiguousarray(image), size, interpolation=cv2.INTER_AREA).astype(np.float32)
    truth = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    levels = ((vary_light(small, rng) - KNOWN.mean) / KNOWN.deviation).astype(np.float32)
    return torch.from_numpy(levels.transpose(2, 0, 1)[None].copy()), torch.from_numpy(truth[None, None])


def choose_surroundings(mask: np.ndarray, rng: np.random.Generator) -> tuple[slice, slice]:
    """Rows and columns of a rectangle around the object of an (H, W) mask, which ends where the photo does."""
    rows, columns = np.nonzero(mask)
    aside = rng.uniform(*MARGIN, 4) * max(np.ptp(rows), np.ptp(columns), 1)
    top, left = max(0, int(rows.min() - aside[0])), max(0, int(columns.min() - aside[1]))
    return slice(top, int(rows.max() + aside[2]) + 1), slice(left, int(columns.max() + aside[3]) + 1)


def vary_light(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(H, W, 3) levels, 0 to 255, under another exposure, white balance and tone curve, with noise."""
    factors = np.exp(rng.uniform(-EXPOSURE, EXPOSURE) + rng.uniform(-TINT, TINT, 3))
    varied = 255 * (image / 255) ** np.exp(rng.uniform(-GAMMA, GAMMA)) * factors
    return np.clip(varied + rng.normal(0, rng.uniform(0, NOISE), image.shape), 0, 255)


def save_checkpoint(path: Path, parts: dict[str, Any], about: dict[str, Any], done: int) -> None:
    """Write all that is needed to go on after `done` updates, whole or not at all."""
    with atomic_write(path) as file:
        torch.save({"about": about, "done": done, **{name: part.state_dict() for name, part in parts.items()}}, file)


def load_checkpoint(path: Path, parts: dict[str, Any], about: dict[str, Any]) -> int:
    """Put the parts into the state of a checkpoint; returns how many updates were done."""
    try:
        state = torch.load(path, weights_only=True)
    except Exception as error:  # what pickle, zipfile and torch raise for damaged files has no common class
        raise StepError(f"{path} cannot be read ({str(error).splitlines()[0]}); delete it to start anew") from None
    if state["about"] != about:
        raise StepError(f"{path} is of a run with {state['about']}, this one has {about}; delete it, or give the same options")
    for name, part in parts.items():
        part.load_state_dict(state[name])
    return int(state["done"])


if __name__ == "__main__":
    sys.exit(main())
