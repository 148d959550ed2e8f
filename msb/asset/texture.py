"""Textures of an asset: their storage, and their sampling in NumPy, which the OpenCL kernels must match."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from msb.asset.asset import Asset
from msb.asset.drawable import first_bad
from msb.errors import AssetError

Filter = Literal["linear", "nearest"]
Wrap = Literal["repeat", "clamp", "mirror"]
# `appearance.kind` of an asset with textures.
KIND = "texture"
# The pass (drawing step) of the standard tier for textures.
PASS = "opaque_unlit_texture"
# A sample is drawn if its alpha is at least the cutoff minus this tolerance. Rounding errors of the
# interpolation can reduce the alpha.
ROUNDING = 1e-6
NAME = re.compile(r"texture\.(0|[1-9][0-9]?)")
# Maximum number of texels along a side of a texture.
MAX_SIDE = 16_384
# Maximum number of textures of an asset. An asset has up to 64 buffers. Five buffers are positions, indices,
# colours, UVs and `face_texture`.
MAX_TEXTURES = 59
# Number of texels of a mip level that are computed at a time.
_ROWS = 1 << 22


@dataclass(frozen=True)
class Sampler:
    """How textures are sampled. All textures of an asset have the same sampler.

    Attributes
    ----------
    filter : {"linear", "nearest"}
        Interpolation between texels and between mip levels.
    mipmaps : bool
        Whether distant surfaces use smaller copies of the texture.
    wrap_u, wrap_v : {"repeat", "clamp", "mirror"}
        How the texture continues outside the range 0 to 1.
    alpha_cutoff : float, optional
        Samples with a smaller alpha are not drawn. If the value is None, alpha is ignored.
    """

    filter: Filter = "linear"
    mipmaps: bool = True
    wrap_u: Wrap = "repeat"
    wrap_v: Wrap = "repeat"
    alpha_cutoff: float | None = None

    @property
    def appearance(self) -> dict[str, Any]:
        """The `appearance` in the manifest of an asset that uses this sampler."""
        return {"kind": KIND, **asdict(self)}

    @classmethod
    def of(cls, appearance: Mapping[str, Any]) -> Sampler:
        """Return the sampler of a valid `appearance` in a manifest."""
        return cls(**{key: appearance[key] for key in cls.__dataclass_fields__})


# The allowed values for each key of a sampler.
CHOICES: dict[str, tuple[str, ...]] = {
    "filter": get_args(Filter),
    "wrap_u": get_args(Wrap),
    "wrap_v": get_args(Wrap),
}


@dataclass(frozen=True, eq=False)
class Textured:
    """The textures of an asset with F faces, in the form that renderers need.

    Attributes
    ----------
    images : tuple of (H, W, 3 | 4) uint8
        Images in sRGB. The fourth channel is alpha. Row 0 of an image is at v = 0.
    uvs : (F, 3, 2) float32
        Texture coordinates of each corner. The point (0, 0) is the outer corner of the first texel of row 0.
    face_texture : (F,) uint32, optional
        Index of the image of each face. The value is None for a single image.
    sampler : Sampler
    """

    images: tuple[NDArray[np.uint8], ...]
    uvs: NDArray[np.float32]
    face_texture: NDArray[np.uint32] | None
    sampler: Sampler


def is_textured(asset: Asset) -> bool:
    """Return whether `asset` has textures."""
    return bool(asset.manifest.appearance.get("kind") == KIND)


def textures_of(asset: Asset) -> Textured | None:
    """Return the textures of `asset`, or None if the asset has no textures.

    Raises
    ------
    AssetError
        `TRIASSET_VALUE_NONFINITE`: a texture coordinate is not finite. `TRIASSET_INDEX_OUT_OF_RANGE`: a face
        uses a texture that does not exist.
    """
    if not is_textured(asset):
        return None
    domain, sampler = asset.manifest.buffers["uv"].domain, Sampler.of(asset.manifest.appearance)
    return textures_in(asset.buffers, domain, sampler, asset.path)


def textures_in(
    buffers: Mapping[str, NDArray[Any]], domain: str, sampler: Sampler, path: Path | None = None
) -> Textured:
    """Return the textures in `buffers`.

    Raises the errors of `textures_of`. The argument `domain` is the domain of the buffer `uv`.
    """
    images = texture_images(buffers)
    uvs = buffers["uv"]
    if (at := first_bad(uvs)) is not None:
        row = at[0]
        text = f"buffer uv holds {uvs[row].tolist()} in row {row}; renderers need finite values"
        raise AssetError("TRIASSET_VALUE_NONFINITE", text, file=path, pointer=f"uv[{row}]")
    if domain == "vertex":
        uvs = uvs[buffers["indices"]]
    face_texture = buffers.get("face_texture")
    if face_texture is not None and int(face_texture.max()) >= len(images):
        face = int(np.argmax(face_texture >= len(images)))
        text = f"face {face} uses texture {face_texture[face]}, but there are {len(images)} textures"
        raise AssetError("TRIASSET_INDEX_OUT_OF_RANGE", text, file=path, pointer=f"face_texture[{face}]")
    return Textured(images, uvs.reshape(-1, 3, 2), face_texture, sampler)


def texture_images(buffers: Mapping[str, NDArray[Any]]) -> tuple[NDArray[np.uint8], ...]:
    """Return the textures among `buffers`, in their order."""
    names = [name for name in buffers if NAME.fullmatch(name)]
    return tuple(buffers[f"texture.{number}"] for number in range(len(names)))


def srgb_to_linear(values: NDArray[Any]) -> NDArray[Any]:
    """Return sRGB values in [0, 1] as linear light (IEC 61966-2-1), in the float type of the input."""
    low = values <= 0.04045
    light = np.where(low, values / 12.92, ((np.maximum(values, 0) + 0.055) / 1.055) ** 2.4)
    return light.astype(values.dtype)


def linear_to_srgb(values: NDArray[Any]) -> NDArray[Any]:
    """Return linear light in [0, 1] as sRGB values: the inverse of `srgb_to_linear`."""
    low = values <= 0.0031308
    srgb = np.where(low, values * 12.92, 1.055 * np.maximum(values, 0) ** (1 / 2.4) - 0.055)
    return srgb.astype(values.dtype)


# Linear light of the 256 sRGB byte values.
LINEAR = srgb_to_linear(np.arange(256) / 255).astype(np.float32)
LINEAR.flags.writeable = False


def decode_texels(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return texels (..., 3 | 4) as linear light and alpha (..., 4). The alpha of texels with 3 channels is
    1."""
    light = np.ones((*image.shape[:-1], 4), np.float32)
    light[..., :3] = LINEAR[image[..., :3]]
    if image.shape[-1] == 4:
        light[..., 3] = image[..., 3] / np.float32(255)
    return light


