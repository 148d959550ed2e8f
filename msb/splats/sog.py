"""Read Gaussians from PlayCanvas' SOG format, versions 1 and 2: meta.json and lossless images.

Layout: playcanvas/splat-transform at 8d6b801 (readers/read-sog.ts, read-sog-v1.ts). Pixel i of an image
belongs to Gaussian i.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.errors import CheckpointError, shorten
from msb.splats.gaussians import DEGREES, Gaussians, Reals, check_count, damaged, expand_quaternions, to_logit

# Function that returns the texels (H, W, 3 | 4) of a named file.
ReadImage = Callable[[str], NDArray[np.uint8]]
# Number of palette entries in a row of the image with SH coefficients.
_ENTRIES_PER_ROW = 64
# The fourth byte of a quaternion is 252 plus the index of the omitted component.
_LARGEST_TAG = 252


def read(meta: Any, read_image: ReadImage) -> Gaussians:
    """Return the Gaussians of a SOG model. `meta` is the parsed meta.json.

    Raises
    ------
    CheckpointError
        CHECKPOINT_LAYOUT: a value of meta.json is missing or invalid. CHECKPOINT_DAMAGED: an image is too
        small, or its content is invalid.
    """
    model = _Model(meta, read_image)
    lower, upper = model.texels("means", 0)[:, :3], model.texels("means", 1)[:, :3]
    share = (lower.astype(np.int64) | upper.astype(np.int64) << 8) / 65535
    drawn = model.between("means", share)
    with np.errstate(over="ignore"):
        mean = np.sign(drawn) * np.expm1(np.abs(drawn))
        scale = model.values("scales", model.texels("scales")[:, :3])
        base = model.texels("sh0", width=4)
        f_dc = model.values("sh0", base[:, :3])
        if model.version == 1:  # version 1 stores the logit of the opacity
            opacity = model.between("sh0", base / 255)[:, 3].astype(np.float32)
        else:
            opacity = to_logit(base[:, 3] / 255)
        rest = model.rest()
        return Gaussians(
            mean=mean.astype(np.float32),
            scale=scale.astype(np.float32),
            rotation=_decode_rotations(model.texels("quats", width=4)),
            opacity=opacity,
            f_dc=f_dc.astype(np.float32),
            f_rest=None if rest is None else rest.astype(np.float32),
            antialiased=_read_antialiased(model.meta),
        )


class _Model:
    """A parsed meta.json with checks, and its images as rows of texels."""

    def __init__(self, meta: Any, read_image: ReadImage) -> None:
        if not isinstance(meta, dict):
            raise CheckpointError("CHECKPOINT_LAYOUT", "meta.json must be an object")
        self.meta, self._read_image = meta, read_image
        self.version = meta.get("version", 1)
        if self.version not in (1, 2):
            text = f"version {shorten(str(self.version), 40)} of SOG is not supported; 1 and 2 are supported"
            raise CheckpointError("CHECKPOINT_FORM", text, pointer="version")
        shape = self.part("means").get("shape") if self.version == 1 else [meta.get("count")]
        count = shape[0] if isinstance(shape, list) and shape else None
        if type(count) is not int or count > 1 << 32:
            text = f"the number of Gaussians in meta.json is {shorten(str(count), 40)}"
            raise CheckpointError("CHECKPOINT_LAYOUT", text, pointer="count")
        check_count(count)
        self.count = count

    def part(self, name: str) -> Mapping[str, Any]:
        """Return the object `name` of meta.json."""
        part = self.meta.get(name)
        if not isinstance(part, dict):
            raise CheckpointError("CHECKPOINT_LAYOUT", f'meta.json has no object "{name}"', pointer=name)
        return part

    def image(self, name: str, number: int, width: int = 3) -> NDArray[np.uint8]:
        """Return the image with the index `number` in a part: texels (H, W, at least `width`)."""
        files = self.part(name).get("files")
        if not isinstance(files, list) or len(files) <= number or not isinstance(files[number], str):
            text = f'"files" of "{name}" in meta.json must have {number + 1} names of files'
            raise CheckpointError("CHECKPOINT_LAYOUT", text, pointer=f"{name}/files")
        texels = self._read_image(files[number])
        if texels.shape[2] < width:  # the image has no alpha channel, so it is opaque
            opaque = np.full((*texels.shape[:2], 1), 255, np.uint8)
            texels = np.concatenate([texels, opaque], axis=2)
        return texels

    def texels(self, name: str, number: int = 0, width: int = 3) -> NDArray[np.uint8]:
        """Return the texels (N, channels) of the Gaussians in an image."""
        image = self.image(name, number, width)
        texels = image.reshape(-1, image.shape[2])
        if len(texels) < self.count:
            raise damaged(f'an image of "{name}" has {len(texels)} texels for {self.count} Gaussians')
        return texels[: self.count]

    def numbers(self, name: str, key: str, count: int) -> Reals:
        """Return the array `key` of a part of meta.json. A single stored number is repeated `count` times."""
        stored = self.part(name).get(key)
        values: list[Any] = stored if isinstance(stored, list) else [stored] * count
        if len(values) < count or not all(type(v) in (int, float) and abs(v) < 1e300 for v in values):
            text = f'"{key}" of "{name}" in meta.json must have {count} finite numbers'
            raise CheckpointError("CHECKPOINT_LAYOUT", text, pointer=f"{name}/{key}")
        return np.array(values, np.float64)

    def between(self, name: str, shares: Reals) -> Reals:
        """Interpolate between "mins" and "maxs" of a part; `shares` (..., channels) are fractions in [0,
        1]."""
        channels = shares.shape[-1]
        low, high = (self.numbers(name, key, channels)[:channels] for key in ("mins", "maxs"))
        return low + (high - low) * shares

    def values(self, name: str, bytes_: NDArray[np.uint8]) -> Reals:
        """Decode bytes. Version 2 uses a codebook, and version 1 interpolates between two bounds."""
        if self.version == 1:
            return self.between(name, bytes_ / 255)
        values: Reals = self.numbers(name, "codebook", 256)[bytes_]
        return values

    def rest(self) -> Reals | None:
        """Return f_rest (N, K, 3), or None without SH. Each Gaussian stores the index of its palette
        entry."""
        if "shN" not in self.meta:
            return None
        palette = self.image("shN", 0)[:, :, :3]
        # Each row of the palette image contains 64 entries, and each entry has K texels.
        coefficients = palette.shape[1] // _ENTRIES_PER_ROW
        if coefficients * _ENTRIES_PER_ROW != palette.shape[1] or coefficients not in DEGREES:
            raise damaged(f"the palette of SH is {palette.shape[1]} texels wide; expected 192, 512 or 960")
        if not coefficients:
            return None
        entries = palette.reshape(-1, coefficients, 3)
        texels = self.texels("shN", 1).astype(np.int64)
        label = texels[:, 0] | texels[:, 1] << 8
        if label.max() >= len(entries):
            raise damaged(
                f"a Gaussian uses entry {label.max()} of the palette of SH, which has {len(entries)}"
            )
        rest: Reals = self.values("shN", entries)[label]
        return rest


def _read_antialiased(meta: Mapping[str, Any]) -> bool | None:
    """Return the value of "model", or of "antialias" in older files; None if the file has neither."""
    if "model" in meta:
        return bool(meta["model"] == "antialiased")
    return True if meta.get("antialias") is True else None


def _decode_rotations(texels: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return quaternions (N, 4) w, x, y, z from three bytes and the index of the omitted component."""
    largest = texels[:, 3].astype(np.int64) - _LARGEST_TAG
    rotation = expand_quaternions(np.maximum(largest, 0), (texels[:, :3] / 255 * 2 - 1) * np.sqrt(0.5))
    rotation[largest < 0] = (1, 0, 0, 0)
    return rotation.astype(np.float32)
