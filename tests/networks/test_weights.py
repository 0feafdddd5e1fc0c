"""Weights: a table, checked downloads, and loading that leaves nothing out."""

import argparse
import dataclasses
import datetime
import hashlib
import http.server
import os
import pathlib
import re
import shutil
import sys
import threading
from collections import namedtuple
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from zeroshop_steps import methods
from zeroshop_steps.networks import weights
from zeroshop_steps.networks.drive import DriveFile
from zeroshop_steps.networks.package_files import PackageFile
from zeroshop_steps.networks.weights import WeightsFile, fetch_weights, load_strictly, read_table, require_weights
from zeroshop_steps.runtime.downloads import download
from zeroshop_steps.runtime.errors import StepError

CONTENT = b"weights" * 1000
SHA256 = hashlib.sha256(CONTENT).hexdigest()


@pytest.fixture
def published(tmp_path, monkeypatch):
    """A table with one file, published in a folder of this machine."""
    source = tmp_path / "publisher" / "net.pth"
    source.parent.mkdir()
    source.write_bytes(CONTENT)
    row = WeightsFile("net.pth", source.as_uri(), len(CONTENT), hashlib.sha256(CONTENT).hexdigest(), "CC BY-NC 4.0", "tests", "use colmap")
    monkeypatch.setattr(weights, "read_table", lambda: {"net.pth": row})
    return source


def test_the_table_is_whole_and_names_all_that_methods_need():
    table = read_table()
    tables = (methods.REGISTRATIONS, methods.SEGMENTATIONS, methods.HEIGHTS, methods.SURFACES, methods.DETECTORS, methods.ESTIMATORS)
    assert {name for methods_table in tables for method in methods_table.values() for name in method.weights} <= set(table)
    chosen = [files for one in methods.DETECTORS.values() for choices in one.choices.values() for files in choices.values()]
    assert {name for files in chosen for name in files} <= set(table)
    for row in table.values():
        assert (
            (row.url.removeprefix(weights.BY_HAND).startswith("https://") or PackageFile.parse(row.url) or DriveFile.parse(row.url))
            and row.licence
            and row.purpose
            and row.without
        )
        assert row.sha256 is None or len(bytes.fromhex(row.sha256)) == 32
        assert "/resolve/" not in row.url or re.search(r"/resolve/[0-9a-f]{40}/", row.url), "a branch changes; a commit does not"
        assert row.size_bytes is None or row.size_bytes > 0


def test_a_file_that_only_a_browser_gets_is_asked_for(tmp_path):
    name = "VGGT-1B-Commercial/vggt_1B_commercial.pt"
    with pytest.raises(StepError, match="cannot be downloaded by this step.*by hand from https://huggingface.co.*put it at"):
        fetch_weights(name, tmp_path / name)
    assert not (tmp_path / name).exists()


class Drive:
    """Stands for gdown: a folder with the two files of FoundationPose, and what is asked of it."""

    def __init__(self, refuses=False):
        self.refuses, self.asked = refuses, []

    def download_folder(self, id, skip_download, quiet):
        names = "2023-10-28-18-33-37/config.yml", "2023-10-28-18-33-37/model_best.pth", "2024-01-11-20-02-45/model_best.pth"
        return [SimpleNamespace(id=f"{id}-{number}", path=f"weights/{name}") for number, name in enumerate(names)]

    def download(self, id, output, resume):
        self.asked.append((id, resume))
        if self.refuses:
            return None
        pathlib.Path(output).write_bytes(CONTENT)
        return output


@pytest.mark.parametrize(
    ("name", "asked"),
    [
        ("foundationpose/2024-01-11-20-02-45/model_best.pth", "1DFezOAD0oD1BblsXVxqDsl8fj0qzB82i-2"),
        ("sam-6d-pem-base.pth", "1joW9IvwsaRJYxoUmGo68dBVg-HcFNyI7"),
    ],
)
def test_files_in_google_drive_are_found_in_their_folder_and_checked(tmp_path, monkeypatch, name, asked):
    drive, row, path = Drive(), read_table()[name], tmp_path / name
    monkeypatch.setitem(sys.modules, "gdown", drive)
    monkeypatch.setattr(weights, "read_table", lambda: {name: dataclasses.replace(row, size_bytes=len(CONTENT), sha256=SHA256)})
    fetch_weights(name, path)
    assert drive.asked == [(asked, True)] and path.read_bytes() == CONTENT
    other = tmp_path / "other" / name
    monkeypatch.setattr(weights, "read_table", lambda: {name: row})
    if row.sha256:
        with pytest.raises(StepError, match="damaged or another file"):
            fetch_weights(name, other)
    monkeypatch.setitem(sys.modules, "gdown", Drive(refuses=True))
    with pytest.raises(StepError, match=r"Google Drive refused https://drive.google.com/.*By hand: take .* and put it at"):
        fetch_weights(name, tmp_path / "third" / name)
    monkeypatch.setitem(sys.modules, "gdown", None)
    with pytest.raises(StepError, match="pip install gdown"):
        fetch_weights(name, tmp_path / "fourth" / name)


