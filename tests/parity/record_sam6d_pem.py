"""Record what the published pose estimation of SAM-6D answers, for the tests of networks/sam6d (README.md says how).

Its CUDA operations on points are replaced by plain loops, which are written here and in no other way like ours.
"""

import functools
import resource
import sys
import time
import types
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import torch

from helpers import sam6d_cases as cases
from helpers.mast3r_cases import folded
from zeroshop_steps.networks.sam6d.settings import Sam6dSettings

FOLDER = Path(__file__).parent
PEM = "SAM-6D/Pose_Estimation_Model"


def sample_one_after_the_other(points: torch.Tensor, count: int) -> torch.Tensor:
    """Farthest-point sampling, cloud by cloud."""
    chosen = []
    for cloud in points.numpy():
        indices, nearest = [0], np.full(len(cloud), np.inf, np.float32)
        while len(indices) < count:
            nearest = np.minimum(nearest, ((cloud - cloud[indices[-1]]) ** 2).sum(1))
            indices.append(int(nearest.argmax()))
        chosen.append(indices)
    return torch.tensor(chosen, dtype=torch.int32)


def look_around_each(centres: torch.Tensor, points: torch.Tensor, radius: float, count: int) -> torch.Tensor:
    """The first points within a radius of each centre, and then the first again."""
    found = np.zeros((*centres.shape[:2], count), np.int32)
    for batch, (some, cloud) in enumerate(zip(centres.numpy(), points.numpy(), strict=True)):
        for index, centre in enumerate(some):
            inside = np.flatnonzero(((centre - cloud) ** 2).sum(1) < np.float32(radius * radius))[:count]
            if len(inside):
                found[batch, index] = inside[0]
                found[batch, index, : len(inside)] = inside
    return torch.from_numpy(found)


def gather(features: torch.Tensor, indices: torch.Tensor) -> torch.Tensor:
    """(B, C, ...) of (B, C, N) by (B, ...) indices."""
    return torch.stack([one[:, index.long()] for one, index in zip(features, indices, strict=True)])


def import_reference(checkout: Path) -> types.SimpleNamespace:
    """Its modules, with the loops above in place of the CUDA extension."""
    package, extension = types.ModuleType("pointnet2"), types.ModuleType("pointnet2._ext")
    extension.furthest_point_sampling = sample_one_after_the_other
    extension.ball_query = look_around_each
    extension.gather_points = extension.group_points = gather
    package._ext = extension
    sys.modules |= {"pointnet2": package, "pointnet2._ext": extension}
    for folder in ("model", "utils", "model/pointnet2"):
        sys.path.insert(0, str(checkout / PEM / folder))
    import feature_extraction
    import model_utils
    import pose_estimation_model

    return SimpleNamespace(features=feature_extraction, utils=model_utils, whole=pose_estimation_model)


def make_network(reference: types.SimpleNamespace, sizes: Sam6dSettings) -> torch.nn.Module:
    """The reference in these sizes, with random parameters."""
    matching = {
        "nblock": sizes.blocks, "input_dim": sizes.features, "hidden_dim": sizes.channels, "out_dim": sizes.features,
        "temp": 0.1, "sim_type": "cosine", "normalize_feat": True, "loss_dis_thres": 0.15,
    }  # fmt: skip
    configuration = SimpleNamespace(
        coarse_npoint=sizes.sparse_points,
        fine_npoint=sizes.dense_points,
        feature_extraction=SimpleNamespace(
            vit_type="vit_base", up_type="linear", embed_dim=sizes.vision_channels, out_dim=sizes.features,
            use_pyramid_feat=True, pretrained=False,
        ),
        geo_embedding=SimpleNamespace(sigma_d=0.2, sigma_a=15, angle_k=3, reduction_a="max", hidden_dim=sizes.channels),
        coarse_point_matching=SimpleNamespace(**matching, nproposal1=sizes.hypotheses, nproposal2=sizes.kept_hypotheses),
        fine_point_matching=SimpleNamespace(**matching, pe_radius1=0.1, pe_radius2=0.2, focusing_factor=3),
    )  # fmt: skip
    network = reference.whole.Net(configuration)
    network.feature_extraction.rgb_net.vit = reference.features.ViT(
        patch_size=16, embed_dim=sizes.vision_channels, depth=sizes.vision_depth, num_heads=sizes.vision_heads, mlp_ratio=4,
        qkv_bias=True, norm_layer=functools.partial(torch.nn.LayerNorm, eps=1e-6),
    )  # fmt: skip
    shapes = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    network.load_state_dict(cases.parameters(shapes), strict=False)
    return network.eval()


