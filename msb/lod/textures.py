"""Smaller textures for levels of detail, in the format of the original image."""

from __future__ import annotations

import math
from io import BytesIO
from typing import Any

import numpy as np

from msb.errors import MeshFileError
from msb.meshes.images import Decoder

# Smallest side of a texture that is made smaller.
_MIN_SIDE = 16
# Pillow's encoder options.
_OPTIONS: dict[str, dict[str, Any]] = {
    "png": {},
    "jpeg": {"quality": 92, "subsampling": 0},
    "webp": {"quality": 90, "method": 4},
}
_SIGNATURES = {b"\x89PNG": "png", b"\xff\xd8": "jpeg", b"RIFF": "webp"}


def choose_factor(share: float) -> float:
    """Return the factor of the sides of textures of a level with this share of the faces: 1, 1/2, 1/4, ...

    The number of texels follows the number of faces, rounded to whole halvings of the sides, because programs
    scale textures to powers of two.
    """
    return float(2.0 ** round(math.log2(max(share, 1e-6)) / 2))


def find_kind(data: bytes | memoryview) -> str | None:
    """Return "png", "jpeg" or "webp" by the first bytes of an image file, or None."""
    head = bytes(data[:4])
    return next((kind for start, kind in _SIGNATURES.items() if head.startswith(start)), None)


def shrink(data: bytes | memoryview, factor: float, *, is_normal: bool) -> tuple[bytes, tuple[int, int]]:
    """Return an image file with sides times `factor`, and its width and height in texels.

    The texels of a normal map keep unit length. An image of another format, or one that cannot be decoded, is
    returned unchanged, with size (0, 0).
    """
    from PIL import Image

    kind = find_kind(data)
    try:
        texels = Decoder().decode(data, alpha=True) if kind else None
    except MeshFileError:
        texels = None
    if texels is None or kind is None:
        return bytes(data), (0, 0)
    height, width = texels.shape[:2]
    size = (max(1, round(width * factor)), max(1, round(height * factor)))
    if factor >= 1 or min(size) < _MIN_SIDE:
        return bytes(data), (width, height)
    # BOX averages all texels that a new texel covers. Colours under zero alpha keep their weight.
    layers = [
        Image.fromarray(texels[..., k]).resize(size, Image.Resampling.BOX) for k in range(texels.shape[2])
    ]
    small = np.stack([np.asarray(layer) for layer in layers], axis=2)
    if is_normal:
        vectors = small[..., :3].astype(np.float64) / 127.5 - 1
        vectors /= np.maximum(np.linalg.norm(vectors, axis=2, keepdims=True), 1e-6)
        small[..., :3] = np.clip(np.rint((vectors + 1) * 127.5), 0, 255)
    file = BytesIO()
    Image.fromarray(small).save(file, kind, **_OPTIONS[kind])
    return file.getvalue(), size
