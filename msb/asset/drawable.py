"""What every renderer needs of an asset before it draws it: drawable values, buffers of the right shape."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.errors import AssetError

if TYPE_CHECKING:
    from msb.asset.asset import Asset


def check_drawable(asset: Asset, names: Iterable[str] | None = None) -> None:
    """Refuse an asset with values that cannot be drawn, in one pass over the buffers.

    Of the float buffers those in `names` are looked at, all if it is None.
    """
    for name in asset.buffers if names is None else names:
        array = asset.buffers.get(name)
        if array is None or array.dtype.kind != "f":
            continue
        infinite = name == "opacity"
        if not _all_good(array, infinite=infinite):
            flat = array.reshape(-1)
            first = int(np.argmax(np.isnan(flat) if infinite else ~np.isfinite(flat)))
            row = int(np.unravel_index(first, array.shape)[0])
            text = f"buffer {name} holds {flat[first]} in row {row}; a renderer needs finite values"
            raise AssetError("TRIASSET_VALUE_NONFINITE", text, file=asset.path, pointer=f"{name}[{row}]")
    indices, vertices = asset.buffers["indices"], asset.manifest.vertex_count
    if int(indices.max()) >= vertices:
        face, corner = divmod(int(np.argmax(indices.reshape(-1) >= vertices)), 3)
        raise AssetError(
            "TRIASSET_INDEX_OUT_OF_RANGE",
            f"face {face} uses vertex {indices[face, corner]}, but there are {vertices}",
            file=asset.path,
            pointer=f"indices[{face}, {corner}]",
        )


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


def _all_good(array: NDArray[Any], *, infinite: bool) -> bool:
    with np.errstate(over="ignore", invalid="ignore"):
        if infinite:  # the least is NaN if any is
            return not np.isnan(array.min())
        # A sum that is finite has finite terms only; one that is not may have overflowed.
        return bool(np.isfinite(np.sum(array, dtype=np.float64))) or bool(np.isfinite(array).all())
