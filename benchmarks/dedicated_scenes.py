"""Models as large as those of real captures, for the benchmark of the dedicated tier.

Faces are scattered around three surfaces at the depths 3, 6 and 12. Their sizes have a log-normal
distribution. The median size falls with the square root of the number of faces. It is about 3 pixels for a
million faces in an image of 1237 x 822 pixels. Opacities have a U-shaped beta distribution; most faces are
nearly opaque. The degree of spherical harmonics is 3.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import msb
from data_stubs.made_models import TRAINED
from msb.registry import METHODS

BLENDED = tuple(name for name in TRAINED if METHODS[name].native.alpha_compositing)  # type: ignore[union-attr]
"""Methods whose triangles are sorted and blended, with spherical harmonics."""
SIZES = ((620, 411), (1237, 822))
_FOCAL = 1160 / 1237
"""Focal length as a share of the image's width."""


def is_connected(method: str) -> bool:
    """Return whether faces of `method` share vertices."""
    native = METHODS[method].native
    return native is not None and native.connectivity


def camera(width: int, height: int) -> Any:
    """Return the camera of all models. It stands at the origin and looks along z."""
    return msb.Camera(width, height, _FOCAL * width, _FOCAL * width, width / 2, height / 2, np.eye(4))


def soup(faces: int, seed: int = 0) -> dict[str, Any]:
    """Return positions (F, 3, 3), opacities and SH coefficients of free triangles."""
    random = np.random.default_rng(seed)
    # The model is 1.5 times as wide as the image. Much of the model is therefore outside the image, as in a
    # capture.
    x = random.uniform(-0.8, 0.8, faces)
    y = random.uniform(-0.55, 0.55, faces)
    layer = random.choice([3.0, 6.0, 12.0], faces, p=[0.35, 0.35, 0.3])
    z = layer * (1 + 0.15 * np.sin(5 * x + layer) * np.cos(4 * y)) + 0.05 * random.standard_normal(faces)
    radius = 3 * np.sqrt(1e6 / faces) / 1160 * np.exp(0.8 * random.standard_normal(faces)) * z
    center = np.stack([x * z, y * z, z], axis=1)
    corners = random.standard_normal((faces, 3, 3)) * np.array([1, 1, 0.5])
    corners -= corners.mean(axis=1, keepdims=True)
    positions = center[:, None] + corners * radius[:, None, None]
    opacity = np.clip(random.beta(1.2, 0.5, faces), 1e-3, 1 - 1e-4)
    return {
        "positions": positions.reshape(-1, 3).astype(np.float32),
        "indices": np.arange(3 * faces, dtype=np.uint32).reshape(-1, 3),
        "opacity": np.log(opacity / (1 - opacity)).astype(np.float32),
        "f_dc": random.normal(0, 0.8, (faces, 3)).astype(np.float32),
        "f_rest": random.normal(0, 0.1, (faces, 45)).astype(np.float32),
    }


def grid_mesh(faces: int, seed: int = 0) -> dict[str, Any]:
    """Return three layers of bumpy grids with shared vertices, like a model of MeshSplatting."""
    random = np.random.default_rng(seed)
    side = max(2, round((faces / 6) ** 0.5))
    u, v = np.meshgrid(np.linspace(-0.8, 0.8, side + 1), np.linspace(-0.55, 0.55, side + 1))
    cell = np.arange(side)[:, None] * (side + 1) + np.arange(side)
    quads = np.stack([cell, cell + 1, cell + side + 2, cell + side + 1], axis=-1).reshape(-1, 4)
    positions, indices = [], []
    for number, depth in enumerate((3.0, 6.0, 12.0)):
        z = depth * (1 + 0.15 * np.sin(5 * u + depth) * np.cos(4 * v))
        z = z + 0.002 * depth * random.standard_normal(z.shape)
        positions.append(np.stack([u * z, v * z, z], axis=-1).reshape(-1, 3))
        # A third of each nearer layer consists of holes. Through these holes the next layer is visible.
        kept = quads if depth == 12.0 else quads[np.sin(40 * quads[:, 0] / side) > -0.5]
        indices.append(np.concatenate([kept[:, :3], kept[:, [0, 2, 3]]]) + number * (side + 1) ** 2)
    vertices = 3 * (side + 1) ** 2
    return {
        "positions": np.concatenate(positions).astype(np.float32),
        "indices": np.ascontiguousarray(np.concatenate(indices), np.uint32),
        "opacity": np.full(vertices, 4.0, np.float32),
        "f_dc": random.normal(0, 0.8, (vertices, 3)).astype(np.float32),
        "f_rest": random.normal(0, 0.1, (vertices, 45)).astype(np.float32),
    }


def model(method: str, faces: int) -> msb.Asset:
    """Return an asset of `method` with about this number of faces."""
    return asset_of(method, grid_mesh(faces) if is_connected(method) else soup(faces))


def asset_of(method: str, buffers: dict[str, Any], soft: float = 0.15) -> msb.Asset:
    """Return an asset of `method` with the data that `soup` or `grid_mesh` returns.

    `soft` is the mean logarithm of the exponents of edges in Triangle-Splatting. With 0, edges fall off
    linearly.
    """
    from msb.asset.build import Description, build_asset

    kernel: dict[str, Any] = {"kernel": METHODS[method].coverage}
    if kernel["kernel"] == "incentre_window":
        faces = len(buffers["indices"])
        sigma = np.exp(soft + 0.5 * np.random.default_rng(1).standard_normal(faces))
        buffers["sigma"] = np.log(sigma).astype(np.float32)
        kernel |= {"sigma_encoding": "exp", "sigma_offset": 0.01}
    description = Description(
        method=method,
        sh_degree=3,
        coverage=kernel,
        opacity={"encoding": "logit"},
        appearance={"kind": "spherical_harmonics", "f_rest_order": "coefficient_major"},
        compositing={"kind": "front_to_back"},
    )
    domain = "vertex" if is_connected(method) else "face"
    domains: dict[str, Any] = dict.fromkeys(buffers.keys() - {"positions", "indices"}, domain)
    return build_asset(buffers, domains, description)


def capture(method: str, faces: int) -> msb.Asset:
    """Return the model of a method with its faces in random order."""
    asset = model(method, faces)
    if not is_connected(method):  # soups are random already
        return asset
    shuffled = np.random.default_rng(0).permutation(asset.buffers["indices"])
    return replace(asset, buffers={**asset.buffers, "indices": shuffled})


def psnr(
    image: NDArray[np.float32], official: NDArray[np.float32], stable: Any = None, *, quantize: bool = True
) -> float:
    """Return the PSNR in dB of two images. They are clamped to [0, 1] as on a screen."""
    first, second = np.clip(image, 0, 1), np.clip(official, 0, 1)
    if stable is not None:
        first, second = first[stable][None], second[stable][None]
    return msb.metrics.psnr(first, second, quantize=quantize)