def encode_texels(values: NDArray[np.float32], channels: int) -> NDArray[np.uint8]:
    """Return linear light and alpha (..., 4) as texels of `channels` bytes (inverse of `decode_texels`)."""
    texels = np.concatenate((linear_to_srgb(values[..., :3]), values[..., 3:]), axis=-1)
    return np.asarray(np.rint(texels[..., :channels] * 255).astype(np.uint8))


def mip_levels(image: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    """Return `image` and its mip levels.

    Each level has half the size of the previous level, down to one texel. A texel is the average, in linear
    light, of 2 x 2 texels of the previous level. If a side has an odd length, a texel is the average of 3
    texels along this side. The average is rounded to bytes, like the texels that a GPU stores.
    """
    levels = [image]
    for size in level_sizes(*image.shape[:2])[1:]:
        levels.append(_halve(levels[-1], size))
    return levels


def levels_read(image: NDArray[np.uint8], sampler: Sampler) -> list[NDArray[np.uint8]]:
    """Return the mip levels of `image` that a sampler uses: all levels, or only the first level."""
    return mip_levels(image) if sampler.mipmaps else [image]


def level_sizes(height: int, width: int) -> list[tuple[int, int]]:
    """Return height and width of each mip level of an image, beginning with the largest."""
    sizes = [(height, width)]
    while max(sizes[-1]) > 1:
        sizes.append((max(1, sizes[-1][0] // 2), max(1, sizes[-1][1] // 2)))
    return sizes


def _halve(image: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return the next mip level of the given size.

    The level is computed in chunks, because floats need 16 times the memory of bytes.
    """
    height, width, channels = image.shape
    level = np.zeros((*size, channels), np.uint8)
    step = max(1, _ROWS // width)
    for start in range(0, len(level), step):
        rows = np.arange(start, min(start + step, len(level)))
        # Average along the columns, which gives (rows, width, 4). Then average along the rows, which gives
        # (rows, width of the level, 4).
        down = np.zeros((len(rows), width, 4), np.float32)
        for at, weight in _find_covered(height, len(level), rows):
            down += weight[:, None, None] * decode_texels(image[at])
        across = np.zeros((len(rows), level.shape[1], 4), np.float32)
        for at, weight in _find_covered(width, level.shape[1], np.arange(level.shape[1])):
            across += weight[:, None] * down[:, at]
        level[rows] = encode_texels(across, channels)
    return level


def _find_covered(
    size: int, half: int, rows: NDArray[np.intp]
) -> list[tuple[NDArray[np.intp], NDArray[np.float32]]]:
    """Return the old texels whose average gives the texels `rows` (n,) of the next mip level, along one axis.

    The axis has `size` texels in the current level, and `half` texels in the next level. The result has 1, 2
    or 3 pairs of texel indices (n,) and weights (n,).
    """
    if size == half:
        return [(rows, np.ones(len(rows), np.float32))]
    if size == 2 * half:
        shares: list[NDArray[Any]] = [np.full(len(rows), 0.5)] * 2
    else:
        # If the size is odd (2 half + 1), a new texel covers one old texel completely, and parts of two
        # neighbours.
        shares = [(half - rows) / size, np.full(len(rows), half / size), (rows + 1) / size]
    return [(2 * rows + offset, share.astype(np.float32)) for offset, share in enumerate(shares)]


def sample(
    levels: Sequence[NDArray[np.uint8]], uvs: NDArray[Any], sampler: Sampler, lod: NDArray[Any] | None = None
) -> NDArray[np.float32]:
    """Return linear light and alpha (N, 4) of a texture with mip `levels` at `uvs` (N, 2).

    `lod` (N,) is log2 of the number of texels per pixel in level 0. A missing, zero or negative `lod` selects
    level 0. If `lod` lies between two levels, both levels are blended.
    """
    if lod is None or not sampler.mipmaps or len(levels) == 1:
        return _sample_level(levels[0], uvs, sampler)
    lod = np.clip(lod, 0, len(levels) - 1).astype(np.float32)
    if sampler.filter == "nearest":
        lod = np.floor(lod + np.float32(0.5))
    light = np.zeros((len(uvs), 4), np.float32)
    for number, image in enumerate(levels):
        weight = np.maximum(1 - np.abs(lod - number), 0)
        rows = np.flatnonzero(weight)
        light[rows] += weight[rows, None] * _sample_level(image, uvs[rows], sampler)
    return light


def _sample_level(image: NDArray[np.uint8], uvs: NDArray[Any], sampler: Sampler) -> NDArray[np.float32]:
    """Return linear light and alpha (N, 4) of one level at `uvs` (N, 2)."""
    height, width = image.shape[:2]
    wraps = (sampler.wrap_u, width), (sampler.wrap_v, height)
    place = uvs.astype(np.float64) * (width, height)
    if sampler.filter == "nearest":
        x, y = (wrap_texels(np.floor(place[:, axis]), *wraps[axis]) for axis in (0, 1))
        return decode_texels(image[y, x])
    # Bilinear interpolation of the four nearest texel centres.
    low = np.floor(place - 0.5)
    fraction = (place - 0.5 - low).astype(np.float32)
    light = np.zeros((len(uvs), 4), np.float32)
    for right in (0, 1):
        for below in (0, 1):
            x, y = (wrap_texels(low[:, axis] + step, *wraps[axis]) for axis, step in ((0, right), (1, below)))
            weight = np.abs(1 - right - fraction[:, 0]) * np.abs(1 - below - fraction[:, 1])
            light += weight[:, None] * decode_texels(image[y, x])
    return light


def wrap_texels(texels: NDArray[Any], wrap: Wrap, size: int) -> NDArray[np.intp]:
    """Return indices of texels wrapped into the range 0 to `size` - 1."""
    if wrap == "clamp":
        inside = np.clip(texels, 0, size - 1)
    elif wrap == "repeat":
        inside = np.mod(texels, size)
    else:
        around = np.mod(texels, 2 * size)
        inside = np.minimum(around, 2 * size - 1 - around)
    return np.asarray(inside.astype(np.intp))
