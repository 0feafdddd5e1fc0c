"""Which methods the matrix has, what each needs, and what of that is missing here.

A method without its step or its weights is left out where "all" methods are meant, and refused where it is named.
"""

import importlib.util
from dataclasses import dataclass
from pathlib import Path

from zeroshop_steps.networks.weights import WEIGHTS_FOLDER, read_table

PACKAGE = "zeroshop_steps"


@dataclass(frozen=True)
class Method:
    """What a method needs.

    Attributes:
        step: the module that does the work, below this package.
        weights: files below resources/weights.
        truth: whether it needs true cameras, which photos lack.
        mem_mb, runtime_min: what its rule asks a scheduler for, with about 20 images.
        masks: of a detector, the file that poses are estimated from: all that it found, or masks.json, the sure ones without overlap.
    """

    step: str
    weights: tuple[str, ...] = ()
    truth: bool = False
    mem_mb: int = 4000
    runtime_min: int = 30
    masks: str = "detections.json"


REGISTRATIONS = {
    "colmap": Method("register.colmap"),
    "truth": Method("register.truth", truth=True),
    "mast3r": Method("register.mast3r", weights=("MASt3R_ViTLarge_BaseDecoder_512_catmlpdpt_metric.pth",), mem_mb=6000, runtime_min=480),
    "vggt": Method("register.vggt", weights=("VGGT-1B/model.safetensors",), mem_mb=12000, runtime_min=240),
}
DETECTOR, TRACKER = "grounding-dino-base", "sam2.1-hiera-large"
DETECTOR_FILES = ("model.safetensors", "config.json", "preprocessor_config.json", "tokenizer.json", "tokenizer_config.json")
TRACKER_FILES = ("model.safetensors", "config.json")


def grounded_sam(detector: str = DETECTOR, tracker: str = TRACKER) -> Method:
    """Segmentation by a prompt, with these two folders below resources/weights."""
    files = (*(f"{detector}/{name}" for name in DETECTOR_FILES), *(f"{tracker}/{name}" for name in TRACKER_FILES))
    return Method("segment.grounded_sam", weights=files)


SEGMENTATIONS = {
    "grounded_sam": grounded_sam(),
    "support_plane": Method("segment.support_plane"),
}
"""Of captures without masks; "auto" is the first that can run here."""
NVS = {
    "2dgs": Method("surface.twodgs"),
    "svraster": Method("surface.svraster"),
}
HEIGHTS = {
    "known": Method("height.known"),
    "marker": Method("height.marker"),
    "depth_camera": Method("height.depth_camera"),
    "mast3r": Method("height.mast3r", weights=("MASt3R_ViTLarge_BaseDecoder_512_catmlpdpt_metric.pth",), mem_mb=6000, runtime_min=120),
    "none": Method("height.none"),
}
DETECTORS = {
    "contour": Method("detect.contour"),
    "cnos": Method(
        "detect.cnos",
        weights=tuple(f"{model}/{file}" for model in ("sam-vit-huge", "dinov2-large") for file in ("model.safetensors", "config.json")),
        masks="masks.json",
    ),
    "sam6d_ism": Method("detect.sam6d_ism", weights=("dinov2-large/model.safetensors", "sam-vit-huge/model.safetensors")),
}
ESTIMATORS = {
    "render_compare": Method("pose.render_compare"),
    "foundationpose": Method("pose.foundationpose", weights=("foundationpose/refiner.pth", "foundationpose/scorer.pth")),
    "sam6d_pem": Method("pose.sam6d_pem", weights=("sam6d_pem/model.pth",)),
}
"""Of poses, from true masks or from those of a detector."""


def lacks(method: Method, root: Path = Path()) -> list[str]:
    """What a method needs and does not find, in words; empty where it can run. `root` is the folder that holds resources/."""
    if importlib.util.find_spec(f"{PACKAGE}.{method.step}") is None:
        return [f"the step {method.step}, which this version does not have"]
    return [f"the weights {WEIGHTS_FOLDER / name}" for name in method.weights if not (root / WEIGHTS_FOLDER / name).is_file()]


def left_out(*tables: dict[str, Method], root: Path = Path()) -> str | None:
    """One line on the methods that "all" does not mean here; None where it means every one."""
    missing = {name: lacks(method, root) for methods in tables for name, method in methods.items()}
    reasons = [f"{name} lacks {' and '.join(what)}" for name, what in missing.items() if what]
    return f"Left out of tables: {'; '.join(reasons)}." if reasons else None


def refusal(what: str, name: str, methods: dict[str, Method], root: Path = Path()) -> str | None:
    """Why a method that was named cannot run here, with those that can; None where it can."""
    missing = lacks(methods[name], root)
    if not missing:
        return None
    able = [other for other in methods if not lacks(methods[other], root)]
    return (
        f"{what} {name} cannot run here, it lacks {' and '.join(missing)}. Those that can: {', '.join(able)}.{_advice(methods[name], root)}"
    )


def _advice(method: Method, root: Path) -> str:
    """How to get the weights that a method lacks."""
    absent = [name for name in method.weights if not (root / WEIGHTS_FOLDER / name).is_file()]
    table = read_table()
    return "".join(f" {table[name].file}: {table[name].advice}." for name in absent if name in table)
