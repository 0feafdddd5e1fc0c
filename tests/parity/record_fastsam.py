"""Record what ultralytics' YOLOv8-seg, of which FastSAM is one, answers, for networks/fastsam (README.md says how).

ultralytics is under the AGPL: it is neither installed with this project nor copied. Only numbers come from it.
"""

import resource
import sys
import time
from pathlib import Path

import numpy as np
import torch
from ultralytics.nn.tasks import SegmentationModel, yaml_model_load
from ultralytics.yolo.utils.ops import non_max_suppression, process_mask

from helpers import fastsam_cases as cases

FOLDER = Path(__file__).parent


def make_network(scale: str) -> torch.nn.Module:
    """The reference in one of its sizes, for one class, with random parameters."""
    network = SegmentationModel({**yaml_model_load("yolov8n-seg.yaml"), "scale": scale, "nc": 1}, nc=1, verbose=False)
    shapes = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    network.load_state_dict(cases.parameters(shapes), strict=False)
    return network.float().eval()


def run(network: torch.nn.Module, image: torch.Tensor) -> dict[str, torch.Tensor]:
    """Its raw answers and its masks."""
    start_s = time.process_time()
    answers, (_, __, prototypes) = network(image)
    print(f"{time.process_time() - start_s:.1f} s CPU, {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")
    (kept,) = non_max_suppression(answers, cases.LEAST_LIKELIHOOD, cases.MOST_IOU, max_det=cases.MOST, nc=1)
    masks = process_mask(prototypes[0], kept[:, 6:], kept[:, :4], image.shape[2:], upsample=True)
    # The suppression has turned the boxes of the answers into corners, in place.
    return {"answers": answers[0].T, "prototypes": prototypes[0], "kept": kept, "masks": masks.bool()}


@torch.no_grad()
def main() -> None:
    """Record the small network, and the names and shapes of the full one; with a folder as argument, a pass of the full one."""
    if len(sys.argv) > 1:
        found = run(make_network("x"), cases.image((480, 640)))
        np.savez(Path(sys.argv[1]) / "fastsam_full.npz", **{name: np.asarray(tensor) for name, tensor in found.items()})
        return
    found = run(make_network("n"), cases.image())
    np.savez_compressed(FOLDER / "fastsam.npz", **{name: np.asarray(tensor) for name, tensor in found.items()})
    lines = [f"{name} {'x'.join(map(str, tensor.shape))}".rstrip() + "\n" for name, tensor in make_network("x").state_dict().items()]
    (FOLDER / "fastsam_parameters.txt").write_text("".join(lines))


if __name__ == "__main__":
    main()
