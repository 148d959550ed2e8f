"""Which tiers can show an asset."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msb.registry import METHODS, lookup

if TYPE_CHECKING:
    from msb.asset.manifest import Manifest
    from msb.registry import Tier


def why_not(manifest: Manifest, tier: Tier) -> str | None:
    """Return why `tier` cannot show the asset of `manifest`, None if it can.

    If the method is not installed, the manifest decides about the standard tier: where it lists passes of
    other tiers only, there is no static colour.
    """
    name, passes = manifest.method, manifest.required_passes
    if name not in METHODS and tier == "standard" and passes and tier not in passes:
        return f"the method {name} is not installed, and the manifest lists no passes for this tier"
    return lookup(name).unsupported.get(tier)
