"""Take an object's model from a BOP dataset: from a local folder in BOP's layout, or from BOP's public hosting.

The model is written as it is: BOP's models of YCB-V stand upright, z up, in mm.
"""

import argparse
import shutil
import zipfile
from pathlib import Path

from zeroshop_steps.bop.formats.models import describe_model, read_models_info
from zeroshop_steps.bop.formats.symmetry import check_symmetries
from zeroshop_steps.geometry.meshes.mesh_files import SUFFIXES, describe_others, find_mesh, read_mesh, write_copy
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.downloads import download
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import atomic_directory, locked, write_json

HOSTED_MODELS = {"ycbv": "https://huggingface.co/datasets/bop-benchmark/ycbv/resolve/main/ycbv_models.zip"}
"""The archives that hold `models/obj_*.ply`, by dataset."""

FRONT_AZIMUTHS_DEG = {"ycbv": {1: 45, 4: 90, 5: 90, 6: 90, 9: 90, 12: 270, 14: 90, 15: 90, 18: 180}}
"""Which side of an object is its front, degrees from +x towards +y; 0 for the others. Read off renderings of the models."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--dataset", required=True, help="BOP's short name of the dataset, e.g. ycbv")
    parser.add_argument("--object", required=True, help="e.g. obj_000005")
    parser.add_argument("--models", type=Path, help="folder with obj_000001.ply ... and models_info.json (default: download)")
    parser.add_argument("--models-sha256", help="SHA-256 that the downloaded archive must have (default: that of the first download)")
    parser.add_argument("--resources", type=Path, default=Path("resources"), help="folder for downloads (default resources)")
    parser.add_argument("--out", type=Path, required=True, help="model folder to write")


def run(args: argparse.Namespace) -> None:
    """Entry point of the command line."""
    if args.models is not None:
        copy_model(args.models, args.dataset, args.object, args.out)
        return
    models, source = download_models(args.dataset, args.resources, args.models_sha256)
    copy_model(models, args.dataset, args.object, args.out, source)


def download_models(dataset: str, resources: Path, sha256: str | None = None) -> tuple[Path, dict[str, str]]:
    """The folder of a hosted dataset's models under `resources`, downloaded and unpacked at first use, and where it is from.

    Args:
        dataset: BOP's short name.
        resources: folder for downloads.
        sha256: what the archive must have; None takes that of the first download, which is recorded beside it.

    Returns:
        the folder; the URL and the SHA-256 of the archive.

    Raises:
        StepError: no download is known, it failed, or the archive is another one than expected.
    """
    if dataset not in HOSTED_MODELS:
        known = ", ".join(sorted(HOSTED_MODELS))
        raise StepError(
            f"no download is known for the dataset {dataset} (known: {known}); name a folder of models: models_folder in the config"
        )
    url, folder = HOSTED_MODELS[dataset], Path(resources) / "bop" / dataset / "models"
    without = f"name a local folder of the models: datasets: {dataset}: models_folder in the config, --models on the command line"
    archive = download(url, Path(resources) / "downloads" / url.rsplit("/", 1)[-1], without, sha256=sha256)
    with locked(folder.parent / "models.lock"):
        if not folder.is_dir():
            _unpack(archive, folder)
    return folder, {"url": url, "sha256": archive.with_name(archive.name + ".sha256").read_text().split()[0]}


def copy_model(models: Path, dataset: str, name: str, out: Path, source: dict[str, str] | None = None) -> None:
    """Check one object of a BOP models folder and write model.ply, its texture and model_info.json into the folder `out`.

    Raises:
        StepError: the folder or the object is missing, the mesh is damaged, or its unit is not mm.
    """
    models = Path(models)
    if not models.is_dir():
        raise StepError(
            f"models folder {models} does not exist; correct models_folder in the config (--models), or leave it out to download"
        )
    path = find_mesh(models / name)
    if path is None:
        there = sorted({found.stem for found in models.glob("obj_*") if found.suffix.lower() in SUFFIXES})
        listed = f"{there[0]} ... {there[-1]} ({len(there)} objects)" if there else ""
        found = f"{models} holds {listed}" if listed else f"of {models}, {describe_others(models)}"
        raise StepError(f"{dataset} has no object {name}: {models / name}.ply does not exist; {found}")
    mesh = read_mesh(path)
    if mesh.normals is None:
        mesh = mesh.with_normals()
    info = make_model_info(path, mesh, dataset, models) | ({"source": source} if source else {})
    if not mesh.is_textured:
        found = "colours at vertices or faces" if mesh.colors is not None else "no colour that is read"
        warn(f"model {path} has {found} instead of a texture; it is rendered {'with them' if mesh.colors is not None else 'in grey'}")
    with atomic_directory(out) as folder:
        write_copy(path, mesh, folder)
        write_json(folder / "model_info.json", info)


def make_model_info(path: Path, mesh: Mesh, dataset: str, models: Path) -> dict:
    """This object's entry of models_info.json, completed and checked against the mesh.

    Returns:
        diameter, min_x .. size_z in mm; symmetries_discrete, symmetries_continuous, name, obj_id, front_azimuth_deg.
    """
    digits = path.stem.removeprefix("obj_")
    object_id = int(digits) if digits.isdigit() else 0
    listed = read_models_info(models).get(str(object_id), {}) if (models / "models_info.json").exists() else {}
    check_symmetries(listed, f"object {object_id} in {models / 'models_info.json'}")
    info = {"name": path.stem} | describe_model(path, mesh, listed.get("diameter"))
    info |= {"symmetries_discrete": [], "symmetries_continuous": []} | listed
    return info | {"obj_id": object_id, "front_azimuth_deg": float(FRONT_AZIMUTHS_DEG.get(dataset, {}).get(object_id, 0))}


def _unpack(archive: Path, folder: Path) -> None:
    try:
        with zipfile.ZipFile(archive) as opened, atomic_directory(folder) as temporary:
            members = [name for name in opened.namelist() if name.split("/")[-2:-1] == ["models"] and not name.endswith("/")]
            if not members:
                raise StepError(f"{archive} has no folder models/; it is not BOP's archive of models. Delete it and fetch it again.")
            for member in members:
                with opened.open(member) as source, open(temporary / member.rsplit("/", 1)[-1], "wb") as target:
                    shutil.copyfileobj(source, target)
    except (zipfile.BadZipFile, EOFError) as error:
        raise StepError(f"{archive} is not a whole zip archive ({error}); delete it and its .sha256 and fetch it again") from None
