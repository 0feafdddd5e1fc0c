"""MobileSAM: its joined convolutions, published names, and what the published weights cut out."""

import cv2
import numpy as np
import pytest
import torch
from kornia.models.tiny_vit import TinyViT

from helpers.paths import REPOSITORY
from zeroshop_steps.geometry.imaging.images import compute_overlap
from zeroshop_steps.networks.mobile_sam.choice import FILE, find_segmenter
from zeroshop_steps.networks.mobile_sam.model import MobileSam, fuse_normalizations, rename_parameters
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER
from zeroshop_steps.runtime.errors import StepError


@pytest.fixture(scope="module")
def published():
    path = REPOSITORY / WEIGHTS_FOLDER / FILE
    if not path.is_file():
        pytest.skip(f"{path} is not there; `snakemake {WEIGHTS_FOLDER / FILE}` downloads it")
    torch.set_num_threads(1)
    return MobileSam(path)


@torch.no_grad()
def test_joined_convolutions_give_the_same():
    torch.manual_seed(0)
    network, image = TinyViT.from_config("5m", img_size=64, mobile_sam=True).eval(), torch.randn(1, 3, 64, 64)
    for tensor in network.state_dict().values():
        if tensor.ndim == 1:  # means and deviations of batches as after training
            tensor.copy_(torch.rand(tensor.shape) * 0.5 + 0.5)
    before = network(image)
    fuse_normalizations(network)
    assert before.shape == (1, 256, 4, 4) and torch.allclose(network(image), before, rtol=1e-3, atol=1e-4)
    assert not any(isinstance(module, torch.nn.BatchNorm2d) for module in network.modules())


def test_published_names_become_those_of_transformers():
    pairs = {
        "image_encoder.neck.0.weight": "image_encoder.neck.0.weight",
        "prompt_encoder.pe_layer.positional_encoding_gaussian_matrix": "prompt_encoder.shared_embedding.positional_embedding",
        "prompt_encoder.mask_downscaling.4.bias": "prompt_encoder.mask_embed.layer_norm2.bias",
        "mask_decoder.transformer.layers.1.norm4.weight": "mask_decoder.transformer.layers.1.layer_norm4.weight",
        "mask_decoder.output_hypernetworks_mlps.3.layers.2.bias": "mask_decoder.output_hypernetworks_mlps.3.proj_out.bias",
        "mask_decoder.iou_prediction_head.layers.1.bias": "mask_decoder.iou_prediction_head.layers.0.bias",
    }
    given = {name: torch.zeros(1) for name in pairs}
    assert list(rename_parameters(given)) == list(pairs.values())


def test_a_file_of_another_network_is_refused(tmp_path):
    torch.save({"image_encoder.neck.0.weight": torch.zeros(2, 2)}, tmp_path / "other.pt")
    with pytest.raises(StepError, match=r"other.pt does not fit .*missing"):
        MobileSam(tmp_path / "other.pt")


def test_weights_may_be_missing_but_not_those_of_the_user(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert find_segmenter("none") is None and not capsys.readouterr().err
    assert find_segmenter("mobile_sam") is None
    said = capsys.readouterr().err
    assert "without Segment Anything" in said and "snakemake resources/weights/mobile_sam.pt" in said
    with pytest.raises(StepError, match="own.pt do not exist; segment.saliency.segmenter"):
        find_segmenter("own.pt")
    (tmp_path / "own.pt").touch()
    assert str(find_segmenter("own.pt")) == "own.pt"


def draw_ball_on_wood() -> tuple[np.ndarray, np.ndarray]:
    """A photo, (300, 400, 3), of a shaded red ball with a white stripe on brown planks, and where the ball is."""
    rows, columns = np.indices((300, 400))
    photo = np.zeros((300, 400, 3), np.float32) + (150, 105, 60)
    photo += 15 * np.sin(columns / 3 + 4 * np.sin(rows / 40))[..., None]
    ball = np.hypot(columns - 230, rows - 140) < 60
    shade = 0.5 + 0.5 * np.clip(1 - np.hypot(columns - 210, rows - 115) / 110, 0, 1)
    photo[ball] = (shade[..., None] * (200, 30, 30))[ball]
    stripe = ball & (abs(rows - 140) < 12)
    photo[stripe] = (shade[..., None] * (240, 240, 240))[stripe]
    return cv2.GaussianBlur(photo, (3, 3), 0).clip(0, 255).astype(np.uint8), ball


def test_the_published_network_cuts_out_a_ball(published):
    photo, ball = draw_ball_on_wood()
    features = published.encode(photo)
    box = np.array([[170, 80], [290, 200]]) / (400, 300)
    points, labels = np.array([[230, 140], [250, 110]]) / (400, 300), np.ones(2)
    for asked in ({"box": box}, {"points": points, "labels": labels}):
        odds = published.decode(features, **asked)
        assert odds.shape == (3, 96, 128) and odds.dtype == np.float32
        whole = cv2.resize(odds[-1], (400, 300)) > 0
        assert compute_overlap(whole, ball) > 0.97
