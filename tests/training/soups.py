"""Small scenes without what has no derivative: no pixel on an edge, no weight near a threshold."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from msb.scenes import Camera

CAMERA = Camera.look_at((0.1, -0.2, -4), (0, 0, 0), up=(0, -1, 0), width=20, height=14, fov_y=0.7)
BACKGROUND = np.array([0.2, 0.5, 0.9])


def triangles(count: int, seed: int, size: float = 0.8) -> np.ndarray:
    """Return triangles (count, 3, 3) around the origin."""
    random = np.random.default_rng(seed)
    return random.uniform(-0.8, 0.8, (count, 1, 3)) + random.normal(0, size, (count, 3, 3))


def soup(names: tuple[str, str, str, str], count: int = 5, seed: int = 0) -> dict[str, np.ndarray]:
    """Return parameters with places, opacity logits and SH of degree 2."""
    random = np.random.default_rng(seed + 100)
    parts = (
        triangles(count, seed),
        random.uniform(-1.0, 0.5, (count, 1)),
        random.normal(0.3, 0.6, (count, 1, 3)),
        random.normal(0, 0.2, (count, 8, 3)),
    )
    return dict(zip(names, parts, strict=True))


def tensors(values: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return fresh tensors that ask for derivatives."""
    return {name: torch.from_numpy(value.copy()).requires_grad_() for name, value in values.items()}
