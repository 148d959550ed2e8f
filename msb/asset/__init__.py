"""The `.triasset` contract: manifest, buffers, reader, writer, validation.

Needs NumPy and the standard library only. The format itself is described in docs/triasset.md.
"""

from __future__ import annotations

from msb.asset.build import Description, build_asset
from msb.asset.container import is_asset
from msb.asset.manifest import ASSET_SUFFIX, Manifest
from msb.asset.reader import Asset, load
from msb.asset.validation import validate
from msb.asset.writer import write_asset

__all__ = [
    "ASSET_SUFFIX",
    "Asset",
    "Description",
    "Manifest",
    "build_asset",
    "is_asset",
    "load",
    "validate",
    "write_asset",
]
