"""The `.triasset` format: manifest, buffers, reader, writer and validation.

This package needs only NumPy and the standard library. docs/triasset.md describes the format.
"""

from msb.asset.asset import Asset
from msb.asset.build import Description, build_asset
from msb.asset.container import is_asset
from msb.asset.manifest import ASSET_SUFFIX, Manifest
from msb.asset.reader import load
from msb.asset.validation import Validation, validate
from msb.asset.writer import write_asset

__all__ = [
    "ASSET_SUFFIX",
    "Asset",
    "Description",
    "Manifest",
    "Validation",
    "build_asset",
    "is_asset",
    "load",
    "validate",
    "write_asset",
]
