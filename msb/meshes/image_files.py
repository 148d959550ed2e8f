"""Encodes textures as image files."""

import re
from collections.abc import Iterable
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import Sampler
from msb.meshes.formats import Picture, Style
from msb.meshes.mesh import Mesh

# Pillow's encoder options. The qualities of JPEG and WebP are high. Lower qualities would save space, but
# cause block artefacts and colour bleeding.
_OPTIONS: dict[Picture, dict[str, Any]] = {
    "png": {},
    "jpeg": {"quality": 95, "subsampling": 0},
    "webp": {"quality": 90, "method": 6, "exact": True},
}
ENDINGS: dict[Picture, str] = {"png": ".png", "jpeg": ".jpg", "webp": ".webp"}


def name_images(mesh: Mesh, style: Style) -> list[str]:
    """Return the file names of a mesh's images. A name is the style's stem, with a number if there are
    several images."""
    several, stem = len(mesh.textures) > 1, simplify_stem(style)
    kinds = [_choose_kind(image, style.texture, mesh.sampler) for image in mesh.textures]
    numbers = [f"_{number}" if several else "" for number in range(len(kinds))]
    return [f"{stem}{number}{ENDINGS[kind]}" for number, kind in zip(numbers, kinds, strict=True)]


def encode_images(mesh: Mesh, style: Style, numbers: Iterable[int]) -> dict[str, bytes]:
    """Return the encoded images of the textures with the indices `numbers`, as a mapping from file name to
    content."""
    names = name_images(mesh, style)
    return {
        names[number]: encode_image(mesh.textures[number], style.texture, mesh.sampler)[0]
        for number in sorted(numbers)
    }


def is_single_texel(image: NDArray[np.uint8], mesh: Mesh) -> bool:
    """Return whether a texture of `mesh` consists of a single opaque texel.

    A material colour can replace a texture with a single texel.
    """
    is_opaque = image.shape[2] == 3 or mesh.sampler.alpha_cutoff is None or image[0, 0, 3] == 255
    return image.shape[:2] == (1, 1) and bool(is_opaque)


def describe_counts(images: int, colors: int) -> list[str]:
    """Return texts with the numbers of images and of material colours. Zero numbers are omitted."""
    counts = {"texture": images, "material colour": colors}
    return [f"{count} {noun}{'' if count == 1 else 's'}" for noun, count in counts.items() if count]


def simplify_stem(style: Style) -> str:
    """Return the style's stem with "_" in place of characters that OBJ and MTL cannot store."""
    return re.sub(r"[^\w.()+-]", "_", style.stem or "texture")


def encode_image(image: NDArray[np.uint8], kind: Picture, sampler: Sampler) -> tuple[bytes, Picture]:
    """Return `image` (H, W, 3 | 4) as the bytes of an image file. Also return the format of the file.

    The format is PNG if JPEG would lose alpha. PNG keeps all channels. JPEG and WebP drop alpha if the
    sampler has no alpha cut-off.
    """
    from PIL import Image

    kind = _choose_kind(image, kind, sampler)
    if kind != "png" and not _is_cut_out(image, sampler):
        image = image[..., :3]
    file = BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(file, kind, **_OPTIONS[kind])
    return file.getvalue(), kind


def _choose_kind(image: NDArray[np.uint8], kind: Picture, sampler: Sampler) -> Picture:
    return "png" if kind == "jpeg" and _is_cut_out(image, sampler) else kind


def _is_cut_out(image: NDArray[np.uint8], sampler: Sampler) -> bool:
    return image.shape[-1] == 4 and sampler.alpha_cutoff is not None
