"""In what a figure of ours differs from the published one that it might stand for: only where in nothing, it counts as reproduced.

Compared are the images (renderer, size, number), the registration and its numbers, the regime of the training, the test images and the
networks' inputs, as the results themselves record them. What is known of our implementations is in `METHODS`: "ZeroShOP: Zero-shot
object pose estimation in unconstrained environments", TU Wien, January 2026, and its published pipeline.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zeroshop_steps.methods import REGISTRATIONS
from zeroshop_steps.report.site.results_index import Cell, read_facts
from zeroshop_steps.runtime.files import read_json

VIEWS = {"su_l": 20, "su_h": 20, "se": 30}
CAPTURE = {"renderer": "blenderproc", "samples": 16, "width_px": 2000, "height_px": 1500}
PARAMETERS: dict[str, dict[str, Any]] = {
    "mast3r": {"min_track": 5},
    "vggt_1024": {"refine": "tracks", "tracked_points": 1024, "lens": "SIMPLE_PINHOLE", "max_error_px": 8.0},
    "vggt_4096": {"refine": "tracks", "tracked_points": 4096, "lens": "SIMPLE_PINHOLE", "max_error_px": 8.0},
}
"""Of the thesis's registrations, as registration.json records them."""
TRAINING: dict[str, dict[str, Any]] = {
    "2dgs": {"iterations": 30_000, "sh_degree": 3, "lambda_dssim": 0.2, "lambda_normal": 0.05, "lambda_distortion": 0.0},
    "svraster": {"sh_degree": 3, "lambda_dssim": 0.02, "lambda_mask": 0.5, "level_start": 6},
}
"""As training.json records it; what it does not record is not compared."""
ITERATIONS = {"su_l": 5000, "su_h": 5000, "se": 3000}
"""Of SVRaster."""
WIDTH_PX = {"2dgs": 400, "svraster": 250}
METHODS = {
    "vggt_1024": "tracks by VGGT's own head (published: the tracker of VGGSfM)",
    "vggt_4096": "tracks by VGGT's own head (published: the tracker of VGGSfM)",
    "svraster": "mesh from the density near the depth maps (published: a progressive TSDF)",
    "mast3r height": "metres per unit times the height of the mesh (published: the extent of the network's points)",
}
"""What is known to differ in our own implementations, by registration, surface method or means of measuring."""
PROPOSALS = {"cnos": "fastsam", "sam6d_ism": "sam"}
"""What proposes regions (4.3)."""
DESCRIBER, ITERATIONS_OF_POSE = "dinov2-large", 5
MODELS = {"scene": "su_h", "registration": "mast3r"}
"""The cells that models are from."""
OBJECTS, LEAST_INSTANCES = 21, 4000
"""Of YCB-V; and instances in its 900 test images of the BOP Challenge, of which there are about 4,100."""


def compare_cell(cell: Cell) -> tuple[str, ...]:
    """In what a cell of YCB-V differs from the published one of its scene, its registration and its surface method."""
    captured = read_facts(cell.folder.parents[1] / "capture/capture.json")
    registered = read_facts(cell.folder.parent / "cameras/registration.json")
    found = _unlike("images: ", captured, CAPTURE) if captured else ["images: not recorded"]
    if captured and captured.get("images") != VIEWS.get(cell.scene):
        found.append(f"{captured.get('images')} images (published: {VIEWS.get(cell.scene)})")
    if cell.registration not in PARAMETERS:
        found.append(f"cameras by {REGISTRATIONS[cell.registration].title if cell.registration in REGISTRATIONS else cell.registration}")
    elif not cell.failure or registered:
        found += _unlike("registration: ", registered.get("parameters") or {}, PARAMETERS[cell.registration])
    if cell.failure:
        # A method that could not run here has reproduced nothing; one that did run and failed has.
        found += [] if registered or cell.facts["training"] else [f"failed before it began: {cell.failure.reason}"]
    elif cell.nvs in TRAINING:
        found += _compare_training(cell)
    return tuple(found + [METHODS[name] for name in (cell.registration, cell.nvs) if name in METHODS])


def _compare_training(cell: Cell) -> list[str]:
    training = cell.facts["training"]
    settings = training.get("settings") or {}
    expected = dict(TRAINING[cell.nvs], initialization="sparse")
    if cell.nvs == "svraster":
        expected["iterations"] = ITERATIONS.get(cell.scene)
    return _unlike("training: ", settings, expected) + _unlike("training: ", training, {"image_width_px": WIDTH_PX[cell.nvs]})


def _unlike(what: str, found: Mapping[str, Any], expected: Mapping[str, Any]) -> list[str]:
    return [
        f"{what}{name.replace('_', ' ')} {found.get(name, 'not recorded')} (published: {value})"
        for name, value in expected.items()
        if found.get(name) != value
    ]


def read_settings(table: Path) -> dict[str, Any]:
    """With which settings a table of the benchmark was made, from the JSON beside it; empty where there is none."""
    path = table.with_suffix(".json")
    return read_json(path) if path.is_file() else {}


def compare_score(
    row: Mapping[str, str], made: Mapping[str, Any], instances: int, models: int | None, cells: tuple[str, ...]
) -> tuple[str, ...]:
    """In what a score differs from the published one of its method, masks and models.

    Args:
        row: of bop.csv: models, method and masks.
        made: the settings that the table was made with.
        instances: in the test images.
        models: how many of YCB-V's objects its models have; None where that is not known.
        cells: in what the cells of these models differ.
    """
    found = []
    if made.get("test_folder") != "download":
        found.append(f"{instances} instances in {'other real' if made.get('test_folder') else 'rendered'} images (published: BOP's own)")
    elif instances < LEAST_INSTANCES:
        found.append(f"{instances} instances (published: about 4,100 in 900 images)")
    for method in (row["method"], row["masks"]):
        if method in PROPOSALS:
            options = (made.get("detect") or {}).get(method) or {}
            found += _unlike(f"{method}: ", options, {"proposals": PROPOSALS[method], "describer": DESCRIBER})
    if row["method"] == "foundationpose":
        from zeroshop_steps.pose.foundationpose.steps import ITERATIONS  # PyTorch takes seconds, and few tables need it

        usual = {"iterations": ITERATIONS} if "pose" in made else {}  # where the config says nothing
        options = usual | ((made.get("pose") or {}).get("foundationpose") or {})
        found += _unlike("foundationpose: ", options, {"iterations": ITERATIONS_OF_POSE})
    if row["models"] != "models":
        found += _unlike("models: ", made, MODELS)
        if models != OBJECTS:
            found.append(f"models of {'an unknown number' if models is None else models} of {OBJECTS} objects")
        found += cells
    return tuple(found)
