"""Checks before rendering: finite values, valid indices, required buffers and parameters."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.asset import Asset
from msb.errors import AssetError

# Number of values that are checked at a time.
_CHUNK = 1 << 23


def check_drawable(asset: Asset, names: Iterable[str] | None = None) -> None:
    """Check in a single pass over the buffers that the asset can be drawn.

    The argument `names` contains the float buffers to check. By default, all float buffers are checked.

    Raises
    ------
    AssetError
        TRIASSET_VALUE_NONFINITE or TRIASSET_INDEX_OUT_OF_RANGE.
    """
    for name in asset.buffers if names is None else names:
        array = asset.buffers.get(name)
        if array is None or array.dtype.kind != "f":
            continue
        if (at := first_bad(array, infinite=name == "opacity")) is not None:
            text = f"buffer {name} contains {array[at]} in row {at[0]}; renderers need finite values"
            raise AssetError("TRIASSET_VALUE_NONFINITE", text, file=asset.path, pointer=f"{name}[{at[0]}]")
    check_indices(asset.buffers["indices"], asset.manifest.vertex_count, asset.path)


def first_bad(array: NDArray[Any], *, infinite: bool = False) -> tuple[int, ...] | None:
    """Return the index of the first NaN or infinite value of `array` (N, ...), or None.

    With `infinite`, infinite values are allowed.
    """
    rows = max(1, _CHUNK // max(1, array[:1].size))
    for start in range(0, len(array) if array.size else 0, rows):
        part = array[start : start + rows]
        with np.errstate(over="ignore", invalid="ignore"):
            # A fast test reduces each chunk to one value. The sum is finite only if all values are finite. If
            # infinite values are allowed, the minimum is tested instead. The minimum is NaN if any value is
            # NaN. A sum of finite values may overflow. Therefore single values are tested if the sum is not
            # finite.
            total = part.min() if infinite else part.sum(dtype=np.float64)
        if np.isnan(total) if infinite else not np.isfinite(total):
            bad = np.isnan(part) if infinite else ~np.isfinite(part)
            if bad.any():
                first, *rest = map(int, np.unravel_index(int(np.argmax(bad)), part.shape))
                return (start + first, *rest)
    return None


def check_indices(indices: NDArray[np.uint32], vertices: int, file: object = None) -> None:
    """Check that faces (F, 3) only use existing vertices. Raise TRIASSET_INDEX_OUT_OF_RANGE otherwise."""
    if indices.size and int(indices.max()) >= vertices:
        face, corner = map(int, np.argwhere(indices >= vertices)[0])
        text = f"face {face} uses vertex {indices[face, corner]}, but there are {vertices} vertices"
        pointer = f"indices[{face}, {corner}]"
        raise AssetError("TRIASSET_INDEX_OUT_OF_RANGE", text, file=file, pointer=pointer)


def required_buffer(asset: Asset, name: str, *shape: int) -> NDArray[Any]:
    """Return a buffer that is required to draw the method.

    Raises
    ------
    AssetError
        `TRIASSET_BUFFER`: the buffer is missing, or its shape is not `shape`.
    """
    where: dict[str, Any] = {"file": asset.path, "pointer": f"/buffers/{name}"}
    method = asset.manifest.method
    if name not in asset.buffers:
        text = f"the buffer {name} is missing; it is required to draw a model of {method}"
        raise AssetError("TRIASSET_BUFFER", text, **where)
    array = asset.buffers[name]
    if array.shape != shape:
        actual, expected = (" x ".join(map(str, sizes)) for sizes in (array.shape, shape))
        text = f"buffer {name} has the shape {actual}; {method} needs {expected}"
        raise AssetError("TRIASSET_BUFFER", text, **where)
    return array


def require(asset: Asset, section: str, key: str, value: str) -> None:
    """Check that a section of the manifest has the value `value` for `key`.

    Raises
    ------
    AssetError
        TRIASSET_FIELD.
    """
    stored = getattr(asset.manifest, section).get(key)
    if stored != value:
        text = f"{section}.{key} is {stored!r:.40}; {asset.manifest.method} only supports {value!r}"
        raise AssetError("TRIASSET_FIELD", text, file=asset.path, pointer=f"/{section}/{key}")
