"""What every renderer needs of an asset before it draws it: drawable values, buffers of the right shape."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.asset import Asset
from msb.errors import AssetError

# Values looked at together.
_CHUNK = 1 << 23


def check_drawable(asset: Asset, names: Iterable[str] | None = None) -> None:
    """Refuse an asset with values that cannot be drawn, in one pass over the buffers.

    Of the float buffers those in `names` are looked at, all if it is None.
    """
    for name in asset.buffers if names is None else names:
        array = asset.buffers.get(name)
        if array is None or array.dtype.kind != "f":
            continue
        if (at := first_bad(array, infinite=name == "opacity")) is not None:
            text = f"buffer {name} holds {array[at]} in row {at[0]}; a renderer needs finite values"
            raise AssetError("TRIASSET_VALUE_NONFINITE", text, file=asset.path, pointer=f"{name}[{at[0]}]")
    check_indices(asset.buffers["indices"], asset.manifest.vertex_count, asset.path)


def first_bad(array: NDArray[Any], *, infinite: bool = False) -> tuple[int, ...] | None:
    """Return where the first value is that is NaN or, unless `infinite` allows it, infinite; None if nowhere.

    `array` (N, ...) is read once and in pieces.
    """
    rows = max(1, _CHUNK // max(1, array[:1].size))
    for start in range(0, len(array) if array.size else 0, rows):
        part = array[start : start + rows]
        with np.errstate(over="ignore", invalid="ignore"):
            # The least is NaN if any is. A sum that is finite has finite terms only; others may have
            # overflowed.
            total = part.min() if infinite else part.sum(dtype=np.float64)
        if np.isnan(total) if infinite else not np.isfinite(total):
            bad = np.isnan(part) if infinite else ~np.isfinite(part)
            if bad.any():
                first, *rest = map(int, np.unravel_index(int(np.argmax(bad)), part.shape))
                return (start + first, *rest)
    return None


def check_indices(indices: NDArray[np.uint32], vertices: int, file: object = None) -> None:
    """Refuse faces (F, 3) that use a vertex which is not there."""
    if int(indices.max()) >= vertices:
        face, corner = map(int, np.argwhere(indices >= vertices)[0])
        text = f"face {face} uses vertex {indices[face, corner]}, but there are {vertices}"
        pointer = f"indices[{face}, {corner}]"
        raise AssetError("TRIASSET_INDEX_OUT_OF_RANGE", text, file=file, pointer=pointer)


def required_buffer(asset: Asset, name: str, *shape: int) -> NDArray[Any]:
    """Return a buffer the method cannot be drawn without.

    Raises
    ------
    AssetError
        `TRIASSET_BUFFER`: there is no such buffer, or its shape is not `shape`.
    """
    where: dict[str, Any] = {"file": asset.path, "pointer": f"/buffers/{name}"}
    method = asset.manifest.method
    if name not in asset.buffers:
        text = f"there is no buffer {name}; a model of {method} cannot be drawn without it"
        raise AssetError("TRIASSET_BUFFER", text, **where)
    array = asset.buffers[name]
    if array.shape != shape:
        have, want = (" x ".join(map(str, sizes)) for sizes in (array.shape, shape))
        text = f"buffer {name} is {have}; {method} has {want}"
        raise AssetError("TRIASSET_BUFFER", text, **where)
    return array


def require(asset: Asset, section: str, key: str, value: str) -> None:
    """Refuse an asset whose manifest does not say `value` for `key` in one of its sections of parameters.

    Raises
    ------
    AssetError
        TRIASSET_FIELD.
    """
    stored = getattr(asset.manifest, section).get(key)
    if stored != value:
        text = f"{section}.{key} is {stored!r:.40}; the renderer of {asset.manifest.method} knows {value!r}"
        raise AssetError("TRIASSET_FIELD", text, file=asset.path, pointer=f"/{section}/{key}")
