"""Which files of weights there are, where they lie, and loading one into a network without anything left over or out."""

import argparse
import csv
import json
import pickle
import re
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from zeroshop_steps.networks.drive import DriveFile, take_from_drive
from zeroshop_steps.networks.package_files import PackageFile, take_from_package
from zeroshop_steps.runtime.downloads import download, verify
from zeroshop_steps.runtime.errors import StepError

if TYPE_CHECKING:
    from collections.abc import Callable

    import torch

    Tensors = dict[str, torch.Tensor]

Settings = TypeVar("Settings")
WEIGHTS_FOLDER = Path("resources/weights")
TABLE = Path(__file__).with_name("weights.csv")
SHOWN = 5
"""How many parameters an error names."""
BY_HAND = "by-hand:"
"""Before the URL of a page from which a browser must take a file: its publisher has no address for the file itself."""


@dataclass(frozen=True)
class WeightsFile:
    """One row of weights.csv.

    Attributes:
        file: its path below resources/weights.
        url: where its publisher has it; of a file in a Python package, see `PackageFile`, in Google Drive, `drive.DriveFile`, and of
            a page, BY_HAND.
        size_bytes, sha256: what it must be; None where no publisher says so. The first download's sha256 is then kept beside it.
        licence: of the weights, which is not that of this project.
        purpose: what it is for.
        without: the option that needs no weights.
    """

    file: str
    url: str
    size_bytes: int | None
    sha256: str | None
    licence: str
    purpose: str
    without: str

    @property
    def path(self) -> Path:
        """Where it belongs, as seen from the folder that holds resources/."""
        return WEIGHTS_FOLDER / self.file

    @property
    def source(self) -> str:
        """Where it comes from, for the user."""
        return str(PackageFile.parse(self.url) or DriveFile.parse(self.url) or self.url.removeprefix(BY_HAND))

    @property
    def advice(self) -> str:
        """How to get it, under which licence, and what can be done without it."""
        size = f"{self.size_bytes / 1e6:.0f} MB, " if self.size_bytes else ""
        if self.url.startswith(BY_HAND):
            ending = "/".join(Path(self.file).parts[-2:])
            return f"Take {ending} ({size}licence {self.licence}) by hand from {self.source} and put it at {self.path}; {self.without}"
        return (
            f"`snakemake {self.path}` downloads it ({size}licence {self.licence}) from {self.source}; offline, put that file at"
            f" {self.path}; {self.without}"
        )


def read_table(table: Path = TABLE) -> dict[str, WeightsFile]:
    """All known files by their path below resources/weights."""
    with open(table, newline="") as file:
        rows = [
            WeightsFile(
                row["file"],
                row["url"],
                int(row["size_bytes"]) if row["size_bytes"] else None,
                row["sha256"] or None,
                row["licence"],
                row["purpose"],
                row["without"],
            )
            for row in csv.DictReader(file)
        ]
    return {row.file: row for row in rows}


def look_up_weights(name: str) -> WeightsFile:
    """The row of a file; raises StepError with the known ones for another name."""
    table = read_table()
    if name not in table:
        raise StepError(f"unknown weights: {name}. Known, below {WEIGHTS_FOLDER}: {', '.join(table)}")
    return table[name]


def require_weights(name: str, root: Path = Path()) -> Path:
    """The path of a file of weights that is there and is the right one.

    Its bytes are checked at the first use and again when it is newer than the record of that, `path`.sha256.

    Raises:
        StepError: it is not there (says where to get it, its licence, and what needs none), was cut short, or is another file.
    """
    row = look_up_weights(name)
    path = root / row.path
    if not path.is_file():
        raise StepError(f"the weights {path} are not there, which are for {row.purpose}. {row.advice}")
    _check_size(row, path)
    record = path.with_name(path.name + ".sha256")
    if not record.exists() or record.stat().st_mtime < path.stat().st_mtime:
        verify(path, row.sha256)
        record.touch()
    return path


def resolve_weights(path: Path, name: str, sizes: str) -> Path:
    """The weights at `path`: the published ones, checked as `require_weights` does, or one's own, which only have to fit.

    Args:
        path: where they are.
        name: of the published file, below resources/weights.
        sizes: suffix of the file beside it that tells the sizes of a network of one's own.

    Raises:
        StepError: they are not there, or not what was published.
    """
    if path == WEIGHTS_FOLDER / name and not path.with_suffix(sizes).is_file():
        return require_weights(name)
    if not path.is_file():
        raise StepError(f"the weights {path} do not exist; check the path, or leave the option out for the published ones")
    return path


