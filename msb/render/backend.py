"""What a renderer is, and how one is found: by tier, or by the name of an entry point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from inspect import Parameter, signature
from typing import TYPE_CHECKING, Any, Literal, Protocol

from msb.asset.tiers import why_not
from msb.errors import Unsupported, UsageError, shorten
from msb.methods import TIERS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from msb.asset import Asset
    from msb.render.frame import Frame
    from msb.scenes import Camera

    Factory = Callable[..., "Backend"]

GROUP = "msb.renderers"
"""Entry-point group of renderers: ``name = "package.module:Class"``."""

BUILT_IN = {
    "standard": "msb.render.standard.renderer:StandardRenderer",
    "dedicated": "msb.render.dedicated:DedicatedRenderer",
    "reference": "msb.reference.renderer:ReferenceRenderer",
}
"""Tier -> our renderer of it; the same stand in pyproject.toml, for those who list entry points."""
ON_OPENCL = ("standard", "dedicated")
"""Those of ours that need an OpenCL device."""
ENGINES = {
    "wgpu": "msb.engines.webgpu:WgpuRenderer",
    "threejs": "msb.engines.threejs:ThreeJsRenderer",
    "blender_cycles": "msb.engines.blender:CyclesRenderer",
    "blender_workbench": "msb.engines.blender:WorkbenchRenderer",
}
"""Name -> a foreign engine that comes with us; in pyproject.toml, too."""

Group = Literal["geometry", "appearance", "scratch", "targets"]
"""What device memory is for: the mesh, its colours, what a frame computes in passing, colour and depth."""

SETTLED_AT = 3
"""The frame from which a renderer has what it keeps in its final form: from then on its memory depends on
which cameras it has drawn, and no more on how many frames."""


@dataclass(frozen=True)
class Drawn:
    """How long a frame took on the device.

    Attributes
    ----------
    stages : mapping of str to float
        Stage -> milliseconds its commands ran; their sum is the time the device was busy.
    span : float
        Milliseconds from when the first command started to when the last one ended.
    """

    stages: Mapping[str, float]
    span: float


class Backend(Protocol):
    """One asset, ready to be drawn.

    Made as ``Class(asset, device=None, settings={})``: `device` says where to compute, by selector ("cpu",
    "gpu", "pocl:0") or as an open device, for renderers that have a choice; `settings` override those the
    asset stores.

    More is used where a renderer has it. `device_info`, a mapping with `platform`, `name` and `kind`
    ("cpu", "gpu"), says what draws if that is no OpenCL device. `tiers`, of the class, lists the tiers it
    draws if that is not all of them. The class method `missing()` says what must be installed first, or
    returns None; it is quick. So does `installed()` return what would draw, as versions, where `version` is
    known only once it draws; `msb run` draws again when that changes. `memory_groups()` returns for each use
    that `memory()` names its `Group`; what it does not name counts as scratch.
    """

    name: str
    """Of the renderer, for reports."""
    version: str

    def render(self, camera: Camera, background: tuple[float, float, float]) -> Frame:
        """Draw the asset from `camera` over `background`."""

    def draw(self, camera: Camera, background: tuple[float, float, float]) -> Drawn:
        """Draw and wait until it is done, but read nothing back: what is timed."""

    def memory(self) -> Mapping[str, int]:
        """Return use -> bytes held for this asset; empty where that cannot be known."""

    def close(self) -> None:
        """Release everything. Twice is harmless."""


def groups_of(backend: Backend) -> Mapping[str, str]:
    """Return use -> group of what a renderer's `memory` names, empty for one that does not say."""
    say: Callable[[], Mapping[str, str]] | None = getattr(backend, "memory_groups", None)
    return {} if say is None else say()


