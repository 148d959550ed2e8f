"""Check whether a tier can draw an asset."""

from msb.asset.manifest import Manifest
from msb.registry import METHODS, Tier, lookup


def why_not(manifest: Manifest, tier: Tier) -> str | None:
    """Return the reason why `tier` cannot draw an asset, or None if it can draw the asset.

    If the method is not installed, only the standard tier is supported. If the manifest lists no passes for
    the standard tier, the asset has no static colours. Then the standard tier is not supported either.
    """
    name, passes = manifest.method, manifest.required_passes
    if name not in METHODS and tier == "standard" and passes and tier not in passes:
        return f"the method {name} is not installed, and the manifest lists no passes for this tier"
    return lookup(name).unsupported.get(tier)


def refusal(manifest: Manifest, tier: Tier) -> str | None:
    """Return why `tier` cannot draw an asset, and an alternative if there is one; None if it can draw it."""
    why = why_not(manifest, tier)
    if why is None:
        return None
    other: Tier = "dedicated" if tier == "standard" else "standard"
    way_out = "msb bake converts it to an ordinary mesh" if tier == "standard" else "use the tier standard"
    way_out = f"; {way_out}" if why_not(manifest, other) is None else ""
    return f"{manifest.method} on tier {tier}: {why}{way_out}"
