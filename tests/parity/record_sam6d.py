"""Record what the published SAM-6D answers, for the tests of its instance segmentation (README.md says how)."""

import sys
import types
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import torch

from helpers.sam6d_cases import region_case

FOLDER = Path(__file__).parent
ISM = "SAM-6D/Instance_Segmentation_Model"


def stand_in(*names: str) -> None:
    """Modules that the reference imports, but whose work is not compared: training, files and pictures."""
    for name in names:
        module = types.ModuleType(name)
        module.__getattr__ = lambda _: MagicMock()
        sys.modules[name] = module
    sys.modules["pytorch_lightning"].LightningModule = torch.nn.Module


def record_regions(checkout: Path) -> None:
    """The scores of the instance segmentation, each region alone: where boxes do not meet, it spoils the others' scores."""
    stand_in("pytorch_lightning", "tqdm", "torchvision", "torchvision.transforms", "torchvision.utils", "hydra", "hydra.utils", "trimesh")
    stand_in(
        "utils.inout", "model.utils", "utils.poses.pose_utils", "segment_anything.utils.transforms", "torchvision.transforms.functional"
    )
    sys.modules["pytorch_lightning"].LightningModule = torch.nn.Module
    sys.modules["segment_anything"] = types.ModuleType("segment_anything")
    sys.modules["segment_anything.utils"] = types.ModuleType("segment_anything.utils")
    sys.modules["segment_anything.utils.transforms"].ResizeLongestSide = object
    sys.modules["model.utils"].BatchedData = _Batches
    sys.path.insert(0, str(checkout / ISM))
    from model.detector import Instance_Segmentation_Model as Reference
    from model.loss import PairwiseSimilarity

    case = region_case()
    tensors = {name: torch.from_numpy(np.asarray(value)) for name, value in vars(case).items()}
    poses = torch.eye(4).repeat(len(case.rotations), 1, 1)
    poses[:, :3, :3] = tensors["rotations"].float()
    known = {
        "descriptors": tensors["view_wholes"], "appe_descriptors": tensors["view_patches"],
        "poses": poses, "pointcloud": tensors["points_m"].float(),
    }  # fmt: skip
    matching = SimpleNamespace(metric=PairwiseSimilarity(), aggregation_function="avg_5", confidence_thresh=0.2)
    reference = SimpleNamespace(ref_data=known, matching_config=matching)
    for name in ("best_template_pose", "Calculate_the_query_translation"):
        setattr(reference, name, types.MethodType(getattr(Reference, name), reference))
    _, numbers, meanings, views = Reference.compute_semantic_score(reference, tensors["wholes"])
    appearance, view_patches = Reference.compute_appearance_score(reference, views, numbers, tensors["patches"])
    image = {"depth": tensors["depth_mm"][None], "cam_intrinsic": tensors["intrinsics"][None], "depth_scale": 1.0}
    pixels_of_all = Reference.project_template_to_image(reference, views, numbers, image, tensors["masks"][:, None].float())
    boxes, overlaps, visible = [], [], []
    for index in range(len(numbers)):
        one = slice(index, index + 1)
        pixels = pixels_of_all[one]
        boxes.append(np.r_[pixels[0].min(0).values, pixels[0].max(0).values])
        proposal = SimpleNamespace(boxes=torch.from_numpy(case.boxes)[one])
        overlap, ratio = Reference.compute_geometric_score(reference, pixels, proposal, tensors["patches"][one], view_patches[one], 0.5)
        overlaps.append(float(overlap))
        visible.append(float(ratio))
    overlaps, visible = torch.tensor(overlaps), torch.tensor(visible)
    scores = (meanings + appearance + overlaps * visible) / (1 + 1 + visible)
    found = {"numbers": numbers, "views": views, "meanings": meanings, "appearance": appearance, "visible": visible, "overlaps": overlaps}
    found |= {"boxes": torch.from_numpy(np.array(boxes)), "scores": scores}
    np.savez_compressed(FOLDER / "sam6d_ism.npz", **{name: np.asarray(value) for name, value in found.items()})


class _Batches:
    """A list that its owner fills and stacks."""

    def __init__(self, batch_size: int | None, data: torch.Tensor | None = None) -> None:
        self.data = []

    def append(self, data: torch.Tensor) -> None:
        self.data.append(data)

    def stack(self) -> None:
        self.data = torch.stack(self.data)


if __name__ == "__main__":
    record_regions(Path(sys.argv[1]))
