"""Check an asset completely and report all errors, while `load` stops at the first error."""

import hashlib
import math
import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.asset import Asset
from msb.asset.build import CHUNK_ROWS, as_bytes, first_shared, measure_bounds
from msb.asset.container import Container, open_container
from msb.asset.reader import map_buffers, read_manifest
from msb.asset.texture import is_textured, texture_images
from msb.errors import AssetError, Finding, InputError, error_finding, finding, one_line

# Cross products of coordinates up to this magnitude do not overflow float32 (3.4e38).
MAGNITUDE_LIMIT = 1e18
# Number of findings that are printed.
SHOWN = 50
# The bounds may differ by this value, relative to the size of the bounding box. Other programs may round the
# bounds to float32.
BOUNDS_TOLERANCE = 1e-5


@dataclass(frozen=True)
class Validation:
    """The findings about an asset, and the asset itself if it could be opened.

    Attributes
    ----------
    path : Path
    findings : tuple of Finding
        Each finding has a `code`, a `severity` ("error", "warning" or "info") and a `message`.
    asset : Asset, optional
    """

    path: Path
    findings: tuple[Finding, ...]
    asset: Asset | None = field(repr=False)

    @property
    def valid(self) -> bool:
        """True if no finding is an error."""
        return all(item.severity != "error" for item in self.findings)

    @property
    def title(self) -> str:
        """The path, the result and the number of findings, as one line."""
        counts = Counter(item.severity for item in self.findings)
        parts = [f"{count} {name}{'s' if count != 1 else ''}" for name, count in counts.items()]
        word = "valid" if self.valid else "invalid"
        return f"{one_line(str(self.path))}: {word}, {', '.join(parts) or 'no findings'}"

    def __str__(self) -> str:
        lines = [f"  {item.severity} {item.code}: {item.message}" for item in self.findings[:SHOWN]]
        more = len(self.findings) - SHOWN
        return "\n".join([self.title, *lines, *([f"  ... and {more:,} more"] if more > 0 else [])])


def validate(path: str | os.PathLike[str]) -> Validation:
    """Check the asset at `path` completely, including values and hashes.

    The time is proportional to the size of the asset. Buffers are read in chunks, so that memory use is
    constant.
    """
    try:
        container = open_container(path)
        findings, manifest = read_manifest(container.manifest_bytes(), container)
    except InputError:
        raise
    except AssetError as error:
        return Validation(Path(path), (error_finding(error),), None)
    if manifest is None:
        return Validation(container.path, tuple(findings), None)
    asset = Asset(manifest, map_buffers(manifest, container), container.path, opened_from=container.path)
    findings += _check_bytes(asset, container)
    findings += check_values(asset)
    return Validation(container.path, tuple(findings), asset)


def _check_bytes(asset: Asset, container: Container) -> Iterator[Finding]:
    """Yield findings about checksums of the container and hashes of the buffers."""
    yield from container.check_bytes()
    for name, spec in asset.manifest.buffers.items():
        digest = hashlib.sha256(as_bytes(asset.buffers[name])).hexdigest()
        if digest != spec.sha256:
            text = f"buffer {name} has SHA-256 {digest[:16]}..., but {spec.sha256[:16]}... in the manifest"
            pointer = f"/buffers/{name}/sha256"
            yield finding("TRIASSET_DAMAGED", text, pointer=pointer, value=digest, limit=spec.sha256)


def check_values(asset: Asset) -> list[Finding]:
    """Return findings about values that are not finite, are out of range, or contradict the manifest."""
    findings: list[Finding] = []
    for name, array in asset.buffers.items():
        if array.dtype.kind == "f":
            findings += _check_finite(name, array)
    if not any(f.code == "TRIASSET_VALUE_NONFINITE" and f.pointer == "positions" for f in findings):
        findings += _check_positions(asset)
    findings += _check_indices(asset)
    if is_textured(asset):
        findings += _check_texturing(asset)
    if "color" in asset.buffers and asset.buffers["color"].dtype.kind == "f":
        findings += _check_color(asset.buffers["color"])
    return findings


def _check_finite(name: str, array: NDArray[np.float32]) -> Iterator[Finding]:
    # An infinite logit is an opacity of exactly 0 or 1. The official code writes such logits (mesh_splatting:
    # 1.2).
    bad = np.isnan if name == "opacity" else lambda values: ~np.isfinite(values)
    # Flatten the array, because a single row can be as large as the file.
    count, first = _count(array.reshape(-1), bad)
    if count:
        text = f"buffer {name} contains {count} values that are not finite, "
        text += f"the first at element {first}: {array.reshape(-1)[first]}"
        yield finding("TRIASSET_VALUE_NONFINITE", text, pointer=name, value=count, limit=0)


