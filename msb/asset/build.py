"""Build an asset in memory from arrays, with bounds, topology, hashes and the manifest."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.asset import Asset
from msb.asset.check import check_manifest, raise_first_error
from msb.asset.drawable import check_indices, first_bad
from msb.asset.frame import Frame, frame_of, with_frame
from msb.asset.manifest import (
    DTYPES,
    PLAIN_VERSION,
    TEXTURE_VERSION,
    VERSION,
    BoundingSphere,
    Bounds,
    BufferSpec,
    CoordinateFrame,
    Domain,
    Manifest,
    Parameters,
    Primitive,
    Source,
    StoredSetting,
    Topology,
)
from msb.asset.progress import Meter, Progress
from msb.asset.texture import KIND, PASS
from msb.asset.tiers import passes_of
from msb.base.origin import NO_ORIGIN, Origin
from msb.base.version import __version__
from msb.errors import AssetError
from msb.registry import TIERS

# Number of rows of a buffer that are processed at a time.
CHUNK_ROWS = 1 << 20

# Number of bytes that are hashed or written at a time.
CHUNK_BYTES = 1 << 24

# The order of standard buffers in the manifest. Other buffers follow by name.
_ORDER = ("positions", "indices", "color", "f_dc", "f_rest", "opacity", "sigma")
_DTYPE_NAMES = {dtype: name for name, dtype in DTYPES.items()}


@dataclass(frozen=True)
class Description:
    """The part of `Manifest` that cannot be computed from the arrays.

    An adapter, which reads the files of a method, sets these keys. The defaults describe a mesh with static
    colours.
    """

    method: str = "mesh"
    sh_degree: int = 0
    coverage: Parameters = field(default_factory=lambda: {"kernel": "solid"})
    opacity: Parameters = field(default_factory=lambda: {"encoding": "opaque"})
    appearance: Parameters = field(default_factory=lambda: {"kind": "static_color"})
    compositing: Parameters = field(default_factory=lambda: {"kind": "opaque_z_buffer"})
    settings: dict[str, StoredSetting] = field(default_factory=dict)
    color_space: str = "srgb"
    coordinate_frame: CoordinateFrame = field(default_factory=CoordinateFrame)
    source: Source = field(default_factory=Source)
    training: Parameters = field(default_factory=dict)
    primitive: Primitive = "triangle"
    origin: Origin = NO_ORIGIN
    frame: Frame | None = None

    @classmethod
    def of(cls, manifest: Manifest) -> Description:
        """Return the description of an existing asset."""
        names = (known.name for known in fields(cls) if known.name != "frame")
        return cls(**{name: getattr(manifest, name) for name in names}, frame=frame_of(manifest))


def build_asset(
    buffers: Mapping[str, NDArray[Any]],
    domains: Mapping[str, Domain],
    description: Description | None = None,
    *,
    progress: Progress | None = None,
) -> Asset:
    """Return an asset with these buffers and a complete, checked manifest.

    Parameters
    ----------
    buffers : mapping of str to ndarray
        `positions` (V, 3) float32 relative to the origin of `description`, `indices` (F, 3) uint32; other
        buffers are float32, uint32 or uint8. Contiguous little-endian arrays are not copied.
    domains : mapping of str to str
        The domains of all buffers except `positions` and `indices`.
    description : Description, optional
        The default describes a mesh with static colours.
    progress : callable, optional
        Called as ``progress("hashing buffers", done, total)`` with bytes.

    Raises
    ------
    AssetError
        The first error in the buffers or the manifest.
    """
    description = description or Description()
    # Convert and sort the arrays, and check the mesh.
    names = sorted(buffers, key=lambda name: (_ORDER.index(name) if name in _ORDER else len(_ORDER), name))
    arrays = {name: _to_canonical(name, buffers[name]) for name in names}
    for name, dtype in (("positions", "float32"), ("indices", "uint32")):
        if name not in arrays or arrays[name].ndim != 2 or arrays[name].shape[1] != 3:
            raise AssetError("TRIASSET_BUFFER", f"the buffer {name} is required, with shape n x 3")
        if arrays[name].dtype != DTYPES[dtype]:
            text = f"buffer {name} is {arrays[name].dtype}; it must be {dtype}"
            raise AssetError("TRIASSET_BUFFER", text, pointer=f"/buffers/{name}/dtype")
    positions, indices = arrays["positions"], arrays["indices"]
    if not (len(positions) and len(indices)):
        text = f"the mesh has {len(positions)} vertices and {len(indices)} faces; an asset must not be empty"
        raise AssetError("TRIASSET_EMPTY", text)
    if (at := first_bad(positions)) is not None:
        text = f"vertex {at[0]} is {positions[at[0]].tolist()}; coordinates must be finite"
        raise AssetError("TRIASSET_VALUE_NONFINITE", text, pointer=f"positions[{at[0]}]")
    check_indices(indices, len(positions))
    # Compute the other keys of the manifest.
    bounds, sphere = measure_bounds(positions)
    textured = description.appearance.get("kind") == KIND
    is_splat, is_extended = description.primitive == "gaussian", textured or any(description.origin)
    passes = {"standard": (PASS,)} if textured else passes_of(description.method, description.primitive)
    meter = Meter("hashing buffers", sum(array.nbytes for array in arrays.values()), progress)
    all_domains: dict[str, Any] = {"positions": "vertex", "indices": "face", **domains}
    manifest = Manifest(
        **{key: value for key, value in vars(description).items() if key != "frame"},
        generator=f"meshsplatbench {__version__}",
        topology=_topology(positions, indices),
        face_count=len(indices),
        vertex_count=len(positions),
        bounds=bounds,
        bounding_sphere=sphere,
        required_passes={tier: passes[tier] for tier in TIERS if tier in passes},
        version=VERSION if is_splat else TEXTURE_VERSION if is_extended else PLAIN_VERSION,
        buffers={name: _spec(name, array, all_domains.get(name), meter) for name, array in arrays.items()},
    )
    raise_first_error(check_manifest(manifest.to_dict()), None)
    return with_frame(Asset(manifest, MappingProxyType(arrays)), description.frame)


def measure_bounds(positions: NDArray[np.float32]) -> tuple[Bounds, BoundingSphere]:
    """Return the bounding box and a bounding sphere of the finite rows of `positions` (V, 3).

    At least one row must be finite. The sphere has the centre of the bounding box. The radius of the sphere
    is at most sqrt(3) times the radius of the smallest sphere. The result does not depend on the order of the
    points. The function takes O(V) time and O(1) memory.
    """
    # First pass: compute the bounding box. Second pass: compute the largest distance of a vertex from the
    # centre of the box.
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for rows in _finite_chunks(positions):
        low = np.minimum(low, _columnwise(np.minimum, rows))
        high = np.maximum(high, _columnwise(np.maximum, rows))
    center = low + (high - low) / 2
    squared = 0.0
    for rows in _finite_chunks(positions):
        offsets = rows - center
        squared = max(squared, float(np.einsum("ij,ij->i", offsets, offsets).max()))
    # Round up, so that a vertex on the sphere counts as inside.
    radius = float(np.nextafter(np.sqrt(squared), np.inf)) if squared else 0.0
    return (
        Bounds(_triple(low), _triple(high)),
        BoundingSphere(_triple(center), radius),
    )


def _finite_chunks(positions: NDArray[np.float32]) -> Iterator[NDArray[np.float32]]:
    """Yield the finite rows of `positions` (V, 3) in chunks."""
    for start in range(0, len(positions), CHUNK_ROWS):
        rows = positions[start : start + CHUNK_ROWS]
        finite = np.isfinite(rows)
        if not finite.all():  # Selecting rows is slow, but rarely needed.
            rows = rows[finite.all(axis=1)]
        if len(rows):
            yield rows


def _columnwise(ufunc: np.ufunc, rows: NDArray[np.float32]) -> NDArray[np.float64]:
    """Reduce the rows (N, 3) with `ufunc`. For speed, 1024 rows are reduced side by side."""
    whole = len(rows) - len(rows) % 1024
    rest = rows[whole:]
    if whole:
        rest = np.concatenate([rest, ufunc.reduce(rows[:whole].reshape(-1, 3072)).reshape(1024, 3)])
    return np.asarray(ufunc.reduce(rest), np.float64)


def _triple(vector: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = (float(value) + 0.0 for value in vector)  # Adding 0.0 converts -0.0 to 0.0.
    return x, y, z


def _to_canonical(name: str, array: NDArray[Any]) -> NDArray[Any]:
    """Return `array` contiguous, little-endian and read-only."""
    dtype = array.dtype.newbyteorder("<")
    if dtype not in _DTYPE_NAMES:
        text = f"buffer {name} is {array.dtype}; it must be float32, uint32 or uint8"
        raise AssetError("TRIASSET_BUFFER", text, pointer=f"/buffers/{name}/dtype")
    view = np.ascontiguousarray(array, dtype).view()
    view.flags.writeable = False
    return view


def _topology(positions: NDArray[np.float32], indices: NDArray[np.uint32]) -> Topology:
    """Return "triangle_soup" if the indices are 0, 1, 2, ..., 3 F - 1 and use all vertices."""
    is_soup = len(positions) == 3 * len(indices) and first_shared(indices) is None
    return "triangle_soup" if is_soup else "indexed_mesh"


def first_shared(indices: NDArray[np.uint32]) -> int | None:
    """Return the first corner i (0 to 3 F - 1) whose vertex index differs from i.

    Return None for a triangle soup.
    """
    for start in range(0, len(indices), CHUNK_ROWS):
        rows = indices[start : start + CHUNK_ROWS].ravel()
        wrong = rows != np.arange(3 * start, 3 * start + rows.size, dtype=np.uint64)
        if wrong.any():
            return 3 * start + int(np.argmax(wrong))
    return None


def _spec(name: str, array: NDArray[Any], domain: Any, meter: Meter) -> BufferSpec:
    """Return the declaration of a buffer with its hash. The buffer file is named after the buffer."""
    digest, data = hashlib.sha256(), as_bytes(array)
    for start in range(0, len(data), CHUNK_BYTES):
        digest.update(data[start : start + CHUNK_BYTES])
        meter.advance(len(data[start : start + CHUNK_BYTES]))
    return BufferSpec(
        file=f"buffers/{name}.bin",
        offset=0,
        byte_length=array.nbytes,
        dtype=_DTYPE_NAMES[array.dtype],
        shape=array.shape,
        domain=domain,
        sha256=digest.hexdigest(),
    )


def as_bytes(array: NDArray[Any]) -> memoryview:
    """Return the bytes of a contiguous array without copying them."""
    return array.reshape(-1).view(np.uint8).data
