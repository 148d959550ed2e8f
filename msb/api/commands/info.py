"""`msb info`: show the contents of an asset on one screen."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msb.base.origin import describe_origin
from msb.cli.command import command
from msb.cli.output import JsonOutput, Output, echo, setting_text
from msb.errors import shorten
from msb.render.options import Source

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.asset.manifest import Manifest
    from msb.asset.texture import Sampler
    from msb.registry import Tier


@command("msb info data_stubs/splat_like.triasset", "msb info --json - data_stubs/checkpoint")
def info(path: Source, output: JsonOutput) -> None:
    """Show the contents of an asset, checkpoint or mesh file: method, counts, bounds, settings and buffers.

    For a .triasset, msb info reads the manifest and checks paths and sizes. The command msb validate also
    checks the values. For a mesh file or checkpoint, msb info shows the asset that msb convert would write.
    Gaussian splats are not a mesh. The command shows Gaussian splats, and ends with exit status 4.
    """
    from msb.api.command_files import open_asset
    from msb.asset.tiers import reject_gaussians

    asset = open_asset(path, output)
    size = sum(spec.byte_length for spec in asset.manifest.buffers.values())
    manifest, textures = asset.manifest.to_dict(), _textures(asset.manifest)
    document = {"schema": "msb.info/1", "path": str(path), "buffer_bytes": size, "manifest": manifest}
    if any(asset.manifest.origin):  # The bounds in the manifest are relative to the origin.
        bounds, sphere = asset.manifest.bounds, asset.manifest.bounding_sphere
        center = _in_scene(sphere.center, asset.manifest)
        document["bounds"] = {key: _in_scene(getattr(bounds, key), asset.manifest) for key in ("min", "max")}
        document["bounding_sphere"] = {"center": center, "radius": sphere.radius}
    output.write_json({**document, "textures": textures} if textures else document)
    if output.prints_text:
        _print(asset, path, size, output)
    reject_gaussians(asset.manifest.primitive, path)


def _print(asset: Asset, path: Path, size: int, output: Output) -> None:
    from msb.asset.look import up_axis
    from msb.asset.texture import Sampler, is_textured
    from msb.registry import TIERS, lookup

    m = asset.manifest
    method, frame = lookup(m.method), m.coordinate_frame
    skin = _skin(_textures(m), Sampler.of(m.appearance)) if is_textured(asset) else None
    apart = {"background", *(Sampler.__dataclass_fields__ if skin else ())}
    look = {name: value for name, value in m.appearance.items() if name not in apart}
    axis = frame.up if frame.up != "unknown" else f"unknown (drawn with {up_axis(asset)} up)"
    axis += f" (precisely {m.up})" if m.up not in (None, frame.up) else ""
    length = None if m.unit is None else m.unit["meters_per_unit"]
    unit = (
        f"{frame.units} units" if length is None else f"a unit is {length:g} m ({(m.unit or {})['source']})"
    )
    # The table has a row for each property. Rows that do not apply are omitted.
    rows: list[tuple[str, str]] = [
        (
            "file",
            f"{path} (triasset {m.version}, {m.generator})"
            if asset.path
            else f"{asset.opened_from or path} (not a .triasset)",
        ),
        ("method", m.method if m.method == method.title else f"{m.method} ({method.title})"),
        ("topology", _topology(m)),
        *([("origin", describe_origin(m.origin))] if any(m.origin) else []),
        ("bounds", f"{_point(m.bounds.min, m)} to {_point(m.bounds.max, m)}"),
        ("sphere", f"radius {m.bounding_sphere.radius:.6g}, centre {_point(m.bounding_sphere.center, m)}"),
        ("appearance", f"{_parameters(look)}; SH degree {m.sh_degree}; {m.color_space}"),
        *([("textures", skin)] if skin else []),
        ("coverage", f"{_parameters(m.coverage)}; opacity {_parameters(m.opacity)}"),
        ("compositing", _parameters(m.compositing)),
        ("background", _background(m)),
        *([("training", _training(m))] if m.training else []),
        ("frame", f"{frame.handedness}-handed, up axis {axis}, {unit}"),
        *((f"tier {tier}", _tier(m, tier)) for tier in TIERS),
        *(("setting", f"{name} = {setting_text(s.value)} ({s.source})") for name, s in m.settings.items()),
        *(
            ("source", f"{f.path}, {f.byte_length:,} bytes, sha256 {f.sha256[:12]}...")
            for f in m.source.files
        ),
    ]
    output.table((), ((label, shorten(text, 200)) for label, text in rows))
    echo()
    # The table of buffers with their total size.
    buffers = [
        (name, " x ".join(map(str, spec.shape)), spec.dtype, spec.domain, f"{spec.byte_length:,}")
        for name, spec in m.buffers.items()
    ]
    total = ("all", "", "", "", f"{size:,}")
    output.table(("Buffer", "Shape", "Type", "Domain", "Bytes"), [*buffers, total], right=(4,))


def _textures(manifest: Manifest) -> list[dict[str, Any]]:
    """Return the name, width, height and channels of each texture, sorted by texture number."""
    from msb.asset.texture import NAME

    names = sorted(
        (name for name in manifest.buffers if NAME.fullmatch(name)), key=lambda name: int(name[8:])
    )
    sizes = [(name, *manifest.buffers[name].shape) for name in names]
    return [{"name": name, "width": w, "height": h, "channels": c} for name, h, w, c in sizes]


def _topology(manifest: Manifest) -> str:
    """Return the kind and number of the primitives as text."""
    counts = ", ".join(manifest.counts)
    if manifest.primitive == "gaussian":
        return f"{counts}, each with a placeholder triangle"
    return f"{manifest.topology.replace('_', ' ')}, {counts}"


def _skin(textures: list[dict[str, Any]], sampler: Sampler) -> str:
    """Return the number, the sizes and the sampler of textures as text."""
    sizes = Counter(f"{texture['width']} x {texture['height']}" for texture in textures)
    numbers = ", ".join(size if count == 1 else f"{count} of {size}" for size, count in sizes.items())
    wraps = (sampler.wrap_u, sampler.wrap_v)
    words = [sampler.filter, "mip maps" if sampler.mipmaps else "no mip maps"]
    words.append(wraps[0] if wraps[0] == wraps[1] else f"{wraps[0]} along u, {wraps[1]} along v")
    if sampler.alpha_cutoff is not None:
        words.append(f"alpha cutoff {sampler.alpha_cutoff:g}")
    return f"{numbers}; {', '.join(words)}"


def _background(manifest: Manifest) -> str:
    from msb.scenes.datasets import color_name, default_background, stated_background

    name = color_name(default_background(manifest))
    return name if stated_background(manifest) else f"{name} (not stated by the asset)"


def _training(manifest: Manifest) -> str:
    """Return the properties of the training as text."""
    texts = {name: f"{name} {value}" for name, value in manifest.training.items() if name != "eval"}
    if (held_out := manifest.training.get("eval")) is not None:
        texts["eval"] = "test views held out" if held_out else "the training also used the test views"
    return ", ".join(texts.values())


def _tier(manifest: Manifest, tier: Tier) -> str:
    from msb.asset.texture import KIND
    from msb.asset.tiers import why_not
    from msb.registry import lookup

    why = why_not(manifest, tier)
    if why is not None:
        return f"not supported: {why}"
    known = {} if manifest.appearance["kind"] == KIND else lookup(manifest.method).passes
    passes = known or manifest.required_passes
    return ", ".join(passes.get(tier, ("opaque_unlit",)))


def _in_scene(point: tuple[float, float, float], manifest: Manifest) -> list[float]:
    return [value + start for value, start in zip(point, manifest.origin, strict=True)]


def _point(point: tuple[float, float, float], manifest: Manifest) -> str:
    digits = 10 if any(manifest.origin) else 5
    return "(" + ", ".join(f"{value:.{digits}g}" for value in _in_scene(point, manifest)) + ")"


def _parameters(values: dict[str, Any]) -> str:
    first, *rest = values.items()
    extra = ", ".join(f"{key} {value}" for key, value in rest)
    return f"{first[1]} ({extra})" if extra else str(first[1])
