"""The loss: L1 and D-SSIM, as in the 3DGS family."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import torch

SHARE = 0.2
"""Share of D-SSIM in the loss."""
_RADIUS, _SIGMA = 5, 1.5
_C1, _C2 = 0.01**2, 0.03**2


class Photograph:
    """A target image (H, W, 3)."""

    def __init__(self, image: torch.Tensor) -> None:
        self.image = image

    @cached_property
    def planes(self) -> torch.Tensor:
        """The image as (3, H, W)."""
        return self.image.permute(2, 0, 1).contiguous()

    @cached_property
    def moments(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Local means and variances, (3, H, W)."""
        mean, square = _Blurred.apply(torch.cat([self.planes, self.planes**2])).split(3)
        return mean, square - mean * mean


def l1(image: torch.Tensor, photograph: Photograph) -> torch.Tensor:
    """Return the mean absolute difference."""
    return (image - photograph.image).abs().mean()


def dssim(image: torch.Tensor, photograph: Photograph) -> torch.Tensor:
    """Return 1 - SSIM of images (H, W, 3): an 11 x 11 Gaussian window, zero padding."""
    planes = image.permute(2, 0, 1)
    mu_b, variance_b = photograph.moments
    stacked = torch.cat([planes, planes * planes, planes * photograph.planes])
    mu_a, aa, ab = _Blurred.apply(stacked).split(3)
    means, squares = mu_a * mu_b, mu_a * mu_a
    top = (2 * means + _C1) * (2 * (ab - means) + _C2)
    bottom = (squares + mu_b * mu_b + _C1) * (aa - squares + variance_b + _C2)
    return 1 - (top / bottom).mean()


def photometric(image: torch.Tensor, photograph: Photograph) -> torch.Tensor:
    """Return (1 - SHARE) L1 + SHARE (1 - SSIM)."""
    return (1 - SHARE) * l1(image, photograph) + SHARE * dssim(image, photograph)


class _Blurred(torch.autograd.Function):
    """Blur planes (C, H, W) with the window. The window is symmetric, so the derivative is the same blur."""

    @staticmethod
    def forward(ctx: Any, planes: torch.Tensor) -> torch.Tensor:
        return _blur(planes)

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> torch.Tensor:
        return _blur(grad)


def _blur(planes: torch.Tensor) -> torch.Tensor:
    offsets = torch.arange(_RADIUS + 1, dtype=torch.float64)
    weights = torch.exp(-(offsets**2) / (2 * _SIGMA**2))
    window = (weights / (2 * weights.sum() - weights[0])).tolist()
    for axis in (1, 2):
        size = planes.shape[axis]
        found = planes * window[0]
        for offset, weight in enumerate(window[1:size], start=1):
            for first, second in ((offset, 0), (0, offset)):
                to = found.narrow(axis, first, size - offset)
                to.add_(planes.narrow(axis, second, size - offset), alpha=weight)
        planes = found
    return planes