def fetch_weights(name: str, path: Path) -> None:
    """Download a file of weights to `path` and check it.

    Raises:
        StepError: no network, no disk space, not the file that the table describes, or one that only a browser can fetch.
    """
    row = look_up_weights(name)
    if row.url.startswith(BY_HAND):
        raise StepError(f"{name} cannot be downloaded by this step. {row.advice}")
    packed, driven = PackageFile.parse(row.url), DriveFile.parse(row.url)
    if driven:
        take_from_drive(driven, path, row.without, sha256=row.sha256)
    elif packed:
        take_from_package(packed, path, row.without, sha256=row.sha256)
    else:
        download(row.url, path, row.without, sha256=row.sha256, size_bytes=row.size_bytes)
    _check_size(row, path)


def read_own_sizes(beside: Path, settings: type[Settings]) -> Settings:
    """The sizes of a network: the published ones, which are the default, or those in the JSON file beside one's own weights.

    Raises:
        StepError: the file is damaged or has other keys.
    """
    try:
        return settings(**json.loads(beside.read_text())) if beside.is_file() else settings()
    except (TypeError, ValueError) as error:
        raise StepError(f"{beside} has no {settings.__name__} ({error}); delete it for the sizes of the published network") from None


def load_strictly(
    module: "torch.nn.Module",
    path: Path,
    adapt: "Callable[[Tensors], Tensors]" = dict,
    read: "Callable[[Path], Tensors] | None" = None,
) -> None:
    """Give `module` the parameters and buffers in a checkpoint: all of them, and none besides.

    The module may be on the meta device; it then takes the tensors as they are in the file, which is mapped, not read.

    Args:
        module: the network.
        path: .safetensors, or PyTorch's own format: the tensors by name, alone or under the key "model".
        adapt: gives the published tensors the module's names, and adds those that it computes.
        read: reads a file of another format; `read_checkpoint` by default.

    Raises:
        StepError: a damaged file, or names and shapes that are not the network's; it names them.
    """
    state = adapt((read or read_checkpoint)(path))
    expected = module.state_dict()
    missing = [name for name in expected if name not in state]
    extra = [name for name in state if name not in expected]
    misshapen = [
        f"{name} {tuple(state[name].shape)} instead of {tuple(tensor.shape)}"
        for name, tensor in expected.items()
        if name in state and state[name].shape != tensor.shape
    ]
    faults = [
        f"{len(names)} {what} ({', '.join(names[:SHOWN])}{', ...' if len(names) > SHOWN else ''})"
        for what, names in (("missing", missing), ("unknown", extra), ("of another shape", misshapen))
        if names
    ]
    if faults:
        raise StepError(
            f"{path} does not fit {type(module).__name__}: of its {len(state)} parameters, compared with the {len(expected)} of the"
            f" network, {'; '.join(faults)}. It is the checkpoint of another model; take the one that weights.csv names"
        )
    # Numbers of half the precision, which some are published in, are taken into the network's own.
    state = {name: tensor.to(expected[name].dtype) if tensor.is_floating_point() else tensor for name, tensor in state.items()}
    module.load_state_dict(state, strict=True, assign=any(tensor.is_meta for tensor in expected.values()))


def read_checkpoint(path: Path) -> dict[str, "torch.Tensor"]:
    """The tensors of a checkpoint by name, mapped from the file; no code in the file is run, and objects beside the tensors are ignored.

    Raises:
        StepError: the file is not there, damaged, cut short, or no checkpoint.
    """
    import torch

    path = Path(path)
    try:
        if path.suffix == ".safetensors":
            from safetensors import SafetensorError
            from safetensors.torch import load_file

            try:
                return load_file(path)
            except SafetensorError as error:
                raise ValueError(str(error)) from None
        whole = zipfile.is_zipfile(path)
        try:
            with torch.serialization.safe_globals([argparse.Namespace]):
                content = torch.load(path, map_location="cpu", weights_only=True, mmap=whole)
        except pickle.UnpicklingError:
            # Training scripts leave more beside the tensors, such as numbers of NumPy: these are passed over, not made.
            if not whole:
                raise
            from zeroshop_steps.networks.inert_pickles import read_inert

            content = read_inert(path)
    except FileNotFoundError:
        raise StepError(f"the weights {path} do not exist") from None
    except (OSError, RuntimeError, ValueError, EOFError, KeyError, pickle.UnpicklingError) as error:
        first = re.split(r"[\n.]", str(error).strip())[0]
        raise StepError(f"{path} is no whole checkpoint ({first}); it is damaged or was cut short. Delete it and fetch it again") from None
    state = content.get("model", content) if isinstance(content, dict) else None
    if not isinstance(state, dict) or not state or not all(isinstance(tensor, torch.Tensor) for tensor in state.values()):
        raise StepError(f"{path} holds no tensors by name; it is not a checkpoint of this kind. Take the one that weights.csv names")
    return state


def _check_size(row: WeightsFile, path: Path) -> None:
    found = path.stat().st_size
    if row.size_bytes and found != row.size_bytes:
        what = "cut short" if found < row.size_bytes else "another file"
        raise StepError(f"{path} has {found} bytes, expected {row.size_bytes}: it is {what}. Delete it and fetch it again. {row.advice}")
