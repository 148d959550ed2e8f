"""An asset's buffers as the numbers a reference renderer computes with, checked first.

An opened asset has been checked for shapes, not for values: whoever computes with them does that.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from msb.errors import AssetError
from msb.reference.arithmetic import sigmoid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from msb.asset import Asset
    from msb.reference.arithmetic import Reals


def check_values(asset: Asset) -> None:
    """Refuse values that cannot be drawn.

    Raises
    ------
    AssetError
        TRIASSET_VALUE_NONFINITE: a float buffer holds NaN or infinity; an opacity logit may be infinite.
        TRIASSET_INDEX_OUT_OF_RANGE: a face uses a vertex that does not exist.
    """
    for name, array in asset.buffers.items():
        if array.dtype.kind != "f":
            continue
        bad = np.isnan(array) if name == "opacity" else ~np.isfinite(array)
        if bad.any():
            first = int(np.argmax(bad.reshape(-1)))
            row = int(np.unravel_index(first, array.shape)[0])
            text = (
                f"buffer {name} holds {array.reshape(-1)[first]} in row {row}; a renderer needs finite values"
            )
            raise AssetError("TRIASSET_VALUE_NONFINITE", text, file=asset.path, pointer=f"{name}[{row}]")
    indices, vertices = asset.buffers["indices"], asset.manifest.vertex_count
    if int(indices.max()) >= vertices:
        row, corner = np.argwhere(indices >= vertices)[0].tolist()
        raise AssetError(
            "TRIASSET_INDEX_OUT_OF_RANGE",
            f"face {row} uses vertex {indices[row, corner]}, but there are {vertices}",
            file=asset.path,
            pointer=f"indices[{row}, {corner}]",
            value=int(indices[row, corner]),
            limit=vertices - 1,
        )


def buffer(asset: Asset, name: str, *shape: int) -> NDArray[Any]:
    """Return a buffer the method cannot be drawn without.

    Raises
    ------
    AssetError
        TRIASSET_BUFFER_REQUIRED: there is none; TRIASSET_BUFFER_SHAPE: it is not `shape`.
    """
    where: dict[str, Any] = {"file": asset.path, "pointer": f"/buffers/{name}"}
    if name not in asset.buffers:
        text = f"there is no buffer {name}; a model of {asset.manifest.method} cannot be drawn without it"
        raise AssetError("TRIASSET_BUFFER_REQUIRED", text, **where)
    array = asset.buffers[name]
    if array.shape != shape:
        text = f"buffer {name} is {_product(array.shape)}; {asset.manifest.method} has {_product(shape)}"
        raise AssetError("TRIASSET_BUFFER_SHAPE", text, value=list(array.shape), **where)
    return array


def require(asset: Asset, section: str, key: str, value: str) -> None:
    """Refuse an asset whose manifest does not say `value` for `key` in one of its sections of parameters.

    Raises
    ------
    AssetError
        TRIASSET_FIELD_VALUE.
    """
    found = getattr(asset.manifest, section).get(key)
    if found != value:
        text = f"{section}.{key} is {found!r:.40}; the renderer of {asset.manifest.method} knows {value!r}"
        raise AssetError(
            "TRIASSET_FIELD_VALUE", text, file=asset.path, pointer=f"/{section}/{key}", value=found
        )


def number(asset: Asset, section: str, key: str) -> float:
    """Return a number among the manifest's parameters.

    Raises
    ------
    AssetError
        TRIASSET_FIELD_VALUE: there is none.
    """
    found = getattr(asset.manifest, section).get(key)
    if isinstance(found, bool) or not isinstance(found, int | float):
        text = f"{section}.{key} is {found!r:.40}; it must be a number"
        raise AssetError(
            "TRIASSET_FIELD_VALUE", text, file=asset.path, pointer=f"/{section}/{key}", value=found
        )
    return found


def _product(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))


def opacities(asset: Asset, rows: int, dtype: type[Any]) -> Reals:
    """Return 1 / (1 + exp(-logit)) of the stored logits, (rows,); infinite logits give 0 and 1."""
    require(asset, "opacity", "encoding", "logit")
    return sigmoid(buffer(asset, "opacity", rows).astype(dtype))


def triangles(asset: Asset, dtype: type[Any]) -> Reals:
    """Return the corners of every face, (F, 3, 3): face, corner, xyz."""
    return np.asarray(asset.buffers["positions"].astype(dtype)[asset.buffers["indices"]])


def sh_coefficients(asset: Asset, rows: int, dtype: type[Any]) -> Reals:
    """Return all stored SH coefficients, (rows, 1 + K, 3): coefficient 0 is `f_dc`."""
    first = buffer(asset, "f_dc", rows, 3)
    degree = asset.manifest.sh_degree
    if degree == 0:
        return first.astype(dtype)[:, None]
    flat = buffer(asset, "f_rest", rows, 3 * ((degree + 1) ** 2 - 1))
    if asset.manifest.appearance["f_rest_order"] == "coefficient_major":
        rest = flat.reshape(rows, -1, 3)
    else:
        rest = flat.reshape(rows, 3, -1).transpose(0, 2, 1)
    return np.concatenate([first[:, None], rest], axis=1, dtype=dtype)