class Server(http.server.BaseHTTPRequestHandler):
    """Hands out CONTENT, and breaks off the first time."""

    asked: ClassVar[list] = []
    mark = '"one"'

    def do_GET(self):
        start = int((self.headers["Range"] or "bytes=0-").removeprefix("bytes=").removesuffix("-"))
        start = start if self.headers["If-Range"] == self.mark else 0
        self.asked.append(start)
        self.send_response(206 if start else 200)
        self.send_header("Content-Length", str(len(CONTENT) - start))
        self.send_header("ETag", self.mark)
        self.end_headers()
        self.wfile.write(CONTENT[start : 3000 if len(self.asked) == 1 else None])

    def log_message(self, *_): ...


@pytest.mark.parametrize("changed", [False, True])
def test_a_download_that_broke_off_continues_unless_the_file_is_another(tmp_path, monkeypatch, changed):
    handler = type("Handler", (Server,), {"asked": []})
    server = http.server.HTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    address = f"http://127.0.0.1:{server.server_port}/net.pth"
    try:
        with pytest.raises(StepError, match="cannot download"):
            download(address, tmp_path / "net.pth", "use colmap", attempts=1)
        assert (tmp_path / "net.pth.part").stat().st_size == 3000 and not (tmp_path / "net.pth").exists()
        if changed:
            handler.mark = '"two"'
        download(address, tmp_path / "net.pth", "use colmap", attempts=1)
    finally:
        server.shutdown()
        server.server_close()
    assert handler.asked == [0, 0 if changed else 3000] and (tmp_path / "net.pth").read_bytes() == CONTENT
    assert {path.name for path in tmp_path.iterdir()} <= {"net.pth", "net.pth.sha256", "net.pth.lock"}


def test_a_download_is_checked_and_found_again(published, tmp_path):
    path = tmp_path / "resources/weights/net.pth"
    fetch_weights("net.pth", path)
    assert path.read_bytes() == CONTENT
    assert require_weights("net.pth", tmp_path) == path


def test_absent_weights_say_where_to_get_them_and_what_needs_none(published, tmp_path):
    with pytest.raises(StepError) as error:
        require_weights("net.pth", tmp_path)
    for part in (str(tmp_path / "resources/weights/net.pth"), published.as_uri(), "CC BY-NC 4.0", "use colmap", "snakemake resources/"):
        assert part in str(error.value)
    with pytest.raises(StepError, match="unknown weights: other.pth"):
        require_weights("other.pth", tmp_path)


def test_weights_that_are_cut_short_or_others_are_refused(published, tmp_path):
    path = tmp_path / "resources/weights/net.pth"
    path.parent.mkdir(parents=True)
    path.write_bytes(CONTENT[:-1])
    with pytest.raises(StepError, match="cut short"):
        require_weights("net.pth", tmp_path)
    path.write_bytes(CONTENT[::-1])
    with pytest.raises(StepError, match="sha256"):
        require_weights("net.pth", tmp_path)
    path.write_bytes(CONTENT)
    require_weights("net.pth", tmp_path)
    path.write_bytes(CONTENT[::-1])
    later = path.stat().st_mtime + 5
    os.utime(path, (later, later))
    with pytest.raises(StepError, match="sha256"):
        require_weights("net.pth", tmp_path)


def test_a_download_of_other_bytes_is_refused(published, tmp_path):
    published.write_bytes(CONTENT[::-1])
    with pytest.raises(StepError, match="expected .* damaged or another file"):
        fetch_weights("net.pth", tmp_path / "net.pth")


