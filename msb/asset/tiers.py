"""Which tiers can show an asset."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msb.methods import METHODS, lookup

if TYPE_CHECKING:
    from msb.asset.manifest import Manifest
    from msb.methods import Tier


def why_not(manifest: Manifest, tier: Tier) -> str | None:
    """Return why `tier` cannot show the asset of `manifest`, None if it can.

    Of a method that is not installed the standard tier shows what the manifest says it can: where passes of
    other tiers alone are listed, there is no static colour.
    """
    name, passes = manifest.method, manifest.required_passes
    if name not in METHODS and tier == "standard" and passes and tier not in passes:
        return f"the method {name} is not installed, and the manifest lists no passes for this tier"
    return lookup(name).unsupported.get(tier)
