"""Structural similarity (SSIM; Wang et al. 2004; 11 px, sigma 1.5 px) and its gradient.

In plain PyTorch, SSIM took half of the loss's time. The gradient of the mean similarity by the image x, with target t and
Gaussian window G, is

    G * (dS/dmu_x) + 2 x (G * dS/ds_xx) + t (G * dS/ds_xt),   s_xx = G * x^2,  s_xt = G * x t,

so three more blurs give it exactly. On the CPU, kernels do all of it; on a device, PyTorch.
"""

from typing import Any

import numba
import numpy as np
import torch
import torch.nn.functional as F


def gaussian_window() -> torch.Tensor:
    """(11,) normalized Gaussian of the structural similarity."""
    window = torch.exp(-(torch.arange(-5.0, 6.0) ** 2) / (2 * 1.5**2))
    return window / window.sum()


def blur(images: torch.Tensor, window: torch.Tensor) -> torch.Tensor:
    count = len(images)
    kernel = window.to(images)
    half = len(kernel) // 2
    # cuDNN would compute in TF32, whose ten bits the variances, differences of nearly equal numbers, do not survive.
    with torch.backends.cudnn.flags(enabled=False):
        rows = F.conv2d(images[None], kernel.expand(count, 1, 1, -1), padding=(0, half), groups=count)
        return F.conv2d(rows, kernel[:, None].expand(count, 1, -1, 1), padding=(half, 0), groups=count)[0]


def similarity_of(
    mean_i: torch.Tensor, square_i: torch.Tensor, product: torch.Tensor, mean_t: torch.Tensor, square_t: torch.Tensor
) -> torch.Tensor:
    """Similarity of each pixel, from the blurs of image, its square, the product with the target, the target and its square."""
    variance_i, variance_t = square_i - mean_i * mean_i, square_t - mean_t * mean_t
    covariance = product - mean_i * mean_t
    c1, c2 = 0.01**2, 0.03**2
    return (2 * mean_i * mean_t + c1) * (2 * covariance + c2) / ((mean_i**2 + mean_t**2 + c1) * (variance_i + variance_t + c2))


_WINDOW = gaussian_window().numpy()
_HALF = len(_WINDOW) // 2
_C1, _C2 = np.float32(0.01**2), np.float32(0.03**2)
_ONE, _TWO = np.float32(1.0), np.float32(2.0)


# Without fast mathematics: a kernel that was compiled now fuses other products and sums than one that was loaded.
@numba.njit(cache=True, parallel=True, error_model="numpy")
def _blur(images, window, scratch, out):
    """Blur (K, H, W) images with zeros outside; scratch and out have the same shape."""
    count, height, width = images.shape
    # No slices: they take three more seconds to compile. Loops of known length lie within the loop over x: each pixel's sum stays in a
    # register, and pixels fill vector instructions.
    for line in numba.prange(count * height):
        k, y = line // height, line % height
        padded = np.zeros(width + 2 * _HALF, np.float32)
        for x in range(width):
            padded[_HALF + x] = images[k, y, x]
        for x in range(width):
            total = np.float32(0.0)
            for t in range(2 * _HALF + 1):
                total += window[t] * padded[x + t]
            scratch[k, y, x] = total
    for line in numba.prange(count * height):
        k, y = line // height, line % height
        if _HALF <= y < height - _HALF:
            for x in range(width):
                total = np.float32(0.0)
                for t in range(2 * _HALF + 1):
                    total += window[t] * scratch[k, y + t - _HALF, x]
                out[k, y, x] = total
        else:
            for x in range(width):
                out[k, y, x] = 0.0
            for t in range(max(0, _HALF - y), min(len(window), height + _HALF - y)):
                for x in range(width):
                    out[k, y, x] += window[t] * scratch[k, y + t - _HALF, x]


