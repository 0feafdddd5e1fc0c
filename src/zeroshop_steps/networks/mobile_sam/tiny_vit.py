"""TinyViT (Wu et al., ECCV 2022), the image encoder of MobileSAM, with the names and sizes of its published parameters.

Convolutions with batch normalization, then three stages of attention in windows, each with a depthwise convolution between attention and
multilayer perceptron. The last stage keeps the resolution, so the features have a sixteenth of the image's.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval

KERNEL = 3  # of the depthwise convolutions


@dataclass(frozen=True)
class TinyVitSettings:
    """Sizes; the published ones by default.

    Attributes:
        widths: channels of the four stages.
        depths: blocks of each.
        heads, windows: of the attention, and the sides of its windows in tokens; the first stage has none.
        expansion: of the hidden channels of a block.
        out_width: channels of the features.
    """

    widths: Sequence[int] = (64, 128, 160, 320)
    depths: Sequence[int] = (2, 2, 6, 2)
    heads: Sequence[int] = (2, 4, 5, 10)
    windows: Sequence[int] = (7, 7, 14, 7)
    expansion: int = 4
    out_width: int = 256


class NormalizedConv(nn.Module):
    """A convolution without offset, and batch normalization."""

    def __init__(self, inputs: int, outputs: int, kernel: int = 1, stride: int = 1, groups: int = 1) -> None:
        super().__init__()
        self.c = nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, groups=groups, bias=False)
        self.bn: nn.Module = nn.BatchNorm2d(outputs)

    def forward(self, x: Tensor) -> Tensor:
        return self.bn(self.c(x))

    def fuse(self) -> None:
        """Make it one convolution, which gives the same in half the passes over memory."""
        assert isinstance(self.bn, nn.BatchNorm2d), "it is fused already"
        self.c, self.bn = fuse_conv_bn_eval(self.c, self.bn), nn.Identity()


class PatchEmbedding(nn.Module):
    """A quarter of the resolution, by two convolutions."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.seq = nn.Sequential(NormalizedConv(3, width // 2, KERNEL, 2), nn.GELU(), NormalizedConv(width // 2, width, KERNEL, 2))

    def forward(self, x: Tensor) -> Tensor:
        return self.seq(x)


class InvertedBottleneck(nn.Module):
    """MBConv: more channels, a depthwise convolution, and fewer channels again."""

    def __init__(self, width: int, expansion: int) -> None:
        super().__init__()
        hidden = width * expansion
        self.conv1 = NormalizedConv(width, hidden)
        self.conv2 = NormalizedConv(hidden, hidden, KERNEL, groups=hidden)
        self.conv3 = NormalizedConv(hidden, width)

    def forward(self, x: Tensor) -> Tensor:
        inner = functional.gelu(self.conv2(functional.gelu(self.conv1(x))))
        return functional.gelu(x + self.conv3(inner))


