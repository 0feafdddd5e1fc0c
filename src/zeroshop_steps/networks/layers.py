"""What the networks have in common, under the names that their checkpoints use.

Their decoders for dense maps are alike, but not the same: the residual units of VGGT start their shortcut after the first activation,
those of MASt3R before it.
"""

import torch.nn.functional as F
from torch import Tensor, nn

NORM_EPSILON = 1e-6  # of the layer norms of vision transformers


class Mlp(nn.Module):
    """Two linear layers with a GELU between."""

    def __init__(self, width: int, hidden: int, out: int | None = None) -> None:
        super().__init__()
        self.fc1 = nn.Linear(width, hidden)
        self.fc2 = nn.Linear(hidden, width if out is None else out)

    def forward(self, x: Tensor) -> Tensor:
        return self.fc2(F.gelu(self.fc1(x)))