def find_renderer(name: str) -> Factory:
    """Return what makes the renderer `name`: a tier, or an entry point of group `msb.renderers`.

    Raises
    ------
    UsageError
        `RENDERER_UNKNOWN`, listing those there are.
    """
    found = renderers().get(name)
    if found is None:
        text = f'there is no renderer "{shorten(name, 40)}"; there are {", ".join(renderers())}'
        raise UsageError("RENDERER_UNKNOWN", text, value=name)
    module, _, attribute = found.partition(":")
    factory: Any = import_module(module)
    for part in attribute.split("."):
        factory = getattr(factory, part)
    return factory  # type: ignore[no-any-return]


@cache
def renderers() -> dict[str, str]:
    """Return name -> where it is ("module:Class"), ours first, then engines; nothing is imported."""
    others: dict[str, str] = {}
    entry: EntryPoint
    for entry in entry_points(group=GROUP):
        others.setdefault(entry.name, entry.value)
    ours = {**BUILT_IN, **ENGINES}
    return {**ours, **{name: value for name, value in sorted(others.items()) if name not in ours}}


def what_is_missing(name: str) -> str | None:
    """Return what has to be installed before the renderer `name` can draw, None if nothing is known to be.

    Raises
    ------
    UsageError
        `RENDERER_UNKNOWN`.
    """
    try:
        factory = find_renderer(name)
    except (ImportError, AttributeError) as error:  # a third party's may be broken
        return f"it cannot be loaded: {shorten(str(error), 200)}"
    missing: Callable[[], str | None] | None = getattr(factory, "missing", None)
    return None if missing is None else missing()


def check_supported(asset: Asset, tier: str) -> None:
    """Refuse a tier that the asset's method does not support.

    Raises
    ------
    UsageError
        `USAGE`: no such tier.
    Unsupported
        `UNSUPPORTED_TIER` or `UNSUPPORTED_STANDARD`, naming method, tier and reason.
    """
    if tier not in TIERS:
        raise UsageError("USAGE", f'there is no tier "{shorten(tier, 40)}"; there are {", ".join(TIERS)}')
    why = why_not(asset.manifest, tier)
    if why is not None:
        text = f"{asset.manifest.method} on tier {tier}: {why}"
        code = "UNSUPPORTED_STANDARD" if tier == "standard" else "UNSUPPORTED_TIER"
        raise Unsupported(code, text, file=asset.path)


def check_tier(make: Factory, tier: str, name: str) -> None:
    """Refuse a tier that the renderer called `name` in messages does not draw, whatever the method.

    Raises
    ------
    UsageError
        `USAGE`.
    """
    drawn = getattr(make, "tiers", TIERS)
    if tier not in drawn:
        raise UsageError("USAGE", f"{name} draws tier {', '.join(drawn)}, not {tier}")


def check_options(make: Factory, options: Mapping[str, Any], asset: Asset, name: str) -> None:
    """Refuse options that a renderer does not take.

    Parameters
    ----------
    make : callable
        Makes the renderer; one that takes anything is left to see for itself.
    name : str
        Of the tier or renderer, for the message.

    Raises
    ------
    Unsupported
        `UNSUPPORTED_OPTION`.
    """
    parameters = signature(make).parameters.values()
    if any(parameter.kind is Parameter.VAR_KEYWORD for parameter in parameters):
        return
    known = {parameter.name for parameter in parameters} - {"asset", "device", "settings"}
    for option in options:
        if option not in known:
            text = f'{asset.manifest.method} on {name}: there is no option "{shorten(option, 40)}"; '
            text += f"there are {', '.join(sorted(known))}" if known else "there are none"
            if option in ("order", "sampling"):
                text += "; the tiers dedicated and reference have it"
            raise Unsupported("UNSUPPORTED_OPTION", text, file=asset.path, value=option)


def lean_options(tier: str, renderer: str | None, *, ids: bool = False) -> dict[str, Any]:
    """Return the options with which our renderer of `tier` computes no more than is written."""
    if tier != "dedicated" or renderer is not None:
        return {}
    return {"outputs": ("face_id",) if ids else ()}
