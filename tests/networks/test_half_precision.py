"""Networks where CUDA runs them in bfloat16: how far that moves their answers, and what stays in single precision.

The CPU calculates in bfloat16, too, so this needs no GPU. Where there is one, it is compared with the CPU. Differences are norms, as a
share of the norm of what is expected; the weights are random, so trained ones may differ by more or less.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor, nn
from torch.utils._python_dispatch import TorchDispatchMode

from helpers import fastsam_cases, foundationpose_cases, mast3r_cases, sam6d_cases, small_trellis
from helpers.named_parameters import fill, noise
from helpers.paths import PARITY
from helpers.seeded import seeded_tensor
from helpers.small_vggt import SETTINGS
from zeroshop_steps.networks import devices
from zeroshop_steps.networks.devices import run_network
from zeroshop_steps.networks.fastsam.model import FastSam
from zeroshop_steps.networks.foundationpose.model import RefineNet, ScoreNet
from zeroshop_steps.networks.foundationpose.settings import FoundationPoseSettings
from zeroshop_steps.networks.mast3r.model import MASt3R, Mast3rSettings
from zeroshop_steps.networks.sam6d.model import KnownObject, Sam6dPem
from zeroshop_steps.networks.trellis.sparse import Pooling, SparseVoxels
from zeroshop_steps.networks.vggt.model import Vggt
from zeroshop_steps.pose.foundationpose.estimator import apply_update

CPU = torch.device("cpu")
Case = Callable[[torch.device], dict[str, Tensor]]


def ready(network: nn.Module, parameters: Callable, device: torch.device) -> nn.Module:
    network.load_state_dict(parameters({name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}), strict=False)
    return network.eval().requires_grad_(False).to(device)


def mast3r(device: torch.device) -> dict[str, Tensor]:
    network = ready(MASt3R(Mast3rSettings(**mast3r_cases.SMALL)), mast3r_cases.parameters, device)
    first, second = network(*(image.to(device) for image in mast3r_cases.images()))
    return {f"{name} {side}": value for side, found in enumerate((first, second)) for name, value in vars(found).items()}


def vggt(device: torch.device) -> dict[str, Tensor]:
    network = fill(Vggt(replace(SETTINGS, image_px=70))).to(device)
    images = seeded_tensor("frames", (3, 3, 42, 70)).clamp(-1, 1).to(device) / 2 + 0.5
    # As in register/vggt: precision is of the attention, and the heads are outside of it.
    precision = devices.choose_precision("auto", device.type)
    with torch.autocast(device.type, enabled=False):
        found = network(images, points=False, precision=precision)
    return {"encodings": found.encodings, "depth": found.depth, "confidence": found.depth_confidence}


def sam6d_features(device: torch.device) -> dict[str, Tensor]:
    network = ready(Sam6dPem(sam6d_cases.SMALL), sam6d_cases.parameters, device)
    given = sam6d_cases.pose_inputs(sam6d_cases.SMALL)
    return {"features": network.describe(given["crop"].to(device), given["chosen"].to(device)).float()}


def sam6d_matching(device: torch.device) -> dict[str, Tensor]:
    network = ready(Sam6dPem(sam6d_cases.SMALL), sam6d_cases.parameters, device)
    with torch.autocast("cpu", enabled=False):
        given = {name: value.to(device) for name, value in sam6d_cases.pose_inputs(sam6d_cases.SMALL).items()}
    logits = {}
    network.match_coarse = lambda seen, known: logits.setdefault("coarse", network.coarse_point_matching(seen, known))
    network(given["points"], given["known_features"], KnownObject(given["known_points"], given["known_features"], given["model"]),
            given["draws"])  # fmt: skip
    return logits


def foundationpose_refiner(device: torch.device) -> dict[str, Tensor]:
    network = RefineNet(FoundationPoseSettings(**foundationpose_cases.SMALL))
    network.load_state_dict(foundationpose_cases.parameters(network.state_dict()))
    translation, turn = network.eval().to(device)(*(images.to(device) for images in foundationpose_cases.pairs()))
    start = torch.eye(4, device=device).expand(len(turn), -1, -1)
    return {"pose": apply_update(start, translation.float(), turn.float(), 2.0)}


def foundationpose_scorer(device: torch.device) -> dict[str, Tensor]:
    network = ScoreNet(FoundationPoseSettings(**foundationpose_cases.SMALL))
    network.load_state_dict(foundationpose_cases.parameters(network.state_dict()))
    scores = network.eval().to(device)(*(images.to(device) for images in foundationpose_cases.pairs()))
    return {"scores": scores - scores.mean()}  # only their order counts


def trellis(device: torch.device) -> dict[str, Tensor]:
    settings = small_trellis.SMALL
    networks = {name: fill(network).to(device) for name, network in small_trellis.make_networks(settings).items()}
    flow = settings.structure_flow

    def drawn(name: str, *shape: int) -> Tensor:
        return torch.from_numpy(noise(name, shape)).to(device)

    tokens, time = drawn("tokens", 7, flow.condition_width), torch.tensor(612.5, device=device)
    grid = drawn("grid", 1, flow.channels, *(flow.resolution,) * 3)
    with np.load(PARITY / "trellis.npz") as recorded:
        voxels = SparseVoxels(torch.from_numpy(recorded["places"]).long().to(device))
    latents = drawn("latents", len(voxels.coordinates), settings.latent_flow.channels)
    return {
        "structure flow": networks["structure_flow"](grid[0].flatten(1).T, time, tokens),
        "structure decoder": networks["structure_decoder"](grid),
        "latent flow": networks["latent_flow"](latents, voxels, Pooling.of(voxels), time, tokens),
        "mesh decoder": networks["mesh_decoder"](latents, voxels)[0],
    }


def fastsam(device: torch.device) -> dict[str, Tensor]:
    network = ready(FastSam(fastsam_cases.SMALL), fastsam_cases.parameters, device)
    (found,) = network(fastsam_cases.image().to(device))
    return vars(found)


LIMITS: dict[Case, float] = {
    mast3r: 0.05, vggt: 0.02, sam6d_features: 0.015, sam6d_matching: 1e-6, foundationpose_refiner: 0.004, foundationpose_scorer: 0.04,
    trellis: 0.03, fastsam: 0.05,
}  # fmt: skip
"""About twice what was measured; that of matching is 0, since it runs in single precision."""


@pytest.fixture(autouse=True)
def without_shortcuts():
    """Those of nn.MultiheadAttention and nn.TransformerEncoderLayer, which autocasting switches off on CUDA, but not on the CPU."""
    torch.backends.mha.set_fastpath_enabled(False)
    yield
    torch.backends.mha.set_fastpath_enabled(True)


class Attentions(TorchDispatchMode):
    """Counts fused attention, and softmax over the last axis of (B, heads, N, M) scores, which attention without it takes."""

    fused = plain = 0

    def __torch_dispatch__(self, operator, types, args=(), kwargs=None):
        name = operator.name()
        self.fused += "scaled_dot_product" in name
        self.plain += "_softmax" in name and args[0].ndim == 4 and args[1] in (3, -1)
        return operator(*args, **(kwargs or {}))


def run(case: Case, device: torch.device, precision: torch.dtype, monkeypatch: pytest.MonkeyPatch) -> dict[str, Tensor]:
    monkeypatch.setattr(devices, "choose_precision", lambda *_: precision)
    with run_network(device, case.__name__):
        return {name: value.cpu() for name, value in case(device).items()}


def assert_near(found: dict[str, Tensor], expected: dict[str, Tensor], limit: float) -> None:
    for name, value in expected.items():
        assert value.dtype == found[name].dtype == torch.float32, f"{name} is read in single precision"
        error = float((found[name].double() - value.double()).norm() / value.double().norm())
        assert error < limit, (name, error)


@pytest.mark.parametrize("case", LIMITS, ids=lambda case: case.__name__)
def test_half_precision_changes_little(case, monkeypatch):
    exact = run(case, CPU, torch.float32, monkeypatch)
    with Attentions() as attentions:
        half = run(case, CPU, torch.bfloat16, monkeypatch)
    assert_near(half, exact, LIMITS[case])
    assert attentions.plain == 0 and (attentions.fused > 0 or case is fastsam), "CUDA has fused kernels for attention"
    if case is not sam6d_matching:
        assert any(not torch.equal(half[name], exact[name]) for name in exact), "something ran in half precision"


@pytest.mark.skipif(not torch.cuda.is_available(), reason="PyTorch finds no CUDA device")
@pytest.mark.parametrize("case", LIMITS, ids=lambda case: case.__name__)
def test_cuda_answers_as_the_cpu_does(case, monkeypatch):
    exact = run(case, CPU, torch.float32, monkeypatch)
    # Convolutions take TF32 on CUDA, whose mantissa has 10 bits.
    assert_near(run(case, torch.device("cuda"), torch.float32, monkeypatch), exact, 1e-2)
    assert_near(run(case, torch.device("cuda"), torch.bfloat16, monkeypatch), exact, max(LIMITS[case], 1e-2))
