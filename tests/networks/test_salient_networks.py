"""Each network is fed as it was trained, and gives the same bytes with any number of threads."""

import hashlib
from dataclasses import replace

import numba
import numpy as np
import pytest

from helpers.paths import REPOSITORY
from helpers.small_saliency import DEVIATION, MEAN, write_network
from zeroshop_steps.geometry.imaging.images import read_image, write_image
from zeroshop_steps.networks.imagenet import LEVEL_DEVIATION, LEVEL_MEAN
from zeroshop_steps.networks.saliency import salient_networks
from zeroshop_steps.networks.saliency.salient_networks import (
    DEFAULT,
    NETWORKS,
    network_path,
    require_network,
)
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.networks.weights import read_table
from zeroshop_steps.runtime.errors import StepError

REAL = REPOSITORY / NETWORKS[DEFAULT].path
PHOTO = REPOSITORY / "docs/mustard_bottle.jpg"
"""A photo and two renderings of a bottle in a row, and the same from another side below."""


@pytest.fixture
def photos(tmp_path):
    """The upper row: three pictures of a bottle."""
    picture = read_image(PHOTO)
    paths = [tmp_path / f"{number}.png" for number in range(3)]
    for path, part in zip(paths, np.array_split(picture[: len(picture) // 2], 3, axis=1), strict=True):
        write_image(path, part)
    return paths


def test_each_named_network_has_its_row():
    table = read_table()
    assert list(NETWORKS) == ["u2netp", "u2net", "isnet", "birefnet"]
    assert all(network.file in table and table[network.file].licence for network in NETWORKS.values())
    assert network_path("u2net") == NETWORKS["u2net"].path and str(network_path("my/u2net.onnx")) == "my/u2net.onnx"


@pytest.mark.parametrize(
    ("file", "side_px", "mean"),
    [
        ("isnet.onnx", 1024, NETWORKS["isnet"].mean),
        ("IsNet-general-use.onnx", 1024, NETWORKS["isnet"].mean),
        ("BiRefNet-general-epoch_244.onnx", 1024, LEVEL_MEAN),
        ("u2net.onnx", 320, LEVEL_MEAN),
    ],
)
def test_a_file_is_known_by_its_name_and_the_size_of_its_images(tmp_path, capfd, file, side_px, mean):
    write_network(tmp_path / file, side_px=side_px)
    assert SalientObjectNetwork(tmp_path / file).describe()["mean"] == pytest.approx(mean)
    assert not capfd.readouterr().err


def test_a_file_is_known_by_its_bytes(tmp_path, monkeypatch, capfd):
    write_network(tmp_path / "renamed.onnx")
    digest = hashlib.sha256((tmp_path / "renamed.onnx").read_bytes()).hexdigest()
    table = {name: replace(row, sha256=digest) if name == NETWORKS["isnet"].file else row for name, row in read_table().items()}
    monkeypatch.setattr(salient_networks, "read_table", lambda: table)
    described = SalientObjectNetwork(tmp_path / "renamed.onnx").describe()
    assert described == {"sha256": digest, "mean": [127.5] * 3, "deviation": [255.0] * 3} and not capfd.readouterr().err


def test_a_network_that_is_not_known_is_said(tmp_path, capfd):
    """Also one that only has the name of another: its input has another size."""
    for file in ("mine.onnx", "isnet.onnx"):
        write_network(tmp_path / file)
        described = SalientObjectNetwork(tmp_path / file).describe()
        assert described["mean"] == pytest.approx(LEVEL_MEAN) and described["deviation"] == pytest.approx(LEVEL_DEVIATION)
        said = capfd.readouterr().err
        assert f"warning: {tmp_path / file} is none of the known networks" in said and "set segment.saliency.mean and deviation" in said
    assert SalientObjectNetwork(tmp_path / "mine.onnx", MEAN, DEVIATION).describe()["mean"] == MEAN
    assert not capfd.readouterr().err
    with pytest.raises(StepError, match="mean and deviation go together"):
        SalientObjectNetwork(tmp_path / "mine.onnx", MEAN)


def test_a_named_network_is_checked_where_it_belongs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(StepError, match=r"u2netp.onnx are not there.*`snakemake resources/weights/saliency/u2netp.onnx` downloads it"):
        require_network(network_path(DEFAULT))
    network_path(DEFAULT).parent.mkdir(parents=True)
    network_path(DEFAULT).write_bytes(b"short")
    with pytest.raises(StepError, match="5 bytes, expected 4574861: it is cut short"):
        require_network(network_path(DEFAULT))
    with pytest.raises(StepError, match="u2nett does not exist; .*or one of u2netp, u2net, isnet, birefnet"):
        require_network(network_path("u2nett"))


def find_all(network, photos, threads):
    """The maps and those from closer, by so many threads."""
    before = numba.get_num_threads()
    numba.set_num_threads(threads)
    try:
        maps = network.find_maps(photos, 240)
        return [*maps, *network.look_closer(photos, maps, 480)]
    finally:
        numba.set_num_threads(before)


def assert_same_bytes(path, photos):
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("one thread is all that Numba may start here (NUMBA_NUM_THREADS)")
    network = SalientObjectNetwork(path)
    one, two = (find_all(network, photos, threads) for threads in (1, 2))
    assert all(first.tobytes() == second.tobytes() for first, second in zip(one, two, strict=True))
    return one


@pytest.mark.parametrize("side_px", [128, 520])
def test_maps_have_the_same_bytes_with_any_number_of_threads(tmp_path, photos, side_px):
    """Several photos are seen at once by a small network, and one at a time by one with a large input."""
    write_network(tmp_path / "small.onnx", side_px=side_px)
    assert_same_bytes(tmp_path / "small.onnx", photos)


def test_the_network_of_the_set_up_finds_a_bottle_with_any_number_of_threads(photos):
    if not REAL.is_file():
        pytest.skip(f"{REAL} is not there; `snakemake {NETWORKS[DEFAULT].path}` downloads it")
    maps = assert_same_bytes(REAL, photos)[: len(photos)]
    for path, found in zip(photos, maps, strict=True):
        inside = found > 0.5
        assert 0.05 < inside.mean() < 0.7 and found[inside].mean() > 0.8 and found[~inside].mean() < 0.1, path
