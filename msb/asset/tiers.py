"""Check whether a renderer tier can draw an asset."""

from msb.asset.manifest import Manifest, Primitive
from msb.base.paths import shell_word
from msb.errors import Unsupported
from msb.registry import METHODS, NO_APPEARANCE, NO_TRIANGLES, Tier, lookup


def passes_of(method: str, primitive: Primitive) -> dict[Tier, tuple[str, ...]]:
    """Return the passes that each renderer tier needs to draw a primitive of a method, in order.

    Gaussian methods have two kinds of assets: the Gaussians, and meshes extracted from the Gaussians.
    """
    declared = lookup(method)
    return {
        tier: passes
        for tier, passes in declared.passes.items()
        if declared.primitive == "triangle" or (tier == "standard") == (primitive == "triangle")
    }


def why_not(manifest: Manifest, tier: Tier) -> str | None:
    """Return the reason why `tier` cannot draw an asset, or None if the tier can draw it.

    If the method is not installed, only the standard tier is supported. If the manifest lists no
    standard-tier passes, the asset has no static colours, and the standard tier cannot draw it.
    """
    name, passes = manifest.method, manifest.required_passes
    if tier == "standard" and manifest.primitive == "gaussian":
        return NO_TRIANGLES
    if tier != "standard" and manifest.primitive == "triangle" and lookup(name).primitive == "gaussian":
        return NO_APPEARANCE
    if name not in METHODS and tier == "standard" and passes and tier not in passes:
        return f"the method {name} is not installed, and the manifest lists no passes for this tier"
    return lookup(name).unsupported.get(tier)


def refusal(manifest: Manifest, tier: Tier) -> str | None:
    """Return why `tier` cannot draw an asset, with an alternative if possible.

    Return None if the tier can draw the asset.
    """
    why = why_not(manifest, tier)
    if why is None:
        return None
    other: Tier = "dedicated" if tier == "standard" else "standard"
    way_out = f"use the tier {other}"
    way_out += ", or convert it to an ordinary mesh with msb bake" if tier == "standard" else ""
    way_out = f"; {way_out}" if why_not(manifest, other) is None else ""
    return f"{manifest.method} on tier {tier}: {why}{way_out}"


def reject_gaussians(primitive: Primitive, file: object) -> None:
    """Raise UNSUPPORTED_METHOD if a model consists of Gaussians instead of triangles.

    The error names `file`.
    """
    if primitive == "gaussian":
        source = "MODEL" if file is None else shell_word(str(file))
        text = "Gaussian splats, not a mesh; make one with msb bake"
        text += f" {source} -o mesh.glb (a mesh of the splats)"
        raise Unsupported("UNSUPPORTED_METHOD", text, file=file)


def reject_triangles(manifest: Manifest, file: object) -> None:
    """Raise UNSUPPORTED_METHOD if the asset of a Gaussian method is an extracted mesh."""
    if manifest.primitive == "triangle":
        text = f"a mesh that was extracted from {lookup(manifest.method).title}, not its Gaussians"
        raise Unsupported("UNSUPPORTED_METHOD", text, file=file)
