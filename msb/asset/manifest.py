"""The manifest as frozen dataclasses, whose attributes are the keys of the file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from msb.base.origin import NO_ORIGIN, Origin
from msb.registry import TIERS, SettingSource, SettingValue

FORMAT = "triasset"
# The newest supported version of the format. An asset is written in the oldest version that has all needed
# features. Version 1.1 adds textures and origins, and version 1.2 adds Gaussians and frames.
VERSION = "1.2"
TEXTURE_VERSION = "1.1"
PLAIN_VERSION = "1.0"
# First version for assets that record the up direction, unit or floor of a capture.
FRAME_VERSION = "1.2"
MAJOR = 1
MINOR = 2
ASSET_SUFFIX = ".triasset"
MANIFEST_NAME = "manifest.json"
# Alignment of buffers in bytes. 64 bytes are the size of a cache line, and the strictest alignment that GPUs
# require of host pointers.
ALIGNMENT = 64

Topology = Literal["triangle_soup", "indexed_mesh"]
Primitive = Literal["triangle", "gaussian"]
Domain = Literal["vertex", "face", "corner", "global"]
Parameters = dict[str, Any]

# The NumPy dtype of each dtype in a manifest, always little-endian.
DTYPES: dict[str, np.dtype[Any]] = {
    "float32": np.dtype("<f4"),
    "uint32": np.dtype("<u4"),
    "uint8": np.dtype("u1"),
}


@dataclass(frozen=True)
class Bounds:
    """The axis-aligned bounding box of all finite positions, relative to the origin, in scene units."""

    min: tuple[float, float, float]
    max: tuple[float, float, float]


@dataclass(frozen=True)
class BoundingSphere:
    """A bounding sphere of all finite positions, relative to the origin, in scene units (paper: R_bound)."""

    center: tuple[float, float, float]
    radius: float


@dataclass(frozen=True)
class StoredSetting:
    """The value of a method's setting, and its origin."""

    value: SettingValue
    source: SettingSource


@dataclass(frozen=True)
class SourceFile:
    """A source file of the asset. The field `path` is relative to the exported folder."""

    path: str
    sha256: str
    byte_length: int


@dataclass(frozen=True)
class Source:
    """The source files of the asset."""

    files: tuple[SourceFile, ...] = ()


@dataclass(frozen=True)
class CoordinateFrame:
    """Axes and units of the positions. In COLMAP scenes y points down, so `up` is "-y"."""

    handedness: Literal["right"] = "right"
    up: str = "unknown"
    units: str = "scene"

    @property
    def known_up(self) -> str | None:
        """The up axis, or None if the axis is unknown."""
        return None if self.up == "unknown" else self.up


@dataclass(frozen=True)
class BufferSpec:
    """The declaration of a buffer: its position in a file, its type, its shape and its domain.

    The first length of `shape` is V, F or 3F, depending on the domain. For the domain "global", any length is
    valid. The fields `offset` and `byte_length` count bytes in `file`.
    """

    file: str
    offset: int
    byte_length: int
    dtype: str
    shape: tuple[int, ...]
    domain: Domain
    sha256: str


@dataclass(frozen=True)
class Manifest:
    """The description of an asset and its buffers. The keys are in the order of manifest.json."""

    generator: str
    method: str
    topology: Topology
    face_count: int
    vertex_count: int
    bounds: Bounds
    bounding_sphere: BoundingSphere
    sh_degree: int
    coverage: Parameters
    opacity: Parameters
    appearance: Parameters
    compositing: Parameters
    settings: dict[str, StoredSetting]
    required_passes: dict[str, tuple[str, ...]]
    color_space: str
    coordinate_frame: CoordinateFrame
    source: Source
    buffers: dict[str, BufferSpec]
    training: Parameters = field(default_factory=dict)
    """Properties of the training, read from its config files. The file omits an empty mapping."""
    primitive: Primitive = "triangle"
    """The primitive of a face: a triangle (the default, omitted in files), or the placeholder triangle of a
    Gaussian.
    """
    up: str | None = None
    """The precise up direction: an axis, or three numbers "X,Y,Z". Files omit the value None."""
    unit: Parameters | None = None
    """The length "meters_per_unit" of the unit, or None, and its "source". Files omit the value None."""
    floor: float | None = None
    """The height along the up direction, in scene units, that mesh files move to zero. May be None."""
    origin: Origin = NO_ORIGIN
    """The point of the scene to which positions are relative. Files omit the origin (0, 0, 0)."""
    format: str = FORMAT
    version: str = PLAIN_VERSION
    extra: Parameters = field(default_factory=dict, repr=False)
    """Unknown keys of a newer minor version. These keys are kept when the asset is saved."""

    @property
    def counts(self) -> tuple[str, ...]:
        """The numbers of primitives as texts for people."""
        if self.primitive == "gaussian":
            return (f"{self.face_count:,} Gaussians",)
        return f"{self.vertex_count:,} vertices", f"{self.face_count:,} faces"

    def to_dict(self) -> dict[str, Any]:
        """Return the manifest as JSON data, with keys in the order of the file."""
        data: dict[str, Any] = _lists(asdict(self))
        extra = data.pop("extra")
        if not data["training"]:
            del data["training"]
        if self.primitive == "triangle":
            del data["primitive"]
        for key in ("up", "unit", "floor"):
            if data[key] is None:
                del data[key]
        if not any(self.origin):
            del data["origin"]
        ordered = {"format": data.pop("format"), "version": data.pop("version")}
        buffers = data.pop("buffers")
        return {**ordered, **data, **extra, "buffers": buffers}

    def to_bytes(self) -> bytes:
        """Return the bytes of manifest.json. Equal manifests give equal bytes."""
        text = json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False)
        return (text + "\n").encode("utf-8")

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Manifest:
        """Return a manifest from JSON data that `check_manifest` has accepted."""
        keys = set(cls.__dataclass_fields__) - {"extra"}
        known = {key: value for key, value in data.items() if key in keys}
        frame = data["coordinate_frame"]
        known.update(
            bounds=Bounds(**{k: _vector(data["bounds"][k]) for k in ("min", "max")}),
            bounding_sphere=BoundingSphere(
                _vector(data["bounding_sphere"]["center"]), float(data["bounding_sphere"]["radius"])
            ),
            settings={k: StoredSetting(v["value"], v["source"]) for k, v in data["settings"].items()},
            required_passes={k: tuple(v) for k, v in data["required_passes"].items() if k in TIERS},
            coordinate_frame=CoordinateFrame(frame["handedness"], frame["up"], frame["units"]),
            source=Source(
                tuple(SourceFile(f["path"], f["sha256"], f["byte_length"]) for f in data["source"]["files"])
            ),
            buffers={name: _buffer_spec(spec) for name, spec in data["buffers"].items()},
            origin=_vector(data.get("origin", NO_ORIGIN)),
            extra={key: value for key, value in data.items() if key not in keys},
        )
        return cls(**known)


def _vector(values: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = map(float, values)
    return x, y, z


def _buffer_spec(spec: dict[str, Any]) -> BufferSpec:
    known = {key: spec[key] for key in BufferSpec.__dataclass_fields__}
    return BufferSpec(**{**known, "shape": tuple(spec["shape"])})


def _lists(value: Any) -> Any:
    """Return `value` with tuples replaced by lists, as in JSON."""
    if isinstance(value, dict):
        return {key: _lists(item) for key, item in value.items()}
    return [_lists(item) for item in value] if isinstance(value, list | tuple) else value
