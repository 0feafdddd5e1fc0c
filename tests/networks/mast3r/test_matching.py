"""Pictures, matches and memory of MASt3R."""

import numpy as np
import pytest
import torch

from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.networks import devices
from zeroshop_steps.networks.devices import MemoryNeeds, check_memory, choose_device, run_network
from zeroshop_steps.networks.mast3r import matching
from zeroshop_steps.networks.mast3r.framing import fit_framing, fit_framing_of_file, load_picture
from zeroshop_steps.networks.mast3r.inference import Mast3rPredictor, predict_peak_bytes
from zeroshop_steps.networks.mast3r.matching import find_nearest, find_reciprocal, make_start_grid
from zeroshop_steps.networks.mast3r.model import MASt3R, Mast3rSettings
from zeroshop_steps.runtime.errors import StepError


@pytest.mark.parametrize(
    ("size", "kept"), [((1000, 750), (512, 384)), ((750, 1000), (384, 512)), ((200, 100), (512, 256)), ((641, 480), (512, 368))]
)
def test_pictures_of_any_shape_come_to_multiples_of_patches(tmp_path, size, kept):
    width, height = size
    x = np.rint(np.linspace(0, 255, width))[None, :, None]
    write_image(tmp_path / "a.png", np.broadcast_to(x, (height, width, 3)).astype(np.uint8))
    picture, framing = load_picture(tmp_path / "a.png")
    assert picture.shape == (3, kept[1], kept[0]) and picture.min() >= -1.0 and picture.max() <= 1.0
    assert framing == fit_framing_of_file(tmp_path / "a.png")
    assert framing.width_px % 16 == framing.height_px % 16 == 0
    places = np.array([[0.5, 0.5], [kept[0] / 2, kept[1] / 2], [kept[0] - 0.5, 7.5]])
    assert np.allclose(framing.from_original(framing.to_original(places)), places)
    # The ramp says where each pixel comes from.
    columns = framing.to_original(np.stack([np.arange(kept[0]) + 0.5, np.zeros(kept[0])], axis=1))[:, 0] - 0.5
    seen = (picture[0, kept[1] // 2].numpy() + 1.0) * 127.5
    assert np.abs(seen - columns / (width - 1) * 255)[2:-2].max() < 1.2


def test_a_picture_that_is_hardly_there_is_refused():
    with pytest.raises(StepError, match="too narrow"):
        fit_framing(1000, 20)


def test_matches_are_exactly_the_mutual_nearest_features_that_the_starts_lead_to():
    generator = torch.Generator().manual_seed(0)
    first, second = (torch.nn.functional.normalize(torch.randn(count, 6, generator=generator), dim=1) for count in (300, 200))
    similar = first @ second.T
    mutual = {(int(i), int(j)) for i, j in enumerate(similar.argmax(1)) if similar[:, j].argmax() == i}
    everywhere = {tuple(pair) for pair in find_reciprocal(first, second, torch.arange(300)).tolist()}
    assert everywhere == mutual
    some = {tuple(pair) for pair in find_reciprocal(first, second, torch.arange(0, 300, 10)).tolist()}
    assert some and some < mutual
    assert find_reciprocal(first, second, torch.zeros(0, dtype=torch.int64)).shape == (0, 2)


def test_the_nearest_feature_is_the_same_in_blocks(monkeypatch):
    features = torch.nn.functional.normalize(torch.randn(500, 4, generator=torch.Generator().manual_seed(1)), dim=1)
    whole = find_nearest(features[:50], features)
    assert whole.tolist() == list(range(50))
    monkeypatch.setitem(matching.TILE, "cpu", (7, 90))
    assert torch.equal(find_nearest(features[:50], features), whole)


def test_starts_are_the_middles_of_cells():
    assert make_start_grid(16, 24, 8).tolist() == [100, 108, 116, 292, 300, 308]


def test_memory_is_predicted_and_what_cannot_fit_is_refused(monkeypatch):
    framings = [fit_framing(1000, 750)] * 20
    needed = predict_peak_bytes(688_638_856, framings, Mast3rSettings())
    assert 2.8e9 < needed < 6e9
    assert predict_peak_bytes(688_638_856, framings * 10, Mast3rSettings()) > needed + 180 * 3.1e6
    monkeypatch.setattr(devices, "measure_free_bytes", lambda device: int(2e9))
    with pytest.raises(StepError, match=r"MASt3R takes 4\.0 GB at its peak, the device cpu has 2\.0 GB free: use colmap"):
        check_memory(MemoryNeeds(int(4e9), "MASt3R", "use colmap"), torch.device("cpu"))
    monkeypatch.setattr(devices, "measure_free_bytes", lambda device: int(8e9))
    check_memory(MemoryNeeds(int(4e9), "MASt3R", "use colmap"), torch.device("cpu"))
    assert devices.measure_free_bytes(torch.device("cpu")) > 1e7


def test_what_would_fit_is_said(tmp_path, monkeypatch):
    for number in range(3):
        write_image(tmp_path / f"{number}.png", np.full((96, 128, 3), number, np.uint8))
    with torch.device("meta"):
        network = MASt3R(Mast3rSettings(64, 1, 2, 48, 4, 3))
    paths = sorted(tmp_path.iterdir())
    monkeypatch.setattr(devices, "measure_free_bytes", lambda device: int(1.445e9))
    with pytest.raises(
        StepError, match=r"MASt3R on 3 pictures of 512 x 384 px takes 1\.7 GB .* 1\.4 GB free: --long-side-px 368 would fit"
    ):
        Mast3rPredictor(network, paths, torch.device("cpu"))
    monkeypatch.setattr(devices, "measure_free_bytes", lambda device: int(1e8))
    with pytest.raises(StepError, match="no size of pictures would fit"):
        Mast3rPredictor(network, paths, torch.device("cpu"))


def test_cuda_that_is_absent_and_memory_that_runs_out_are_said(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert choose_device("auto") == "cpu"
    with pytest.raises(StepError, match="finds no CUDA device"):
        choose_device("cuda")
    with pytest.raises(StepError, match="MASt3R ran out of memory"), run_network(torch.device("cpu"), "MASt3R"):
        raise torch.OutOfMemoryError("too much")