class Downsampling(nn.Module):
    """To the channels of the next stage, and half the resolution where `stride` is 2."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = NormalizedConv(inputs, outputs)
        self.conv2 = NormalizedConv(outputs, outputs, KERNEL, stride, groups=outputs)
        self.conv3 = NormalizedConv(outputs, outputs)

    def forward(self, x: Tensor) -> Tensor:
        return self.conv3(functional.gelu(self.conv2(functional.gelu(self.conv1(x)))))


class WindowAttention(nn.Module):
    """Attention between the tokens of a window, with a learned bias for each distance between two of them."""

    def __init__(self, width: int, heads: int, window: int) -> None:
        super().__init__()
        self.heads, self.window = heads, window
        self.norm = nn.LayerNorm(width)
        self.qkv, self.proj = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.attention_biases = nn.Parameter(torch.zeros(heads, window * window))

    def forward(self, x: Tensor) -> Tensor:
        """(B, window * window, C) tokens, row by row."""
        windows, tokens, width = x.shape
        # Each head has its query, key and value side by side.
        parts = self.qkv(self.norm(x)).view(windows, tokens, self.heads, 3, width // self.heads)
        query, key, value = parts.permute(3, 0, 2, 1, 4)
        # By hand: PyTorch's own attention looks for rows without any key, which takes a quarter of its time here.
        odds = torch.baddbmm(
            self._find_biases().expand(windows, -1, -1, -1).flatten(0, 1),
            query.flatten(0, 1),
            key.flatten(0, 1).transpose(1, 2),
            alpha=(width // self.heads) ** -0.5,
        )
        attended = (odds.softmax(-1) @ value.flatten(0, 1)).view(windows, self.heads, tokens, -1)
        return self.proj(attended.transpose(1, 2).reshape(windows, tokens, width))

    def _find_biases(self) -> Tensor:
        """(heads, tokens, tokens): that of the rows and columns between two tokens."""
        steps = torch.arange(self.window, device=self.attention_biases.device)
        apart = (steps[:, None] - steps).abs()
        index = (apart[:, None, :, None] * self.window + apart[None, :, None, :]).reshape(self.window**2, -1)
        return self.attention_biases[:, index]


class Perceptron(nn.Module):
    """Layer normalization and two layers."""

    def __init__(self, width: int, hidden: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.fc1, self.fc2 = nn.Linear(width, hidden), nn.Linear(hidden, width)

    def forward(self, x: Tensor) -> Tensor:
        return self.fc2(functional.gelu(self.fc1(self.norm(x))))


class WindowBlock(nn.Module):
    """Attention in windows, a depthwise convolution, and a perceptron."""

    def __init__(self, width: int, heads: int, window: int, expansion: int) -> None:
        super().__init__()
        self.window = window
        self.attn = WindowAttention(width, heads, window)
        self.local_conv = NormalizedConv(width, width, KERNEL, groups=width)
        self.mlp = Perceptron(width, width * expansion)

    def forward(self, x: Tensor) -> Tensor:
        x = self.local_conv((x.permute(0, 2, 3, 1) + self._attend(x.permute(0, 2, 3, 1))).permute(0, 3, 1, 2))
        return x + self.mlp(x.permute(0, 2, 3, 1)).permute(0, 3, 1, 2)

    def _attend(self, x: Tensor) -> Tensor:
        """(B, H, W, C), padded by zeros to whole windows."""
        images, height, width, channels = x.shape
        side = self.window
        below, beside = -height % side, -width % side
        padded = functional.pad(x, (0, 0, 0, beside, 0, below))
        rows, columns = (height + below) // side, (width + beside) // side
        tokens = padded.view(images, rows, side, columns, side, channels).transpose(2, 3).reshape(-1, side * side, channels)
        attended = self.attn(tokens).view(images, rows, columns, side, side, channels).transpose(2, 3)
        return attended.reshape(images, height + below, width + beside, channels)[:, :height, :width]


class Stage(nn.Module):
    """Blocks, and the way to the next stage."""

    def __init__(self, blocks: Sequence[nn.Module], downsample: Downsampling | None) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(blocks)
        self.downsample = downsample

    def forward(self, x: Tensor) -> Tensor:
        for block in self.blocks:
            x = block(x)
        return x if self.downsample is None else self.downsample(x)


class ChannelNorm(nn.LayerNorm):
    """Layer normalization over the channels of (B, C, H, W)."""

    def __init__(self, width: int) -> None:
        super().__init__(width, eps=1e-6)

    def forward(self, x: Tensor) -> Tensor:
        return super().forward(x.permute(0, 2, 3, 1)).permute(0, 3, 1, 2)


class TinyVit(nn.Module):
    """The image encoder: (B, 3, H, W) normalized images to (B, C, H / 16, W / 16) features."""

    def __init__(self, settings: TinyVitSettings | None = None) -> None:
        super().__init__()
        sizes = settings or TinyVitSettings()
        self.patch_embed = PatchEmbedding(sizes.widths[0])
        stages = []
        for number, (width, depth) in enumerate(zip(sizes.widths, sizes.depths, strict=True)):
            if number == 0:
                blocks: list[nn.Module] = [InvertedBottleneck(width, sizes.expansion) for _ in range(depth)]
            else:
                blocks = [WindowBlock(width, sizes.heads[number], sizes.windows[number], sizes.expansion) for _ in range(depth)]
            last = number == len(sizes.widths) - 1
            stride = 1 if number == len(sizes.widths) - 2 else 2
            stages.append(Stage(blocks, None if last else Downsampling(width, sizes.widths[number + 1], stride)))
        self.layers = nn.ModuleList(stages)
        out = sizes.out_width
        self.neck = nn.Sequential(
            nn.Conv2d(sizes.widths[-1], out, 1, bias=False),
            ChannelNorm(out),
            nn.Conv2d(out, out, KERNEL, padding=1, bias=False),
            ChannelNorm(out),
        )

    def forward(self, x: Tensor) -> Tensor:
        x = self.patch_embed(x)
        for stage in self.layers:
            x = stage(x)
        return self.neck(x)

    def fuse(self) -> None:
        """Join batch normalizations with their convolutions, for inference."""
        for module in list(self.modules()):
            if isinstance(module, NormalizedConv):
                module.fuse()