def _check_positions(asset: Asset) -> Iterator[Finding]:
    # Compare the stored bounding box with the measured box.
    positions, manifest = asset.buffers["positions"], asset.manifest
    bounds, sphere = measure_bounds(positions)
    low, high = np.array(bounds.min), np.array(bounds.max)
    slack = BOUNDS_TOLERANCE * max(float((high - low).max()), float(np.abs([low, high]).max()) * 1e-2)
    for key, measured in (("min", low), ("max", high)):
        stated = np.array(getattr(manifest.bounds, key))
        if np.abs(stated - measured).max() > slack:
            values = stated.tolist(), measured.tolist()
            text = f"bounds.{key} is {values[0]}, but the positions give {values[1]}"
            where: dict[str, Any] = {"pointer": f"/bounds/{key}", "value": values[0], "limit": values[1]}
            yield finding("TRIASSET_BOUNDS", text, **where)
    # The bounding sphere must contain all vertices, and should not be much larger than necessary.
    center, radius = np.array(manifest.bounding_sphere.center), manifest.bounding_sphere.radius

    def outside(rows: NDArray[np.float32]) -> NDArray[np.bool_]:
        with np.errstate(over="ignore"):  # The centre may have coordinates of up to 1e300.
            squared = np.square(rows.astype(np.float64) - center).sum(axis=1)
        return np.asarray(np.sqrt(squared) > radius + slack)

    count, first = _count(positions, outside)
    if count:
        text = f"{count} vertices are outside the bounding sphere, the first is {first}"
        yield finding("TRIASSET_BOUNDS", text, pointer="/bounding_sphere", value=count, limit=0)
    enough = sphere.radius + math.dist(manifest.bounding_sphere.center, sphere.center)
    if radius > 2 * enough + slack:
        text = f"the bounding sphere has radius {radius:g}, but {enough:g} is enough for all vertices"
        where = {"pointer": "/bounding_sphere/radius", "value": radius, "limit": enough}
        yield finding("TRIASSET_BOUNDS", text, severity="warning", **where)
    largest = max(abs(value) for value in (*bounds.min, *bounds.max))
    if largest > MAGNITUDE_LIMIT:
        text = f"a coordinate is {largest:g}; above {MAGNITUDE_LIMIT:g} areas overflow float32"
        where = {"pointer": "positions", "value": largest, "limit": MAGNITUDE_LIMIT}
        yield finding("TRIASSET_VALUE_RANGE", text, severity="warning", **where)


def _check_indices(asset: Asset) -> Iterator[Finding]:
    indices, vertices = asset.buffers["indices"], asset.manifest.vertex_count
    count, first = _count(indices, lambda rows: rows >= vertices)
    if count:
        face, corner = divmod(first, 3)
        value = int(indices[face, corner])
        text = f"{count} indices are out of range, the first is {value} in face {face}; "
        text += f"there are {vertices} vertices"
        where: dict[str, Any] = {"pointer": f"indices[{face}, {corner}]", "value": value}
        yield finding("TRIASSET_INDEX_OUT_OF_RANGE", text, **where, limit=vertices - 1)
    if asset.manifest.topology == "triangle_soup" and (at := first_shared(indices)) is not None:
        value = int(indices.reshape(-1)[at])
        text = f"index {at} of the triangle soup is {value}; it must be {at}"
        where = {"pointer": f"indices[{at // 3}, {at % 3}]", "value": value, "limit": at}
        yield finding("TRIASSET_VALUE_RANGE", text, **where)


def _check_texturing(asset: Asset) -> Iterator[Finding]:
    textures = len(texture_images(asset.buffers))
    count, first = _count(asset.buffers["uv"], lambda rows: (rows < 0) | (rows > 1))
    if count:
        appearance = asset.manifest.appearance
        text = f"{count} values of uv are outside 0 to 1, the first in row {first // 2}; there the texture "
        text += f"continues with wrap_u {appearance['wrap_u']} and wrap_v {appearance['wrap_v']}"
        yield finding("TRIASSET_VALUE_RANGE", text, severity="info", pointer="uv", value=count)
    if textures > 1:
        numbers = asset.buffers["face_texture"]
        count, first = _count(numbers, lambda rows: rows >= textures)
        if count:
            text = f"{count} faces use a texture that does not exist, the first is face {first} with texture "
            text += f"{numbers[first]}; there are {textures} textures"
            where: dict[str, Any] = {"pointer": f"face_texture[{first}]", "value": int(numbers[first])}
            yield finding("TRIASSET_INDEX_OUT_OF_RANGE", text, **where, limit=textures - 1)


def _check_color(color: NDArray[np.float32]) -> Iterator[Finding]:
    count, first = _count(color, lambda rows: (rows < 0) | (rows > 1))
    if count:
        text = f"{count} values of color are outside 0 to 1, the first is {color.reshape(-1)[first]:g} "
        text += f"at element {first}; they are clamped"
        yield finding("TRIASSET_VALUE_RANGE", text, severity="warning", pointer="color", value=count)


def _count(array: NDArray[Any], test: Any) -> tuple[int, int]:
    """Count the elements for which `test` is true.

    Also return the index of the first of these elements, or -1. The argument `test` takes a chunk of `array`
    and returns a mask. If the mask has one value per row, count rows instead.
    """
    total, first = 0, -1
    for start in range(0, len(array), CHUNK_ROWS):
        bad = test(array[start : start + CHUNK_ROWS])
        hits = int(np.count_nonzero(bad))
        if hits and first < 0:
            per_row = bad.size // len(bad)
            first = start * per_row + int(np.argmax(bad.reshape(-1)))
        total += hits
    return total, first
