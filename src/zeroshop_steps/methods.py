"""Which methods the matrix has, what each needs, and what of that is missing here.

A method is one file in the folder of its stage, which declares itself by a literal at its top level:

    METHOD = {"weights": ("my_network.pth",), "mem_mb": 6000}

or a row of PRESETS there, the same method by another name, with other weights or options of the config:

    PRESETS = {"mine_large": {"weights": ("my_large_network.pth",), "mem_mb": 9000}}

The keys are those attributes of `Method` that are not the default; {} will do. The literal is read from the source, so that
planning a run imports no step. A method without its weights is left out where "all" methods are meant, and refused where it is named.
"""

import ast
import functools
import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from zeroshop_steps.networks.weights import WEIGHTS_FOLDER, read_table
from zeroshop_steps.runtime.errors import StepError

SOURCES = Path(__file__).parent
CUDA_MB = 1000
"""GPU memory of a process before it has any tensor: CUDA's context, PyTorch's and Numba's code."""
WITHOUT_CAMERAS = "none"
"""The place of a registration in the path of a surface method that needs none."""


@dataclass(frozen=True)
class Method:
    """What a method needs and gives.

    Attributes:
        step: the module that does the work, below this package, e.g. "surface.twodgs".
        name: how configs and paths call it; the module's name by default.
        preset: whether it is a row of PRESETS: its step is told its weights, and all that the config has of it.
        title: how papers write it, for reports; the name by default.
        rank: its place in tables, the lowest first; then by name.
        defaults: options of its step that a preset has in place of the step's own.
        weights: files below resources/weights.
        models: its networks that the config may exchange: for the key of its options that names the folder of one, the usual folder
            below resources/weights and the files in it.
        choices: networks that the config chooses among: for the key of its options, the files below resources/weights that each of its
            values needs; the first is the usual one.
        mem_mb, runtime_min: what its rule asks a scheduler for, with about 20 images.
        threads: the most that its rule uses.
        gpu_bytes: what its kernels for CUDA take of the card for each "primitive", of which its options allow `count_max`, and for each
            "pixel" of a training image; empty where it has no such kernels.

    Of registrations:
        true_cameras: it needs true cameras, which photos lack.
        given_cameras: it takes those that come with a capture, which rendered ones lack; "all" does not mean it.
        tries: the registrations that it tries one after the other, those whose weights are there; "all" does not mean it.
        saliency: it finds masks by the salient-object network of the config (`segment.saliency`), if that is there.

    Of segmentations:
        saliency: it needs this network.
        given: the masks come with the capture; the config cannot choose it.
        in_scene: it finds masks only in a scene that is registered already.
        prompt: it takes the words that describe the object.

    Of heights:
        given_height: it needs the object's height in metres.
        given_cameras: it takes the metres of cameras that come with the capture.
        columns: columns of objects.tsv with folders of photos that it reads.
        required: those of them without which it cannot work.
        original_photos: it needs the photos as they were taken, not frames of a video nor undistorted ones.
        seed: it takes a random seed.

    Of surfaces:
        stereo, registration: whether it reads confirmed depths, and registered cameras; without those it reads the capture.
        generated: its raw mesh is a likely shape with colours, not a measured one.
        cameras_optional: it can do without registered cameras, too: then it reads the capture and the object's height.
        model: the file of its trained model, below its folder of the cell; None where it makes the raw mesh in one step.
        mesh: the method of this stage that takes the raw mesh from the model.
        rules: the names of its rules: training (or the only one), and taking the mesh.
        options: below which keys the config has the options of each.

    Of renderers:
        environment: the file that says that an environment of its own is ready, where it needs one.
        samples: it takes the number of light paths per pixel.

    Of detectors:
        masks: the file that poses are estimated from: all that it found, or masks.json, the sure ones without overlap.

    Of pose estimators:
        templates: it reads the views of the models that detectors read.
    """

    step: str
    name: str = ""
    preset: bool = False
    title: str = ""
    rank: int = 100
    defaults: dict[str, Any] = field(default_factory=dict)
    weights: tuple[str, ...] = ()
    models: dict[str, tuple[str, tuple[str, ...]]] = field(default_factory=dict)
    choices: dict[str, dict[str, tuple[str, ...]]] = field(default_factory=dict)
    mem_mb: int = 4000
    runtime_min: int = 30
    threads: int = 8
    gpu_bytes: dict[str, int] = field(default_factory=dict)
    true_cameras: bool = False
    given_cameras: bool = False
    tries: tuple[str, ...] = ()
    saliency: bool = False
    given: bool = False
    in_scene: bool = False
    prompt: bool = False
    given_height: bool = False
    columns: tuple[str, ...] = ()
    required: tuple[str, ...] = ()
    original_photos: bool = False
    seed: bool = False
    stereo: bool = True
    generated: bool = False
    registration: bool = True
    cameras_optional: bool = False
    model: str | None = None
    mesh: str | None = None
    rules: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    environment: str = ""
    samples: bool = False
    masks: str = "detections.json"
    templates: bool = False

    @property
    def files(self) -> tuple[str, ...]:
        """All files below resources/weights that it reads."""
        chosen = (next(iter(values.values())) for values in self.choices.values())
        models = (f"{folder}/{name}" for folder, names in self.models.values() for name in names)
        return (*self.weights, *models, *itertools.chain.from_iterable(chosen))

    def gpu_mem_mb(self, options: Mapping[str, Any]) -> int:
        """Predicted GPU memory with these options of the config, in MB; 0 where they have it run on the processor.

        A network takes about what it takes of the processor's memory. Kernels take `CUDA_MB`, and what grows with the primitives and the
        pixels of upright images of 3:4.
        """
        device = options.get("device", "auto" if self.files else "cpu")
        if device == "cpu" or not (self.files or self.gpu_bytes):
            return 0
        if not self.gpu_bytes:
            return self.mem_mb
        pixels = options["image_width_px"] ** 2 * 4 // 3
        return CUDA_MB + -(-(self.gpu_bytes["primitive"] * options["count_max"] + self.gpu_bytes["pixel"] * pixels) // 10**6)

    def with_options(self, options: Mapping[str, Any]) -> "Method":
        """The method with the networks that these options of the config name, and without published weights where they name own ones."""
        models = {key: (str(options.get(key, folder)), names) for key, (folder, names) in self.models.items()}
        choices = {
            key: {name: values[name]} for key, values in self.choices.items() for name in [str(options.get(key, next(iter(values))))]
        }
        chosen = replace(self, models=models, choices=choices)
        return replace(chosen, weights=()) if options.get("weights") else chosen


@functools.cache
def find_methods(stage: str, sources: Path = SOURCES) -> dict[str, Method]:
    """The methods of a stage by name, in the order of tables: every module of its folder that declares METHOD.

    Raises:
        StepError: a declaration that is no literal dictionary of known keys, or two methods of one name.
    """
    found = []
    for path in sorted([*(sources / stage).glob("*.py"), *(sources / stage).glob("*/__init__.py")]):
        declared = _read_declaration(path, "METHOD")
        if declared is not None:
            module = path.parent.name if path.name == "__init__.py" else path.stem
            usual = {"step": f"{stage}.{module}", "name": module, **declared}
            rows = [
                {**usual, "title": "", "name": name, "preset": True, **row}
                for name, row in (_read_declaration(path, "PRESETS") or {}).items()
            ]
            found += [replace(method, title=method.title or method.name) for method in (Method(**row) for row in (usual, *rows))]
    names = [method.name for method in found]
    for name in names:
        if names.count(name) > 1:
            raise StepError(f"two methods of {sources / stage} are called {name}; give one another name in its METHOD")
    return {method.name: method for method in sorted(found, key=lambda method: (method.rank, method.name))}


def _read_declaration(path: Path, what: str) -> dict[str, Any] | None:
    """The METHOD or the PRESETS of a source file; None where it declares none."""
    text = path.read_text()
    if f"\n{what}" not in text:
        return None
    known = {entry.name for entry in fields(Method)} - {"step", "preset"}
    for node in ast.parse(text).body:
        targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        if [getattr(target, "id", None) for target in targets] == [what]:
            try:
                declared = ast.literal_eval(node.value)  # type: ignore[attr-defined]
                rows = [declared] if what == "METHOD" else list(declared.values())
                if all(isinstance(row, dict) and set(row) <= known for row in rows):
                    return dict(declared)
            except (ValueError, AttributeError):
                pass
            kind = "a dictionary" if what == "METHOD" else "a dictionary of such by name"
            raise StepError(f"{path}: {what} must be {kind} written out, with keys of {', '.join(sorted(known))}")
    return None


RENDERERS = find_methods("synthetic")
REGISTRATIONS = find_methods("register")
SEGMENTATIONS = {name: method for name, method in find_methods("segment").items() if not method.given}
"""Of captures without masks; "auto" is the first that can run here."""
SURFACES = find_methods("surface")
HEIGHTS = find_methods("height")
GIVEN_HEIGHTS = [name for name, method in HEIGHTS.items() if method.given_height]
"""Those that take a height that the user gives."""
BY_GIVEN_CAMERAS, HEIGHT_BY_GIVEN_CAMERAS = (
    next((name for name, method in table.items() if method.given_cameras), None) for table in (REGISTRATIONS, HEIGHTS)
)
"""How captures that bring cameras are registered, and get their height, where nothing else is asked for."""
DETECTORS = find_methods("detect")
ESTIMATORS = find_methods("pose")
"""Of poses, from true masks or from those of a detector."""

CHOICES = {
    "renderer": list(RENDERERS),
    "virtual_registration": [name for name, method in REGISTRATIONS.items() if not method.given_cameras],
    "photo_registration": [*(name for name, method in REGISTRATIONS.items() if not method.true_cameras), WITHOUT_CAMERAS],
    "nvs_method": list(SURFACES),
    "segmentation": ["auto", *SEGMENTATIONS],
    "detector": list(DETECTORS),
    "estimator": list(ESTIMATORS),
}
"""What the config may name, by the definition in its schema."""
TITLES = {name: method.title for table in (REGISTRATIONS, SURFACES, HEIGHTS) for name, method in table.items()}
"""How reports call the methods of a cell."""
SECTIONS = {
    "register": REGISTRATIONS,
    "segment": SEGMENTATIONS,
    "nvs": SURFACES,
    "height": HEIGHTS,
    "detect": DETECTORS,
    "pose": ESTIMATORS,
}
"""The parts of the config that hold options of methods."""


def lacks(method: Method, root: Path = Path()) -> list[str]:
    """What a method needs and does not find, in words; empty where it can run. `root` is the folder that holds resources/."""
    return [f"the weights {WEIGHTS_FOLDER / name}" for name in method.files if not (root / WEIGHTS_FOLDER / name).is_file()]


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
    absent = [name for name in method.files if not (root / WEIGHTS_FOLDER / name).is_file()]
    table = read_table()
    return "".join(f" {table[name].file}: {table[name].advice}." for name in absent if name in table)
