"""Models from BOP datasets: from a local folder, from an archive, and what happens when neither can be had."""

import hashlib
import shutil
import socket
import struct
import threading
import zipfile
from pathlib import Path

import numpy as np
import pytest

from helpers.capture_box import BOX_SIZE_MM, write_box
from zeroshop_steps.bop.formats.models import measure_diameter_mm
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.runtime.downloads import download
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json, write_json
from zeroshop_steps.synthetic import bop_models
from zeroshop_steps.synthetic.bop_models import copy_model, download_models


@pytest.fixture
def models(tmp_path) -> Path:
    """A models folder in BOP's layout with one object."""
    write_box(tmp_path / "models", "obj_000007")
    size = dict(zip(("size_x", "size_y", "size_z"), BOX_SIZE_MM.tolist(), strict=True))
    entry = {"diameter": float(np.linalg.norm(BOX_SIZE_MM)), "symmetries_discrete": [np.eye(4).ravel().tolist()]} | size
    write_json(tmp_path / "models" / "models_info.json", {"7": entry})
    return tmp_path / "models"


@pytest.fixture
def archive(models, tmp_path) -> Path:
    """The same as BOP packs it, with a second folder of coarser models that must not be mistaken for the first."""
    path = tmp_path / "hosted" / "boxes_models.zip"
    path.parent.mkdir()
    with zipfile.ZipFile(path, "w") as opened:
        for file in sorted(models.iterdir()):
            opened.write(file, f"models/{file.name}")
        opened.writestr("models_eval/obj_000007.ply", "not this one")
    return path


def test_model_is_taken_as_it_is(models, tmp_path):
    copy_model(models, "boxes", "obj_000007", tmp_path / "out")
    source, target = read_ply(models / "obj_000007.ply"), read_ply(tmp_path / "out" / "model.ply")
    assert np.allclose(source.vertices, target.vertices) and np.array_equal(source.faces, target.faces)
    assert np.array_equal(source.texture, target.texture) and np.allclose(source.uv, target.uv)
    info = read_json(tmp_path / "out" / "model_info.json")
    assert info["obj_id"] == 7 and info["name"] == "obj_000007" and info["size_z"] == 100.0 and info["min_z"] == -50.0
    assert len(info["symmetries_discrete"]) == 1 and info["symmetries_continuous"] == []
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["model.ply", "model.png", "model_info.json"]


def test_real_model(shared_data, tmp_path):
    copy_model(shared_data / "ycbv" / "models", "ycbv", "obj_000005", tmp_path / "out")
    info = read_json(tmp_path / "out" / "model_info.json")
    assert info["name"] == "006_mustard_bottle" and info["front_azimuth_deg"] == 90.0
    assert read_ply(tmp_path / "out" / "model.ply").texture.shape == (2048, 2048, 3)


