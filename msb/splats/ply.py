"""Read Gaussians from PLY tables: 3DGS, 2DGS and their exporters, and SuperSplat's compressed PLY.

Layouts: graphdeco-inria/gaussian-splatting (scene/gaussian_model.py, save_ply), hbb1/2d-gaussian-splatting
(the same file, but with two scales), playcanvas/splat-transform at 8d6b801 (readers/decompress-ply.ts).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from msb.errors import CheckpointError
from msb.splats.gaussians import (
    DEGREES,
    Gaussians,
    Reals,
    check_count,
    damaged,
    expand_quaternions,
    to_f_dc,
    to_logit,
)

PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
# Property of Mip-Splatting: the standard deviation of the filter that is added to each Gaussian.
_FILTER = "filter_3D"
# Number of rows in a chunk of a compressed PLY. Each chunk stores its bounds.
_CHUNK_ROWS = 256
# A compressed PLY stores f_rest as bytes for values from -4 to 4.
_REST_RANGE = 8.0


class Table(Protocol):
    """An element of a PLY file: `count` rows with the properties `names`."""

    @property
    def count(self) -> int: ...
    @property
    def names(self) -> tuple[str, ...]: ...
    def columns(self, names: Sequence[str]) -> NDArray[np.float32]: ...
    def column(self, name: str) -> NDArray[Any]: ...


def holds_gaussians(names: Sequence[str]) -> bool:
    """Return whether a PLY without faces and with these vertex properties contains Gaussians."""
    return "rot_0" in names or set(PACKED) <= set(names)


def holds_discs(names: Sequence[str]) -> bool:
    """Return whether a PLY with these vertex properties contains the flat Gaussians of 2DGS."""
    return "rot_0" in names and "scale_1" in names and "scale_2" not in names


def read(tables: Mapping[str, Table], comments: Sequence[str] = ()) -> Gaussians:
    """Return the Gaussians of the elements of a PLY file, by name. `comments` are the comments in the PLY
    header.

    Raises
    ------
    CheckpointError
        CHECKPOINT_LAYOUT: a property is missing. CHECKPOINT_DAMAGED: PLY elements contradict each other.
    """
    vertex = tables.get("vertex")
    check_count(0 if vertex is None else vertex.count)
    assert vertex is not None
    if PACKED[0] in vertex.names:
        return _read_packed(vertex, tables)
    scales = [f"scale_{k}" for k in range(2 if holds_discs(vertex.names) else 3)]
    gaussians = Gaussians(
        mean=_columns(vertex, ["x", "y", "z"]),
        scale=_columns(vertex, scales),
        rotation=_columns(vertex, [f"rot_{k}" for k in range(4)]),
        opacity=_columns(vertex, ["opacity"])[:, 0],
        f_dc=_read_base_color(vertex),
        f_rest=_read_rest(vertex),
        antialiased=_read_antialiased(comments),
    )
    return _apply_filter(gaussians, vertex) if _FILTER in vertex.names else gaussians


def _apply_filter(gaussians: Gaussians, table: Table) -> Gaussians:
    """Apply the 3D filter of Mip-Splatting, which makes each Gaussian larger and less opaque.

    Source: autonomousvision/mip-splatting (scene/gaussian_model.py, get_opacity_with_3D_filter).
    """
    variance = np.exp(2 * gaussians.scale.astype(np.float64))
    filtered = variance + np.square(_columns(table, [_FILTER]).astype(np.float64))
    factor = np.sqrt(variance.prod(axis=1) / filtered.prod(axis=1))
    with np.errstate(over="ignore"):
        opacity = factor / (1 + np.exp(-gaussians.opacity.astype(np.float64)))
    return replace(
        gaussians,
        scale=(np.log(filtered) / 2).astype(np.float32),
        opacity=to_logit(opacity),
        antialiased=True,
    )


def _columns(table: Table, names: Sequence[str]) -> NDArray[np.float32]:
    if missing := [name for name in names if name not in table.names]:
        text = f"the property {missing[0]} of the Gaussians is missing; the file has "
        raise CheckpointError("CHECKPOINT_LAYOUT", text + ", ".join(table.names[:16]), pointer=missing[0])
    return table.columns(names)


def _read_base_color(table: Table) -> NDArray[np.float32]:
    """Return f_dc; some exporters of models without SH write the bytes red, green and blue instead."""
    if "f_dc_0" not in table.names and "red" in table.names:
        return to_f_dc(_columns(table, ["red", "green", "blue"]).astype(np.float64) / 255)
    return _columns(table, [f"f_dc_{k}" for k in range(3)])


def _read_rest(table: Table) -> NDArray[np.float32] | None:
    """Return f_rest (N, K, 3). Files store all coefficients of red, then of green, then of blue."""
    count = sum(name.startswith("f_rest_") for name in table.names)
    if count % 3 or count // 3 not in DEGREES:
        valid = ", ".join(str(3 * number) for number in DEGREES)
        text = f"the file has {count} properties f_rest; the SH degrees 0 to 4 need {valid} properties"
        raise CheckpointError("CHECKPOINT_LAYOUT", text, pointer="f_rest_0")
    if not count:
        return None
    flat = _columns(table, [f"f_rest_{k}" for k in range(count)])
    return np.ascontiguousarray(flat.reshape(len(flat), 3, -1).transpose(0, 2, 1))


def _read_antialiased(comments: Sequence[str]) -> bool | None:
    """Return the antialiasing mode from the comments of Brush (SplatRenderMode) or Postshot (antialiased)."""
    for line in comments:
        match line.lower().split():
            case ["splatrendermode:", mode]:
                return mode == "mip"
            case ["antialiased", value]:
                return value == "1"
    return None


def _read_packed(vertex: Table, tables: Mapping[str, Table]) -> Gaussians:
    """Return the Gaussians of a compressed PLY, which stores bits relative to the bounds of each chunk of
    256 rows."""
    chunks = tables.get("chunk")
    if chunks is None or chunks.count < -(-vertex.count // _CHUNK_ROWS):
        text = f"the file has {0 if chunks is None else chunks.count} chunks for {vertex.count} Gaussians; "
        raise damaged(f"{text}one chunk is needed for {_CHUNK_ROWS} Gaussians")
    number = np.arange(vertex.count) // _CHUNK_ROWS

    def between(what: str, axes: str, shares: Reals) -> Reals:
        """Interpolate between the bounds of each chunk; `shares` (N, 3) are fractions in [0, 1]."""
        low, high = (
            _columns(chunks, [f"{end}_{what}{axis}" for axis in axes]).astype(np.float64)[number]
            for end in ("min", "max")
        )
        return low * (1 - shares) + high * shares

    position, rotation, scale, color = (_words(vertex, name) for name in PACKED)
    shares = _split_bits(color, 8, 8, 8, 8)
    rgb, alpha = shares[:, :3], shares[:, 3]
    if "min_r" in chunks.names:
        rgb = between("", "rgb", rgb)
    others = (_split_bits(rotation, 2, 10, 10, 10)[:, 1:] - 0.5) * np.sqrt(2)
    return Gaussians(
        mean=between("", "xyz", _split_bits(position, 11, 10, 11)).astype(np.float32),
        scale=between("scale_", "xyz", _split_bits(scale, 11, 10, 11)).astype(np.float32),
        rotation=expand_quaternions(rotation >> np.uint32(30), others).astype(np.float32),
        opacity=to_logit(alpha),
        f_dc=to_f_dc(rgb),
        f_rest=_read_packed_rest(tables.get("sh"), vertex.count),
    )


def _words(table: Table, name: str) -> NDArray[np.uint32]:
    """Return a property of packed bits (N,), which must be a uint32."""
    if name not in table.names or table.column(name).dtype.kind != "u":
        text = f"the property {name} must be a uint of 32 bits"
        raise CheckpointError("CHECKPOINT_LAYOUT", text, pointer=name)
    return table.column(name).astype(np.uint32)


def _split_bits(words: NDArray[np.uint32], *widths: int) -> Reals:
    """Split the bit fields of `words` (N,), highest bits first. Return each field as a fraction of its
    largest value, (N, parts)."""
    shifts = np.cumsum(widths[::-1])[::-1] - widths
    parts = [
        ((words >> np.uint32(shift)) & np.uint32((1 << width) - 1)) / ((1 << width) - 1)
        for shift, width in zip(shifts.tolist(), widths, strict=True)
    ]
    return np.stack(parts, axis=1)


def _read_packed_rest(table: Table | None, count: int) -> NDArray[np.float32] | None:
    """Return f_rest (N, K, 3), decoded from bytes to values from -4 to 4."""
    if table is None or not table.names:
        return None
    if table.count != count:
        raise damaged(f"the file has {table.count} rows of SH for {count} Gaussians")
    level = _read_rest(table)
    if level is None:
        return None
    share = np.where(level == 0, 0, np.where(level == 255, 1, (level + 0.5) / 256))
    return ((share - 0.5) * _REST_RANGE).astype(np.float32)
