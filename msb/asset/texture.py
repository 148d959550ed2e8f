"""Textures of an asset: what is stored, and how it is sampled; the readable twin of what kernels do."""

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
# The pass of the standard tier that draws them.
PASS = "opaque_unlit_texture"
# How much below the cut-off alpha is still drawn: what interpolating equal alphas may round away.
ROUNDING = 1e-6
NAME = re.compile(r"texture\.(0|[1-9][0-9]?)")
# The most texels along a side of a texture.
MAX_SIDE = 16_384
# The most textures of an asset, whose 64 buffers also hold positions, indices, colours, coordinates and
# `face_texture`.
MAX_TEXTURES = 59
# Texels of a mip level that are made together.
_ROWS = 1 << 22


@dataclass(frozen=True)
class Sampler:
    """How textures are read: one for all textures of an asset.

    Attributes
    ----------
    filter : {"linear", "nearest"}
        Between texels, and between the levels of mip maps.
    mipmaps : bool
        Whether distant surfaces read smaller copies of the texture.
    wrap_u, wrap_v : {"repeat", "clamp", "mirror"}
        What lies beyond 0 to 1.
    alpha_cutoff : float, optional
        Where alpha is below it there is no surface; None: alpha is not looked at.
    """

    filter: Filter = "linear"
    mipmaps: bool = True
    wrap_u: Wrap = "repeat"
    wrap_v: Wrap = "repeat"
    alpha_cutoff: float | None = None

    @property
    def appearance(self) -> dict[str, Any]:
        """The manifest's `appearance` of an asset with this sampler."""
        return {"kind": KIND, **asdict(self)}

    @classmethod
    def of(cls, appearance: Mapping[str, Any]) -> Sampler:
        """Return the sampler that a manifest's `appearance`, found free of errors, describes."""
        return cls(**{key: appearance[key] for key in cls.__dataclass_fields__})


# Key of a sampler -> the words it takes.
CHOICES: dict[str, tuple[str, ...]] = {
    "filter": get_args(Filter),
    "wrap_u": get_args(Wrap),
    "wrap_v": get_args(Wrap),
}


@dataclass(frozen=True, eq=False)
class Textured:
    """The textures of an asset of F faces, as a renderer needs them.

    Attributes
    ----------
    images : tuple of (H, W, 3 | 4) uint8
        sRGB; the fourth channel is alpha. Row 0 is v = 0.
    uvs : (F, 3, 2) float32
        Of each corner; (0, 0) is the outer corner of the first texel of row 0.
    face_texture : (F,) uint32, optional
        Which image a face shows; None: the only one.
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
    """Return the textures of `asset`, None if it has none.

    Raises
    ------
    AssetError
        TRIASSET_VALUE_NONFINITE or TRIASSET_INDEX_OUT_OF_RANGE: a texture coordinate is not finite, or a face
        shows a texture that is not there.
    """
    if not is_textured(asset):
        return None
    domain, sampler = asset.manifest.buffers["uv"].domain, Sampler.of(asset.manifest.appearance)
    return textures_in(asset.buffers, domain, sampler, asset.path)


def textures_in(
    buffers: Mapping[str, NDArray[Any]], domain: str, sampler: Sampler, path: Path | None = None
) -> Textured:
    """Return the textures that `buffers` hold, with the errors of `textures_of`; `domain` is that of `uv`."""
    images = texture_images(buffers)
    uvs = buffers["uv"]
    if (at := first_bad(uvs)) is not None:
        row = at[0]
        text = f"buffer uv holds {uvs[row].tolist()} in row {row}; a renderer needs finite values"
        raise AssetError("TRIASSET_VALUE_NONFINITE", text, file=path, pointer=f"uv[{row}]")
    if domain == "vertex":
        uvs = uvs[buffers["indices"]]
    shown = buffers.get("face_texture")
    if shown is not None and int(shown.max()) >= len(images):
        face = int(np.argmax(shown >= len(images)))
        text = f"face {face} shows texture {shown[face]}, but there are {len(images)}"
        raise AssetError("TRIASSET_INDEX_OUT_OF_RANGE", text, file=path, pointer=f"face_texture[{face}]")
    return Textured(images, uvs.reshape(-1, 3, 2), shown, sampler)


def texture_images(buffers: Mapping[str, NDArray[Any]]) -> tuple[NDArray[np.uint8], ...]:
    """Return the textures among `buffers`, in their order."""
    names = [name for name in buffers if NAME.fullmatch(name)]
    return tuple(buffers[f"texture.{number}"] for number in range(len(names)))


def srgb_to_linear(values: NDArray[Any]) -> NDArray[Any]:
    """Return sRGB values in [0, 1] as linear light (IEC 61966-2-1), in the float type given."""
    low = values <= 0.04045
    made = np.where(low, values / 12.92, ((np.maximum(values, 0) + 0.055) / 1.055) ** 2.4)
    return made.astype(values.dtype)


def linear_to_srgb(values: NDArray[Any]) -> NDArray[Any]:
    """Return linear light in [0, 1] as sRGB values: the inverse of `srgb_to_linear`."""
    low = values <= 0.0031308
    made = np.where(low, values * 12.92, 1.055 * np.maximum(values, 0) ** (1 / 2.4) - 0.055)
    return made.astype(values.dtype)


# The linear light of each byte of sRGB.
LINEAR = srgb_to_linear(np.arange(256) / 255).astype(np.float32)
LINEAR.flags.writeable = False


def decoded(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return texels (..., 3 | 4) as linear light and alpha (..., 4), which is 1 where there is none."""
    made = np.ones((*image.shape[:-1], 4), np.float32)
    made[..., :3] = LINEAR[image[..., :3]]
    if image.shape[-1] == 4:
        made[..., 3] = image[..., 3] / np.float32(255)
    return made


