"""Cameras from their tokens, and tokens of known cameras (Depth Anything 3, section 3)."""

import torch
from torch import Tensor, nn

from zeroshop_steps.networks.da3.settings import Da3Settings
from zeroshop_steps.networks.layers import Block, Mlp
from zeroshop_steps.networks.vggt.camera_head import ENCODING


class CameraDecoder(nn.Module):
    """From (S, 2 x width) camera tokens to (S, 9) encodings of world_from_camera, laid out as VGGT's."""

    def __init__(self, settings: Da3Settings) -> None:
        super().__init__()
        width = 2 * settings.width
        self.backbone = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.fc_t = nn.Linear(width, 3)
        self.fc_qvec = nn.Linear(width, 4)
        self.fc_fov = nn.Sequential(nn.Linear(width, 2), nn.ReLU())

    def forward(self, tokens: Tensor) -> Tensor:
        features = self.backbone(tokens)
        return torch.cat([self.fc_t(features), self.fc_qvec(features), self.fc_fov(features)], dim=1)


class CameraEncoder(nn.Module):
    """From (S, 9) encodings of world_from_camera of known cameras to (S, width) tokens; all cameras together."""

    def __init__(self, settings: Da3Settings) -> None:
        super().__init__()
        width = settings.width
        self.trunk = nn.Sequential(*(Block(width, settings.camera_heads) for _ in range(settings.camera_depth)))
        self.token_norm = nn.LayerNorm(width)
        self.trunk_norm = nn.LayerNorm(width)
        self.pose_branch = Mlp(ENCODING, width // 2, width)

    def forward(self, encodings: Tensor) -> Tensor:
        return self.trunk_norm(self.trunk(self.token_norm(self.pose_branch(encodings))[None])[0])


def invert_encodings(encodings: Tensor) -> Tensor:
    """(S, 9) encodings of the inverse poses; a quaternion of length 0 gives what is not a number."""
    x, y, z, w = (encodings[:, 3:7] / encodings[:, 3:7].norm(dim=1, keepdim=True)).unbind(1)
    away = torch.stack([-x, -y, -z], dim=1)
    turned = torch.linalg.cross(away, encodings[:, :3])
    back = encodings[:, :3] + 2 * (w[:, None] * turned + torch.linalg.cross(away, turned))
    return torch.cat([-back, away, w[:, None], encodings[:, 7:]], dim=1)
