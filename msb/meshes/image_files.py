"""Textures as image files."""

import re
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import Sampler
from msb.meshes.formats import Picture, Style
from msb.meshes.mesh import Mesh

# How little is lost: what it costs in bytes is less than what blocks and bled colours cost in dB.
_OPTIONS: dict[Picture, dict[str, Any]] = {
    "png": {},
    "jpeg": {"quality": 95, "subsampling": 0},
    "webp": {"quality": 90, "method": 6, "exact": True},
}


ENDINGS: dict[Picture, str] = {"png": ".png", "jpeg": ".jpg", "webp": ".webp"}


def image_names(mesh: Mesh, style: Style) -> list[str]:
    """Return what the images of a mesh are called: after the style's stem, of many by number."""
    several, stem = len(mesh.textures) > 1, plain_stem(style)
    kinds = [_kind(image, style.texture, mesh.sampler) for image in mesh.textures]
    numbers = [f"_{number}" if several else "" for number in range(len(kinds))]
    return [f"{stem}{number}{ENDINGS[kind]}" for number, kind in zip(numbers, kinds, strict=True)]


def images_of(mesh: Mesh, style: Style) -> dict[str, bytes]:
    """Return the images of a mesh as files, by these names."""
    contents = (packed(image, style.texture, mesh.sampler)[0] for image in mesh.textures)
    return dict(zip(image_names(mesh, style), contents, strict=True))


def plain_stem(style: Style) -> str:
    """Return what files beside a mesh file are called; what a line of text cannot hold is replaced."""
    return re.sub(r"[^\w.()+-]", "_", style.stem or "texture")


def packed(image: NDArray[np.uint8], kind: Picture, sampler: Sampler) -> tuple[bytes, Picture]:
    """Return an image file of `image` (H, W, 3 | 4), and its kind: PNG where JPEG would lose alpha.

    PNG keeps all of an image; WebP keeps alpha only where the sampler looks at it.
    """
    from PIL import Image

    kind = _kind(image, kind, sampler)
    if kind != "png" and not _is_cut_out(image, sampler):
        image = image[..., :3]
    file = BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(file, kind, **_OPTIONS[kind])
    return file.getvalue(), kind


def _kind(image: NDArray[np.uint8], kind: Picture, sampler: Sampler) -> Picture:
    return "png" if kind == "jpeg" and _is_cut_out(image, sampler) else kind


def _is_cut_out(image: NDArray[np.uint8], sampler: Sampler) -> bool:
    return image.shape[-1] == 4 and sampler.alpha_cutoff is not None
