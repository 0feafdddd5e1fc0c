"""`zeroshop doctor`: which of the thesis's networks this machine's card can hold, and what is missing for them.

Memory is foreseen, not measured on a card: by each network's own prediction where it has one, otherwise by what its rule asks for.
"""

import importlib.util
import os
import platform
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import psutil

from zeroshop_steps import __version__, methods
from zeroshop_steps.app.project_folders import find_weights_home, list_everyday_weights
from zeroshop_steps.networks.devices import PROCESS_BYTES, RESERVE
from zeroshop_steps.networks.weights import look_up_weights
from zeroshop_steps.runtime.errors import StepError

SIZE_PX = (518, 392)
"""Of the images of 2000 x 1500 px, as VGGT sees them."""
SAM_BYTES, SAM_ATTENTION_BYTES = 2_564_000_000, 4 * 16 * 64**4
"""Of SAM's weights and of its largest matrix of attention."""


@dataclass(frozen=True)
class Need:
    """A network's need of memory.

    Attributes:
        what: the network and its task.
        least_gb: with as few images or poses at a time as it can do with.
        most_gb: with as many as are of use.
        share: of the free memory that it takes at most.
    """

    what: str
    least_gb: float
    most_gb: float
    share: float = RESERVE

    def on(self, free_gb: float) -> str:
        """Whether it fits into so much free memory, in a word or two."""
        if self.least_gb > self.share * free_gb:
            return "no"
        return "yes" if self.most_gb <= self.share * free_gb else "in parts"

    def __str__(self) -> str:
        """The network and its memory."""
        most = f" to {self.most_gb:.1f}" if self.most_gb > self.least_gb else ""
        return f"{self.what} ({self.least_gb:.1f} GB{most})"


def foresee() -> list[Need]:
    """The networks of the thesis."""
    from zeroshop_steps.detect import cnos, mask_proposals
    from zeroshop_steps.networks.trellis.memory import predict_memory
    from zeroshop_steps.networks.trellis.settings import TrellisSettings
    from zeroshop_steps.networks.vggt.settings import VggtSettings
    from zeroshop_steps.pose.foundationpose.networks import MOST_PAIRS
    from zeroshop_steps.pose.foundationpose.networks import predict_peak_bytes as predict_poses
    from zeroshop_steps.register.vggt.memory import CHUNKS, predict_peak_bytes

    weights = look_up_weights("VGGT-1B/model.safetensors").size_bytes or 0
    found = [_of_rule("MASt3R: cameras of 20 images", methods.REGISTRATIONS["mast3r"])]
    for points, name in ((1024, "quarter"), (4096, "full")):
        for images in (20, 30):
            predict = partial(predict_peak_bytes, VggtSettings(), weights, images, SIZE_PX, points, half=True)
            most, least = (predict(chunk=CHUNKS["cuda"][end]) for end in (0, -1))
            found.append(Need(f"VGGT, {name} precision: cameras of {images} images", least / 1e9, most / 1e9, share=1.0))
    describer, _ = cnos.METHOD["models"]["describer"]
    shared = PROCESS_BYTES + mask_proposals.CROPS_BYTES + (look_up_weights(f"{describer}/model.safetensors").size_bytes or 0)
    fast = (shared + mask_proposals.FASTSAM_BYTES) / 1e9
    slow = (shared + SAM_BYTES + mask_proposals.ATTENTION_COPIES * SAM_ATTENTION_BYTES) / 1e9
    trellis = predict_memory(TrellisSettings()).peak_bytes / 1e9
    return [
        *found,
        _of_rule("MASt3R: heights", methods.HEIGHTS["mast3r"]),
        _of_rule("Grounding DINO and SAM 2: masks of films", methods.SEGMENTATIONS["grounded_sam"]),
        *(Need(f"{method.title}: training", *[method.gpu_mem_mb(_regime(method.name)) / 1e3] * 2) for method in _trained()),
        Need("Trellis: meshes", trellis, trellis),
        Need("CNOS with FastSAM: detection", fast, fast),
        Need("SAM-6D with SAM: detection", slow, slow),
        Need("FoundationPose: poses", predict_poses(1) / 1e9, predict_poses(MOST_PAIRS["cuda"]) / 1e9),
        _of_rule("SAM-6D: poses", methods.ESTIMATORS["sam6d_pem"]),
    ]


def _trained() -> list[methods.Method]:
    return [methods.SURFACES[name] for name in ("2dgs", "svraster")]


def _regime(name: str) -> dict[str, object]:
    """What of the thesis's training decides about memory (config/thesis.yaml)."""
    return {"device": "cuda", "count_max": 200_000, "image_width_px": {"2dgs": 400, "svraster": 250}[name]}


def _of_rule(what: str, method: methods.Method) -> Need:
    return Need(what, method.mem_mb / 1e3, method.mem_mb / 1e3)


def list_missing(root: Path = Path(), find: Callable[[str], object] = importlib.util.find_spec) -> list[str]:
    """What is not installed or not there, and how to get it."""
    found = []
    for module, remedy in (("numba_cuda", "make gpu"), ("onnxruntime", "make gpu"), ("gdown", "pip install gdown")):
        if find(module) is None:
            found.append(f"the Python package {module}: {remedy}")
    if not any(shutil.which(name) for name in ("python3.11", "uv", "micromamba", "mamba", "conda")):
        found.append("Python 3.11 for BlenderProc: pip install uv, which fetches it")
    needed = [
        *methods.REGISTRATIONS.values(),
        *methods.HEIGHTS.values(),
        methods.SEGMENTATIONS["grounded_sam"],
        methods.SURFACES["trellis"],
    ]
    needed += [*methods.DETECTORS.values(), methods.ESTIMATORS["foundationpose"], methods.ESTIMATORS["sam6d_pem"]]
    for method in needed:
        if methods.lacks(method, root) and not method.name.startswith(("da3", "vggt_")):
            found.append(f"weights of {method.name}: snakemake weights/{method.name}")
    return list(dict.fromkeys(found))


def examine() -> int:
    """Print what this machine is, what networks need, what the card can run, and what is missing; nothing of that is a fault."""
    import torch

    memory_gb = psutil.virtual_memory().total / 1e9
    print(f"zeroshop  {__version__}, Python {platform.python_version()}, {os.cpu_count()} cores, {memory_gb:.0f} GB of memory")
    home = find_weights_home()
    for row in list_everyday_weights():
        print(f"{'ready' if (home / row.path).is_file() else 'missing':9} weights {row.file}, for {row.purpose}")
    for line in list_missing(home):
        print(f"missing   {line}")
    if not torch.cuda.is_available():
        reason = "PyTorch finds no card" if torch.backends.cuda.is_built() else "this build of PyTorch is for the processor alone"
        print(f"no card   {reason}; networks and training run on the processor")
        print("\n".join(f"needs     {need}" for need in foresee()))
        return 0
    try:
        free, total = (amount / 1e9 for amount in torch.cuda.mem_get_info())
    except RuntimeError as error:
        raise StepError(f"the card does not answer: {str(error).splitlines()[0]}") from error
    print(f"card      {torch.cuda.get_device_name()}: {free:.1f} of {total:.1f} GB free")
    print("\n".join(f"{need.on(free):9} {need}" for need in foresee()))
    return 0
