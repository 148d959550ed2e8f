"""Move an asset to another origin. `msb.base.origin` defines which meshes need another origin."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from msb.asset.asset import Asset
from msb.asset.manifest import TEXTURE_VERSION
from msb.base.origin import NO_ORIGIN, Origin, to_world


def world_positions(asset: Asset) -> NDArray[np.floating]:
    """Return the coordinates (V, 3) in the scene.

    The array is the stored float32 array, or float64 if the asset has an origin.
    """
    return to_world(asset.buffers["positions"], asset.manifest.origin)


def with_origin(asset: Asset, origin: Origin) -> Asset:
    """Return `asset` in a separate scene, in which its positions are relative to `origin`.

    The stored positions do not change, so the mesh moves in the scene. `Camera.relative_to` moves cameras
    in the same way.
    """
    if origin == asset.manifest.origin:
        return asset
    version = asset.manifest.version
    if any(origin):
        version = max(version, TEXTURE_VERSION)
    return replace(asset, manifest=replace(asset.manifest, origin=origin, version=version))


def without_origin(asset: Asset) -> Asset:
    """Return `asset` with its positions as scene coordinates, for code that computes with coordinates."""
    return with_origin(asset, NO_ORIGIN)