def encoded(values: NDArray[np.float32], channels: int) -> NDArray[np.uint8]:
    """Return linear light and alpha (..., 4) as texels of `channels` bytes: the inverse of `decoded`."""
    made = np.concatenate((linear_to_srgb(values[..., :3]), values[..., 3:]), axis=-1)
    return np.asarray(np.rint(made[..., :channels] * 255).astype(np.uint8))


def mip_levels(image: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    """Return `image` and its smaller copies, each half as large, down to one texel.

    A texel is the mean, in linear light, of those it covers of the level before (of 3 where a side is odd),
    rounded to bytes as a graphics card stores it.
    """
    levels = [image]
    for size in level_sizes(*image.shape[:2])[1:]:
        levels.append(_halved(levels[-1], size))
    return levels


def levels_read(image: NDArray[np.uint8], sampler: Sampler) -> list[NDArray[np.uint8]]:
    """Return the levels of `image` that a sampler reads: one, or with mip maps all `mip_levels`."""
    return mip_levels(image) if sampler.mipmaps else [image]


def level_sizes(height: int, width: int) -> list[tuple[int, int]]:
    """Return height and width of each mip level of an image, the largest first."""
    sizes = [(height, width)]
    while max(sizes[-1]) > 1:
        sizes.append((max(1, sizes[-1][0] // 2), max(1, sizes[-1][1] // 2)))
    return sizes


def _halved(image: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return the next mip level, made in pieces: in floats a level takes sixteen times as much memory."""
    height, width, channels = image.shape
    made = np.zeros((*size, channels), np.uint8)
    step = max(1, _ROWS // width)
    for start in range(0, len(made), step):
        rows = np.arange(start, min(start + step, len(made)))
        down = np.zeros((len(rows), width, 4), np.float32)
        for at, weight in _covered(height, len(made), rows):
            down += weight[:, None, None] * decoded(image[at])
        across = np.zeros((len(rows), made.shape[1], 4), np.float32)
        for at, weight in _covered(width, made.shape[1], np.arange(made.shape[1])):
            across += weight[:, None] * down[:, at]
        made[rows] = encoded(across, channels)
    return made


def _covered(
    size: int, half: int, rows: NDArray[np.intp]
) -> list[tuple[NDArray[np.intp], NDArray[np.float32]]]:
    """Return which of `size` texels each of `rows` of `half` texels covers, with their weights."""
    if size == half:
        return [(rows, np.ones(len(rows), np.float32))]
    if size == 2 * half:
        shares: list[NDArray[Any]] = [np.full(len(rows), 0.5)] * 2
    else:  # size is 2 half + 1: the middle one of three lies inside whole, the outer ones in part
        shares = [(half - rows) / size, np.full(len(rows), half / size), (rows + 1) / size]
    return [(2 * rows + offset, share.astype(np.float32)) for offset, share in enumerate(shares)]


def sample(
    levels: Sequence[NDArray[np.uint8]], uvs: NDArray[Any], sampler: Sampler, lod: NDArray[Any] | None = None
) -> NDArray[np.float32]:
    """Return the linear light and alpha (N, 4) that `levels` of a texture show at `uvs` (N, 2).

    `lod` (N,) is log2 of the texels of level 0 that a pixel covers; without it, and where it is at most 0,
    level 0 is read. Between two levels the result is blended by the fraction of `lod`.
    """
    if lod is None or not sampler.mipmaps or len(levels) == 1:
        return _texels(levels[0], uvs, sampler)
    lod = np.clip(lod, 0, len(levels) - 1).astype(np.float32)
    if sampler.filter == "nearest":
        lod = np.floor(lod + np.float32(0.5))
    made = np.zeros((len(uvs), 4), np.float32)
    for number, image in enumerate(levels):
        share = np.maximum(1 - np.abs(lod - number), 0)
        seen = np.flatnonzero(share)
        made[seen] += share[seen, None] * _texels(image, uvs[seen], sampler)
    return made


def _texels(image: NDArray[np.uint8], uvs: NDArray[Any], sampler: Sampler) -> NDArray[np.float32]:
    """Return what one level shows at `uvs` (N, 2)."""
    height, width = image.shape[:2]
    wraps = (sampler.wrap_u, width), (sampler.wrap_v, height)
    place = uvs.astype(np.float64) * (width, height)
    if sampler.filter == "nearest":
        x, y = (wrapped(np.floor(place[:, axis]), *wraps[axis]) for axis in (0, 1))
        return decoded(image[y, x])
    low = np.floor(place - 0.5)
    share = (place - 0.5 - low).astype(np.float32)
    made = np.zeros((len(uvs), 4), np.float32)
    for right in (0, 1):
        for below in (0, 1):
            x, y = (wrapped(low[:, axis] + step, *wraps[axis]) for axis, step in ((0, right), (1, below)))
            weight = np.abs(1 - right - share[:, 0]) * np.abs(1 - below - share[:, 1])
            made += weight[:, None] * decoded(image[y, x])
    return made


def wrapped(texels: NDArray[Any], wrap: Wrap, size: int) -> NDArray[np.intp]:
    """Return whole numbers of texels, which may lie outside of 0 to `size` - 1, as those that are read."""
    if wrap == "clamp":
        inside = np.clip(texels, 0, size - 1)
    elif wrap == "repeat":
        inside = np.mod(texels, size)
    else:
        around = np.mod(texels, 2 * size)
        inside = np.minimum(around, 2 * size - 1 - around)
    return np.asarray(inside.astype(np.intp))