def test_bad_folders_and_models_are_named(models, tmp_path):
    with pytest.raises(StepError, match="nowhere does not exist.*models_folder"):
        copy_model(tmp_path / "nowhere", "boxes", "obj_000007", tmp_path / "out")
    with pytest.raises(StepError, match="no object obj_000099.*obj_000007"):
        copy_model(models, "boxes", "obj_000099", tmp_path / "out")
    mesh = read_ply(models / "obj_000007.ply")
    write_ply(models / "obj_000009.ply", Mesh(mesh.vertices / 1000, mesh.faces, uv=mesh.uv), "obj_000007.png")
    write_ply(models / "obj_000010.ply", Mesh(mesh.vertices, mesh.faces, uv=mesh.uv), "gone.png")
    for number, words in ((9, "Convert it to millimetres"), (10, "gone.png does not exist")):
        with pytest.raises(StepError, match=words):
            copy_model(models, "boxes", f"obj_{number:06d}", tmp_path / "out")
    write_json(models / "models_info.json", {"7": {"diameter": 300.0}})
    with pytest.raises(StepError, match="do not belong together"):
        copy_model(models, "boxes", "obj_000007", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("color", [(200, 90, 30), None])
def test_a_model_without_a_texture_gets_one_of_its_colours(models, tmp_path, capsys, color):
    mesh = read_ply(models / "obj_000007.ply")
    colors = None if color is None else np.tile(np.uint8(color), (len(mesh.vertices), 1))
    write_ply(models / "obj_000008.ply", Mesh(mesh.vertices, mesh.faces, colors=colors))
    copy_model(models, "boxes", "obj_000008", tmp_path / "out")
    back = read_ply(tmp_path / "out/model.ply")
    assert back.is_textured and (back.texture[0, 0] == (color or (190, 190, 190))).all() and len(back.faces) == len(mesh.faces)
    assert f"obj_000008.ply has {'colours at vertices' if color else 'no colour'}" in capsys.readouterr().err


def test_hosted_archive_is_fetched_once_and_unpacked(archive, tmp_path, monkeypatch):
    monkeypatch.setitem(bop_models.HOSTED_MODELS, "boxes", archive.as_uri())
    folder, source = download_models("boxes", tmp_path / "resources")
    assert source["url"].startswith("file:") and len(source["sha256"]) == 64
    with pytest.raises(StepError, match="expected 0000"):
        download_models("boxes", tmp_path / "resources", "0" * 64)
    copy_model(folder, "boxes", "obj_000007", tmp_path / "out")
    stored = tmp_path / "resources" / "downloads" / "boxes_models.zip"
    digest = hashlib.sha256(archive.read_bytes()).hexdigest()
    assert stored.with_name("boxes_models.zip.sha256").read_text().split() == [digest, "boxes_models.zip"]
    archive.unlink()
    assert download_models("boxes", tmp_path / "resources", source["sha256"]) == (folder, source)
    with pytest.raises(StepError, match="no download is known for the dataset lm.*models_folder"):
        download_models("lm", tmp_path / "resources")


def test_blocked_download_says_what_to_do(tmp_path, monkeypatch, capsys):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{free.getsockname()[1]}/boxes_models.zip"
    with pytest.raises(StepError) as error:
        download(url, tmp_path / "downloads" / "boxes_models.zip", "name a local folder", attempts=2, pause_s=0.0)
    message = str(error.value)
    assert url in message and str(tmp_path / "downloads" / "boxes_models.zip") in message and "name a local folder" in message
    assert "attempt 1 of 2" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "downloads").iterdir()] == ["boxes_models.zip.lock"]


def test_a_connection_that_breaks_is_tried_again(tmp_path, capsys):
    content = bytes(3 << 20)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            for sent in (2 << 20, len(content)):
                connection, _ = server.accept()
                with connection:
                    connection.recv(4096)
                    connection.sendall(b"HTTP/1.0 200 OK\r\nContent-Length: %d\r\n\r\n" % len(content) + content[:sent])
                    # Closing so resets the connection where not all was sent.
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", sent < len(content), 0))

        thread = threading.Thread(target=serve)
        thread.start()
        path = download(f"http://127.0.0.1:{server.getsockname()[1]}/boxes_models.zip", tmp_path / "boxes_models.zip", "", pause_s=0.0)
        thread.join()
    assert path.read_bytes() == content
    assert "attempt 1 of 3, trying again" in capsys.readouterr().err


def test_changed_bytes_are_refused(archive, tmp_path):
    target = tmp_path / "downloads" / "boxes_models.zip"
    download(archive.as_uri(), target, "")
    target.unlink()
    with zipfile.ZipFile(archive, "a") as opened:
        opened.writestr("models/more.txt", "changed")
    with pytest.raises(StepError, match="recorded at first use.*Delete"):
        download(archive.as_uri(), target, "")


def test_file_put_there_by_hand_is_used(archive, tmp_path, monkeypatch):
    monkeypatch.setitem(bop_models.HOSTED_MODELS, "boxes", "http://127.0.0.1:9/boxes_models.zip")
    (tmp_path / "resources" / "downloads").mkdir(parents=True)
    shutil.copy(archive, tmp_path / "resources" / "downloads" / "boxes_models.zip")
    assert (download_models("boxes", tmp_path / "resources")[0] / "obj_000007.ply").is_file()


def test_archive_that_is_no_zip_is_named(tmp_path, monkeypatch):
    page = tmp_path / "boxes_models.zip"
    page.write_text("<html>please sign in</html>")
    monkeypatch.setitem(bop_models.HOSTED_MODELS, "boxes", page.as_uri())
    with pytest.raises(StepError, match="boxes_models.zip is not a whole zip archive"):
        download_models("boxes", tmp_path / "resources")
    assert not (tmp_path / "resources" / "bop" / "boxes" / "models").exists()


def test_diameter_is_the_largest_distance():
    points = np.random.default_rng(0).normal(size=(300, 3))
    assert measure_diameter_mm(points) == pytest.approx(np.linalg.norm(points[:, None] - points[None], axis=2).max())