# Without the reordering of sums and divisions: the compiler would order the last pixels of a row otherwise than the vectors before
# them, and otherwise in a kernel that was compiled now than in one that was loaded.
@numba.njit(cache=True, parallel=True, error_model="numpy", fastmath={"contract", "nsz"})
def _similarity(blurred, target_mean, target_square, weight, partials, similarities):
    """Weighted similarity of each pixel, and its weighted derivatives by the three blurred maps of the image."""
    channels, height, width = target_mean.shape
    for line in numba.prange(channels * height):
        c, y = line // height, line % height
        for x in range(width):
            mi, si, p = blurred[c, y, x], blurred[channels + c, y, x], blurred[2 * channels + c, y, x]
            mt, st, w = target_mean[c, y, x], target_square[c, y, x], weight[y, x]
            n1, n2 = _TWO * mi * mt + _C1, _TWO * (p - mi * mt) + _C2
            d1, d2 = mi * mi + mt * mt + _C1, (si - mi * mi) + (st - mt * mt) + _C2
            per_d1, per_d2 = _ONE / d1, _ONE / d2
            both = per_d1 * per_d2
            s = n1 * n2 * both
            similarities[c, y, x] = w * s
            partials[c, y, x] = w * _TWO * (mt * (n2 - n1) * both - s * mi * (per_d1 - per_d2))
            partials[channels + c, y, x] = -w * s * per_d2
            partials[2 * channels + c, y, x] = w * _TWO * n1 * both


class _Dissimilarity(torch.autograd.Function):
    @staticmethod
    def forward(context: Any, image: torch.Tensor, target: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
        x, t, w = image.detach().contiguous().numpy(), target.numpy(), weight.numpy()
        channels = len(x)
        # The target's own blurs are cheap beside the rest, and keeping them would tie this function to its caller's views.
        maps = np.concatenate([x, x * x, x * t, t, t * t])
        scratch, blurred = np.empty_like(maps), np.empty_like(maps)
        _blur(maps, _WINDOW, scratch, blurred)
        partials, similarities = np.empty_like(maps[: 3 * channels]), np.empty_like(x)
        _similarity(blurred, blurred[3 * channels : 4 * channels], blurred[4 * channels :], w, partials, similarities)
        context.kept = (x, t, partials, scratch, blurred)
        return image.new_tensor(channels * float(w.sum(dtype=np.float64)) - float(similarities.sum(dtype=np.float64)))

    @staticmethod
    def backward(context: Any, gradient: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        x, t, partials, scratch, blurred = context.kept
        channels = len(x)
        _blur(partials, _WINDOW, scratch[: 3 * channels], blurred[: 3 * channels])
        by_mean, by_square, by_product = np.split(blurred[: 3 * channels], 3)
        return torch.from_numpy(-float(gradient) * (by_mean + _TWO * x * by_square + t * by_product)), None, None


class DeviceDissimilarity(torch.autograd.Function):
    """`dssim` in PyTorch, on any device. Its gradient is made of blurs, too: a convolution's own might add in any order."""

    @staticmethod
    def forward(context: Any, image: torch.Tensor, target: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
        x, channels, window = image.detach(), len(image), gaussian_window()
        blurred = blur(torch.cat([x, x * x, x * target, target, target * target]), window)
        with torch.enable_grad():
            by_image = blurred[: 3 * channels].requires_grad_()
            total = ((1 - similarity_of(*by_image.split(channels), *blurred[3 * channels :].split(channels))) * weight).sum()
            (partials,) = torch.autograd.grad(total, by_image)
        context.kept = (x, target, partials, window)
        return total.detach()

    @staticmethod
    def backward(context: Any, gradient: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        x, target, partials, window = context.kept
        by_mean, by_square, by_product = blur(partials, window).split(len(x))
        return gradient * (by_mean + 2 * x * by_square + target * by_product), None, None


def dssim(image: torch.Tensor, target: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """Sum of weight * (1 - SSIM) over (C, H, W) images in [0, 1]; weight: (H, W) float32. Only `image` gets a gradient."""
    return (_Dissimilarity if image.is_cpu else DeviceDissimilarity).apply(image, target, weight)
