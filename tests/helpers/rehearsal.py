"""A rehearsal of the thesis's line: a clone of the project, and a server of this machine that hands out tiny networks for its weights.

The networks have the published names and parts; their sizes lie beside them, as a user's own networks have them, and their weights are
random. What the networks that find cameras would say is known of rendered images: in the clone, they are loaded and run like any others,
and then their answers are replaced by the truth with a little noise (`helpers.told_truth`). So all is tried but what networks have learned,
and what only a GPU does.
"""

import contextlib
import csv
import functools
import hashlib
import http.server
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
import trimesh

from helpers.checkout import copy_checkout
from helpers.mast3r_cases import SMALL, parameters
from helpers.paths import REPOSITORY
from helpers.small_detectors import save_describer, save_fastsam, save_segmenter
from helpers.small_foundationpose import write_checkpoints
from helpers.small_networks import write_detector, write_tracker
from helpers.small_sam6d import write_pem
from helpers.small_trellis import write_encoder, write_networks
from helpers.small_vggt import write_weights
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.networks.mast3r.inference import NAME
from zeroshop_steps.networks.mast3r.model import MASt3R, Mast3rSettings
from zeroshop_steps.runtime.files import write_json

WEIGHTS = Path("resources/weights")
TABLE = "src/zeroshop_steps/networks/weights.csv"
TOLD = {
    "networks/mast3r/inference.py": "from helpers.told_truth import told_pairs\n\nMast3rPredictor = told_pairs(Mast3rPredictor)",
    "register/vggt/solve.py": "from helpers.told_truth import told_frames\n\nregister = told_frames(register)",
}
"""What modules of the clone end with, so that networks are told the truth after they have answered."""


def write_published(root: Path) -> None:
    """A tiny network for every file that the thesis's methods need, below `root`/resources/weights."""
    weights = root / WEIGHTS
    for network in (save_segmenter, save_describer, save_fastsam):
        network(weights)
    write_detector(weights / "grounding-dino-base")
    write_tracker(weights / "sam2.1-hiera-large")
    write_checkpoints(root)
    write_pem(weights / "sam-6d-pem-base.pth")
    write_networks(weights / "trellis")
    write_encoder(weights / "dinov2-with-registers-large")
    write_weights(weights / "VGGT-1B/model.safetensors")
    with torch.device("meta"):
        network = MASt3R(Mast3rSettings(**SMALL))
    torch.save({"model": parameters({name: tuple(tensor.shape) for name, tensor in network.state_dict().items()})}, weights / NAME)
    write_json((weights / NAME).with_suffix(".json"), SMALL)


def clone_project(folder: Path, published: Path, address: str) -> dict[str, str]:
    """A clone of what runs, whose table of weights names the server at `address` for what is `published`; the environment to call it in.

    Sizes of the tiny networks lie where a user puts those of own ones; they are no part of the table.
    """
    environment = copy_checkout(folder)
    shutil.copy(REPOSITORY / "Snakefile", folder)
    (folder / "profiles").symlink_to("workflow/profiles")
    weights = published / WEIGHTS
    with open(folder / TABLE, newline="") as file:
        rows = list(csv.DictReader(file))
    names = {row["file"] for row in rows}
    for row in rows:
        path = weights / row["file"]
        if path.is_file():
            row |= {"url": f"{address}/{row['file']}", "size_bytes": str(path.stat().st_size)}
            row["sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
    with open(folder / TABLE, "w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    for path in sorted(weights.rglob("*.json")):
        name = path.relative_to(weights)
        if name.as_posix() not in names:
            (folder / WEIGHTS / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, folder / WEIGHTS / name)
    for name, words in TOLD.items():
        with open(folder / "src/zeroshop_steps" / name, "a") as source:
            source.write(f"\n\n{words}\n")
    return environment | {"PYTHONPATH": f"{environment['PYTHONPATH']}:{REPOSITORY / 'tests'}"}


class _Handler(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None: ...


@contextlib.contextmanager
def serve(folder: Path) -> Iterator[str]:
    """The address of a server on the loopback that hands out the files of a folder."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Handler, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()


def paint_models(folder: Path, cell_mm: float = 6.0) -> None:
    """Give models without colours an even noise of colours: cameras and surfaces are found by print."""
    for path in sorted(folder.glob("obj_*.ply")):
        mesh = read_ply(path)
        shape = trimesh.Trimesh(mesh.vertices, mesh.faces).subdivide_to_size(cell_mm, max_iter=12)
        colors = np.random.default_rng(0).integers(30, 226, (len(shape.vertices), 3)).astype(np.uint8)
        write_ply(path, Mesh(np.asarray(shape.vertices), np.asarray(shape.faces), colors=colors))
