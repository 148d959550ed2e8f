"""Which tiers can show an asset."""

from msb.asset.manifest import Manifest
from msb.registry import METHODS, Tier, lookup


def why_not(manifest: Manifest, tier: Tier) -> str | None:
    """Return why `tier` cannot show the asset of `manifest`, None if it can.

    If the method is not installed, the manifest decides about the standard tier: where it lists passes of
    other tiers only, there is no static colour.
    """
    name, passes = manifest.method, manifest.required_passes
    if name not in METHODS and tier == "standard" and passes and tier not in passes:
        return f"the method {name} is not installed, and the manifest lists no passes for this tier"
    return lookup(name).unsupported.get(tier)


def refusal(manifest: Manifest, tier: Tier) -> str | None:
    """Return the sentence that refuses what `tier` cannot show, and names a way out; None if it can."""
    why = why_not(manifest, tier)
    if why is None:
        return None
    other: Tier = "dedicated" if tier == "standard" else "standard"
    way_out = "msb bake makes a plain mesh of it" if tier == "standard" else "tier standard shows it"
    way_out = f"; {way_out}" if why_not(manifest, other) is None else ""
    return f"{manifest.method} on tier {tier}: {why}{way_out}"