def watch(network: torch.nn.Module, found: dict[str, torch.Tensor]) -> None:
    """Keep what modules answer while the whole network runs."""

    def keep(name):
        def hook(_, __, output):
            for index, tensor in enumerate(output if isinstance(output, tuple | list) else [output]):
                if isinstance(tensor, torch.Tensor):
                    found.setdefault(f"{name}{index}" if isinstance(output, tuple | list) else name, tensor)

        return hook

    coarse, fine = network.coarse_point_matching, network.fine_point_matching
    network.feature_extraction.rgb_net.vit.register_forward_hook(keep("vision"))
    network.geo_embedding.register_forward_hook(keep("pairs"))
    coarse.transformers[0].layers[0].register_forward_hook(keep("alone"))
    coarse.transformers[0].register_forward_hook(keep("coarse_block"))
    fine.PE.register_forward_hook(keep("surroundings"))
    fine.transformers[0].dense_layer.register_forward_hook(keep("linear"))
    fine.transformers[0].register_forward_hook(keep("fine_block"))


def run(reference: types.SimpleNamespace, network: torch.nn.Module, sizes: Sam6dSettings, batch: int) -> dict[str, torch.Tensor]:
    """What the modules and the whole network answer to the inputs of the tests."""
    given, found = cases.pose_inputs(sizes, batch), {}
    torch.rand = lambda *_, **__: given["draws"]
    similarity = reference.utils.compute_feature_similarity
    logits = []
    for module in (sys.modules["coarse_point_matching"], sys.modules["fine_point_matching"]):
        module.compute_feature_similarity = lambda *arguments: logits.append(similarity(*arguments)) or logits[-1]
    watch(network, found)
    inputs = {
        "rgb": given["crop"], "rgb_choose": given["chosen"], "pts": given["points"], "model": given["model"],
        "dense_po": given["known_points"], "dense_fo": given["known_features"],
    }  # fmt: skip
    start_s = time.process_time()
    answer = network(inputs)
    print(f"{time.process_time() - start_s:.1f} s CPU, {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")
    found |= {"coarse_logits": logits[0], "fine_logits": logits[1], "coarse_rotations": answer["init_R"], "coarse_places": answer["init_t"]}
    return found | {"rotations": answer["pred_R"], "places": answer["pred_t"], "scores": answer["pred_pose_score"]}


@torch.no_grad()
def main() -> None:
    """Record the small network, and the names and shapes of the full one; with a folder as second argument, a pass of the full one."""
    reference = import_reference(Path(sys.argv[1]))
    if len(sys.argv) > 2:
        found = run(reference, make_network(reference, cases.FULL), cases.FULL, batch=1)
        np.savez(Path(sys.argv[2]) / "sam6d_pem_full.npz", **{name: np.asarray(found[name]) for name in cases.WHOLE})
        return
    found = run(reference, make_network(reference, cases.SMALL), cases.SMALL, batch=2)
    np.savez_compressed(FOLDER / "sam6d_pem.npz", **{name: np.asarray(tensor) for name, tensor in found.items()})
    full = make_network(reference, cases.FULL).state_dict()
    (FOLDER / "sam6d_pem_parameters.txt").write_text(
        "".join(f"{line}\n" for line in folded({name: tuple(tensor.shape) for name, tensor in full.items()}))
    )


if __name__ == "__main__":
    main()
