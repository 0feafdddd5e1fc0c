"""What is compared with the reference of MASt3R: sizes of a small network, its parameters, and its inputs."""

import re
from collections.abc import Iterable, Mapping

import torch

from helpers.seeded import seeded_state, seeded_tensor

SMALL = {
    "encoder_channels": 64,
    "encoder_depth": 2,
    "encoder_heads": 2,
    "decoder_channels": 48,
    "decoder_depth": 10,
    "decoder_heads": 3,
    "descriptor_channels": 24,
}
SIZES_PX = ((32, 48), (48, 32))
"""(height, width) of the two pictures: landscape and portrait, with an odd number of patches along one side."""


def parameters(shapes: Mapping[str, tuple[int, ...]]) -> dict[str, torch.Tensor]:
    """Random parameters by the names of the checkpoint; it has the convolutions of the levels twice."""
    aliases = {}
    for name in shapes:
        found = re.fullmatch(r"(.*scratch\.)layer_rn\.(\d)(\..*)", name)
        if found:
            aliases[name] = f"{found[1]}layer{int(found[2]) + 1}_rn{found[3]}"
    return seeded_state(shapes, aliases)


def images() -> tuple[torch.Tensor, torch.Tensor]:
    """Two pictures (1, 3, height, width) of noise from -1 to 1."""
    first, second = (seeded_tensor(f"image {side}", (1, 3, *size)).clamp(-1, 1) for side, size in enumerate(SIZES_PX))
    return first, second


def folded(shapes: Mapping[str, tuple[int, ...]]) -> list[str]:
    """Names and shapes as lines, those of equal blocks once: `enc_blocks.0-23.norm1.weight 1024`."""
    last: dict[str, int] = {}
    lines: dict[str, str] = {}
    for name, shape in shapes.items():
        stem = re.sub(r"(blocks2?|transformers)\.\d+\.", r"\1.*.", name)
        number = re.search(r"(?:blocks2?|transformers)\.(\d+)\.", name)
        line = f"{stem} {'x'.join(map(str, shape))}"
        if lines.setdefault(stem, line) != line:
            raise ValueError(f"{name} is not shaped like the others of its kind")
        last[stem] = max(last.get(stem, 0), int(number[1]) if number else 0)
    return [line.replace(".*.", f".0-{last[stem]}.") for stem, line in lines.items()]


def unfolded(lines: Iterable[str]) -> dict[str, tuple[int, ...]]:
    """The shapes by name that `folded` wrote."""
    shapes = {}
    for line in lines:
        name, _, sides = line.partition(" ")
        shape = tuple(map(int, sides.split("x"))) if sides else ()
        found = re.search(r"\.0-(\d+)\.", name)
        for number in range(int(found[1]) + 1) if found else [None]:
            shapes[name if number is None else name.replace(found[0], f".{number}.")] = shape
    return shapes
