"""What Depth Anything 3 is compared with itself on: small sizes, and inputs that are drawn anew on both sides."""

import torch

from helpers.named_parameters import noise

WIDTH, HEADS, DEPTH, ALONE, LAYERS = 32, 2, 10, 2, (3, 5, 7, 9)
CHANNELS, FEATURES, CAMERA_DEPTH, CAMERA_HEADS = (8, 12, 16, 16), 16, 2, 4
GRID, PATCH_PX = 5, 14
FRAMES, SIZE_PX = 4, (42, 70)


def images() -> torch.Tensor:
    """(S, 3, H, W) in 0 to 1."""
    return inputs("images", FRAMES, 3, *SIZE_PX) / 2 + 0.5


def layers() -> list[torch.Tensor]:
    """Tokens of the dense head."""
    patches = SIZE_PX[0] * SIZE_PX[1] // PATCH_PX**2
    return [inputs(f"tokens{index}", FRAMES, patches, 2 * WIDTH) for index in LAYERS]


def inputs(name: str, *shape: int) -> torch.Tensor:
    """Made-up inputs of a module."""
    return torch.from_numpy(noise(name, shape))