def test_offline_says_where_to_put_the_file(tmp_path):
    path = tmp_path / "net.pth"
    with pytest.raises(StepError, match=rf"put it at {path}; or use colmap"):
        download((tmp_path / "gone").as_uri(), path, "use colmap", attempts=1)


def test_a_full_disk_is_said_before_the_download(published, tmp_path, monkeypatch):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(10, 9, 1))
    with pytest.raises(StepError, match="make room"):
        fetch_weights("net.pth", tmp_path / "net.pth")
    assert not (tmp_path / "net.pth").exists()


@pytest.fixture
def checkpoint(tmp_path):
    """A small network, written as publishers write theirs: with the arguments of its training."""
    path = tmp_path / "net.pth"
    network = nn.Linear(3, 2)
    torch.save({"args": argparse.Namespace(lr=1.0), "model": network.state_dict()}, path)
    return network, path


@pytest.mark.parametrize("device", ["cpu", "meta"])
def test_both_kinds_of_checkpoints_are_loaded(checkpoint, tmp_path, device):
    network, path = checkpoint
    save_file(network.state_dict(), tmp_path / "net.safetensors")
    for file in (path, tmp_path / "net.safetensors"):
        loaded = nn.Linear(3, 2, device=device)
        load_strictly(loaded, file)
        assert torch.equal(loaded.weight, network.weight) and torch.equal(loaded.bias, network.bias)


def test_missing_extra_and_misshapen_parameters_are_named(tmp_path):
    path = tmp_path / "net.pth"
    torch.save({"weight": torch.zeros(2, 4), "scale": torch.zeros(1)}, path)
    with pytest.raises(StepError) as error:
        load_strictly(nn.Linear(3, 2), path)
    for part in ("1 missing (bias)", "1 unknown (scale)", "weight (2, 4) instead of (2, 3)", "another model"):
        assert part in str(error.value)


@pytest.mark.parametrize("suffix", [".pth", ".safetensors"])
@pytest.mark.parametrize("keep", [0, 20, 700])
def test_a_damaged_checkpoint_is_said(tmp_path, suffix, keep):
    path = tmp_path / f"net{suffix}"
    state = {"weight": torch.zeros(200, 3)}
    save_file(state, path) if suffix == ".safetensors" else torch.save(state, path)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(StepError, match="cut short"):
        load_strictly(nn.Linear(3, 200), path)


class Trap:
    """Runs a command where a pickle of it is read carelessly."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.system, (f"touch {self.path}",)


@pytest.mark.parametrize("kind", ["numpy", "namespace", "class", "trap"])
def test_what_training_left_beside_the_tensors_is_passed_over_and_never_run(tmp_path, kind):
    beside = {
        "numpy": {"loss": np.float64(0.25), "best": np.float32(3), "history": np.arange(3.0), "epoch": np.int64(7)},
        "namespace": argparse.Namespace(lr=1e-4, seed=np.int64(3)),
        "class": {"stamp": datetime.timedelta(1), "where": pathlib.PurePosixPath("a/b")},
        "trap": Trap(tmp_path / "ran"),
    }
    trained = nn.Linear(3, 2)
    torch.save({"model": trained.state_dict(), "optimizer": {"lr": 0.1}, "beside": beside[kind]}, tmp_path / "net.pth")
    for device in ("cpu", "meta"):
        with torch.device(device):
            network = nn.Linear(3, 2)
        load_strictly(network, tmp_path / "net.pth")
        assert torch.equal(network.weight, trained.weight) and torch.equal(network.bias, trained.bias)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("device", ["cpu", "meta"])
def test_a_checkpoint_of_half_the_precision_is_taken_into_the_networks_own(tmp_path, device):
    trained = nn.Linear(3, 2)
    save_file({name: tensor.half() for name, tensor in trained.state_dict().items()}, tmp_path / "net.safetensors")
    with torch.device(device):
        network = nn.Linear(3, 2)
    load_strictly(network, tmp_path / "net.safetensors")
    assert network.weight.dtype == torch.float32 and torch.equal(network.weight, trained.weight.half().float())


def test_what_is_no_checkpoint_is_said(tmp_path):
    torch.save([1, 2], tmp_path / "list.pth")
    with pytest.raises(StepError, match="no tensors by name"):
        load_strictly(nn.Linear(3, 2), tmp_path / "list.pth")
    with pytest.raises(StepError, match="do not exist"):
        load_strictly(nn.Linear(3, 2), tmp_path / "gone.pth")
