"""LPIPS of images mapped to [-1, 1], with VGG16 weights from the user.

Torch is imported at its first use.

This module defines the network itself instead of using the network of the lpips package. The lpips package
downloads a backbone or fills 138 million parameters with random numbers. Importing lpips also needs
torchvision. Only the linear layers come from the lpips package.
"""

from __future__ import annotations

import os
import warnings
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msb.base.files import regular_file
from msb.errors import Finding, MetricError, finding
from msb.metrics.identity import Identity, ImageMetric
from msb.metrics.images import check_pair
from msb.metrics.vgg import HEADS_SHA256, LAYERS, TAPS, check_extra, read_heads, read_vgg

# Smallest side of an image in pixels. The network halves the image four times, so smaller images are
# impossible.
MIN_SIDE = 16
_SHIFT = (-0.030, -0.088, -0.188)
_SCALE = (0.458, 0.448, 0.450)
# Indices of the convolutions that follow a 2 x 2 max pooling layer.
_POOLED = {5, 10, 17, 24}


class MetricWarning(UserWarning):
    """A warning that a value is correct but not comparable with published values."""


def lpips_vgg(
    pred: ArrayLike, gt: ArrayLike, vgg_weights: str | os.PathLike[str], *, quantize: bool = True
) -> float:
    """Return LPIPS (version 0.1, VGG16, inputs mapped to [-1, 1]) of two images. For equal images, it is 0.

    The network stays in memory for further calls with the same weight file. Use `LpipsVgg` to load and
    release the network explicitly.

    Parameters
    ----------
    pred, gt : (H, W, 3) uint8 or float
        Images as for `psnr`, with sides of at least 16 pixels.
    vgg_weights : path-like
        torchvision's vgg16-397923af.pth; see `read_vgg` for other forms.
    quantize : bool
        As for `psnr`.

    Returns
    -------
    float
        LPIPS, which is not negative, in float32 precision.

    Warns
    -----
    MetricWarning
        The weights are not the published weights (METRIC_VGG_UNKNOWN).

    Raises
    ------
    UsageError
        EXTRA_MISSING: torch or lpips is not installed.
    InputError
        FILE_NOT_FOUND or FILE_UNREADABLE.
    MetricError
        METRIC_WEIGHTS, METRIC_IMAGE, METRIC_SIZES_DIFFER.

    Notes
    -----
    Zhang et al., The Unreasonable Effectiveness of Deep Features as a Perceptual Metric, 2018;
    `richzhang/PerceptualSimilarity`: lpips/lpips.py, lpips/pretrained_networks.py.
    """
    check_extra()
    place = regular_file(vgg_weights)
    status = place.stat()
    network = _load_cached(str(place.resolve()), status.st_mtime_ns, status.st_size)
    for warning in network.warnings:
        warnings.warn(f"{warning.code}: {place}: {warning.message}", MetricWarning, stacklevel=2)
    return network(pred, gt, quantize=quantize)


@lru_cache(maxsize=1)
def _load_cached(path: str, _changed: int, _size: int) -> LpipsVgg:
    return LpipsVgg(path)


class LpipsVgg:
    """LPIPS with one set of weights, loaded once: ``LpipsVgg(path)(pred, gt)``.

    `weights` stores names and hashes of the weight files. `warnings` contains METRIC_VGG_UNKNOWN if the
    weights are not the published weights.
    """

    def __init__(self, vgg_weights: str | os.PathLike[str]) -> None:
        check_extra()
        import torch

        tensors, record = read_vgg(Path(vgg_weights))
        heads, heads_sha256 = read_heads()
        known = "lpips 0.1.4" if heads_sha256 == HEADS_SHA256 else None
        about = {"file": "weights/v0.1/vgg.pth", "sha256": heads_sha256, "known": known}
        self.weights: dict[str, Any] = {"vgg": record, "heads": about}
        self.warnings: tuple[Finding, ...] = ()
        if record["known"] is None:
            text = f"its sha256 {record['sha256'][:16]}... differs from the sha256 of vgg16-397923af.pth"
            self.warnings = (finding("METRIC_VGG_UNKNOWN", text, severity="warning"),)
        self._layers: list[tuple[int, Any, Any]] = [
            (number, torch.from_numpy(tensors[f"{name}.weight"]), torch.from_numpy(tensors[f"{name}.bias"]))
            for number, name in ((n, f"features.{n}") for n, _, _ in LAYERS)
        ]
        self._heads = [torch.from_numpy(head) for head in heads]

    def identity(self, *, quantize: bool = True) -> Identity:
        """Return the data that are stored beside values of this network."""
        return LPIPS.identity(weights=self.weights, quantize=quantize)

    def __call__(self, pred: ArrayLike, gt: ArrayLike, *, quantize: bool = True) -> float:
        return float(sum(self.per_layer(pred, gt, quantize=quantize)))

    def per_layer(self, pred: ArrayLike, gt: ArrayLike, *, quantize: bool = True) -> list[float]:
        """Return the five terms that LPIPS adds up, from relu1_2 to relu5_3."""
        import torch
        from torch.nn import functional

        a, b = check_pair(pred, gt, quantize=quantize)
        if min(a.shape[:2]) < MIN_SIDE:
            text = f"LPIPS needs at least {MIN_SIDE} pixels per side, not {a.shape[1]} x {a.shape[0]}"
            raise MetricError("METRIC_IMAGE", text)
        terms = []
        with torch.inference_mode():
            # Pass both images through one layer of the network at a time. Therefore only two feature maps are
            # in memory at a time.
            x, y = (torch.from_numpy(_prepare_input(image)) for image in (a, b))
            heads = iter(self._heads)
            for number, weight, bias in self._layers:
                if number in _POOLED:
                    x, y = functional.max_pool2d(x, 2), functional.max_pool2d(y, 2)
                x = functional.conv2d(x, weight, bias, padding=1).relu_()
                y = functional.conv2d(y, weight, bias, padding=1).relu_()
                if number in TAPS:
                    terms.append(_measure_distance(x, y, next(heads)))
        return terms


def _prepare_input(image: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return an image in [0, 1] as (1, 3, H, W): mapped to [-1, 1], then shifted and scaled."""
    centred = image.astype(np.float32) * np.float32(2) - np.float32(1)
    scaled = (centred - np.array(_SHIFT, np.float32)) / np.array(_SCALE, np.float32)
    return np.ascontiguousarray(np.moveaxis(scaled, 2, 0)[None], np.float32)


def _measure_distance(x: Any, y: Any, head: Any) -> float:
    """Return the weighted squared difference between unit feature vectors, averaged over pixels."""
    x, y = (f / (f.square().sum(1, keepdim=True).sqrt_() + 1e-10) for f in (x, y))
    difference = (x - y).square_()
    return float((difference[0].mean((1, 2)) * head).sum())


LPIPS = ImageMetric(
    name="lpips_vgg",
    key="lpips",
    title="LPIPS",
    unit="1",
    decimals=3,
    better="lower",
    equal=0.0,
    load=LpipsVgg,
    parameters={
        "lpips_version": "0.1",
        "network": "vgg16",
        "input_range": "[-1, 1]",
        "spatial": "mean",
        "precision": "float32",
    },
    libraries=("numpy", "torch", "lpips"),
)
