"""Cameras from the camera tokens, in rounds: the last estimate modulates the next (VGGT, section 3.3; Peebles and Xie 2023)."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zeroshop_steps.networks.layers import NORM_EPSILON, Block, Mlp
from zeroshop_steps.networks.vggt.settings import VggtSettings

ENCODING = 9  # translation (3), quaternion x y z w (4), vertical and horizontal field of view in radians (2)


class CameraHead(nn.Module):
    """From (S, 2 x width) camera tokens to (S, 9) pose encodings; all cameras together."""

    def __init__(self, settings: VggtSettings) -> None:
        super().__init__()
        width = 2 * settings.width
        self.trunk = nn.Sequential(*(Block(width, settings.heads) for _ in range(settings.camera_depth)))
        self.token_norm = nn.LayerNorm(width)
        self.trunk_norm = nn.LayerNorm(width)
        self.empty_pose_tokens = nn.Parameter(torch.zeros(1, 1, ENCODING))
        self.embed_pose = nn.Linear(ENCODING, width)
        self.poseLN_modulation = nn.Sequential(nn.SiLU(), nn.Linear(width, 3 * width))
        self.pose_branch = Mlp(width, width // 2, ENCODING)

    def forward(self, tokens: Tensor, rounds: int = 4) -> Tensor:
        tokens = self.token_norm(tokens)
        plain = F.layer_norm(tokens, tokens.shape[-1:], eps=NORM_EPSILON)
        total: Tensor | None = None
        for _ in range(rounds):
            last = self.empty_pose_tokens[0].expand(len(tokens), -1) if total is None else total
            shift, scale, gate = self.poseLN_modulation(self.embed_pose(last)).chunk(3, dim=-1)
            refined = self.trunk((tokens + gate * (plain * (1 + scale) + shift))[None])[0]
            change = self.pose_branch(self.trunk_norm(refined))
            total = change if total is None else total + change
        assert total is not None, "at least one round"
        # A field of view has no sign; the running total keeps its own.
        return torch.cat([total[:, :7], total[:, 7:].relu()], dim=1)
