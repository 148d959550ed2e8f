"""The contract of a renderer, and how a renderer is found: by tier, or by the name of an entry point."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from inspect import Parameter, signature
from typing import TYPE_CHECKING, Any, Literal, Protocol

from msb.asset.tiers import refusal
from msb.base.packages import PackageError, contained, installed, load, whose
from msb.errors import DeviceError, Unsupported, UsageError, shorten
from msb.registry import TIERS

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.render.frame import Frame
    from msb.scenes import Camera

Factory = Callable[..., "Backend"]

# Tier -> our renderer of it.
BUILT_IN = {
    "standard": "msb.render.standard.renderer:StandardRenderer",
    "dedicated": "msb.render.dedicated:dedicated_renderer",
    "reference": "msb.reference:ReferenceRenderer",
}
# The tiers whose renderer needs an OpenCL device.
ON_OPENCL = ("standard", "dedicated")
# Name -> the renderer that drives a foreign engine.
ENGINES = {
    "wgpu": "msb.engines.webgpu:WgpuRenderer",
    "threejs": "msb.engines.threejs:ThreeJsRenderer",
    "blender_cycles": "msb.engines.blender:CyclesRenderer",
    "blender_workbench": "msb.engines.blender:WorkbenchRenderer",
}

# The use of device memory: the mesh, its colours, intermediate results of a frame, or its images.
Group = Literal["geometry", "appearance", "scratch", "targets"]

# The number of the frame after which a renderer no longer reorganises what it keeps.
#
# From that frame on its memory depends on which cameras it has drawn, not on the number of frames.
SETTLED_AT = 3


@dataclass(frozen=True)
class Drawn:
    """The time that a frame took on the device, in milliseconds."""

    # Stage -> the time for which its commands ran. Their sum is the time for which the device was busy.
    stages: Mapping[str, float]
    # From the start of the first command to the end of the last one.
    span: float
    # From when the first command was queued to the end of the last one; None if unknown.
    since_queued: float | None = None


class Backend(Protocol):
    """A renderer that holds one asset and draws it.

    A renderer is made as ``Class(asset, device=None, settings={})``. `device` is where to compute: a selector
    ("cpu", "gpu", "pocl:0") or an open device; a renderer without a choice ignores it. `settings` override
    those that the asset stores.

    A renderer may have these members as well:

    - The attribute `device_info` is a mapping with `platform`, `name` and `kind` ("cpu" or "gpu"). It
      describes what draws if that is no OpenCL device.
    - The class attribute `tiers` lists the tiers that the class draws. Without it, it draws all of them.
    - The class method `of_tier(tier)` returns the class that draws a tier, where that is another one.
    - The class method `missing()` returns what must be installed first, or None. It must be quick.
    - The class method `installed()` returns the version string without starting the engine. A renderer whose
      `version` is known only after its first frame needs it, because `msb run` draws again when it changes.
    - The method `memory_groups()` returns a mapping from each use that `memory()` names to its `Group`. A use
      that it does not name counts as scratch.
    """

    name: str
    """The name of the renderer in reports."""
    version: str
    """The version of what draws; results of different versions are not mixed."""

    def render(self, camera: Camera, background: tuple[float, float, float]) -> Frame:
        """Draw the asset from `camera` over `background`."""

    def draw(self, camera: Camera, background: tuple[float, float, float]) -> Drawn:
        """Draw and wait until the frame is complete, but read nothing back. Benchmarks time this."""

    def memory(self) -> Mapping[str, int]:
        """Return use -> bytes held for this asset; an empty mapping if the renderer cannot know them."""

    def close(self) -> None:
        """Release everything. A second call does nothing."""


def find_renderer(name: str) -> Factory:
    """Return the class of the renderer `name`, which is a tier or an entry point of group `msb.renderers`."""
    with blaming(name):
        return _factory(name)


def _factory(name: str) -> Factory:
    if is_ours(name):  # no package replaces it, so none is looked for
        module, _, attribute = {**BUILT_IN, **ENGINES}[name].partition(":")
        return getattr(import_module(module), attribute)  # type: ignore[no-any-return]
    place = renderers().get(name)
    if place is None:
        text = f'there is no renderer "{shorten(name, 40)}"; there are {", ".join(renderers())}'
        raise UsageError("NAME_UNKNOWN", text)
    make: Any = load(place)
    if not callable(make):
        raise PackageError(f"it is no class of a renderer, but of type {type(make).__name__}")
    if isinstance(make, type):
        _check_contract(make, ("render", "memory", "close"))
    return make  # type: ignore[no-any-return]


def _check_contract(renderer: Any, members: tuple[str, ...]) -> None:
    """Refuse what lacks a member of `Backend`."""
    if lacking := [member for member in members if not hasattr(renderer, member)]:
        raise PackageError(f"it is no renderer: it has no {', '.join(lacking)}")


def make_backend(factory: Factory, name: str, asset: Asset, **options: Any) -> Backend:
    """Return the renderer `name` with an asset, the work of `factory`."""
    with blaming(name):
        made = factory(asset, **options)
        _check_contract(made, ("name", "version", "render", "memory", "close"))
        return made


@contextmanager
def blaming(name: str) -> Iterator[None]:
    """Run code of the renderer `name`; what that of a package does wrong is `ENGINE_FAILED`, and names it."""
    if is_ours(name):
        yield
        return
    try:
        with contained():
            yield
    except PackageError as error:
        text = f"{whose('renderer', name, renderers().get(name, ''))}: {error}"
        raise DeviceError("ENGINE_FAILED", text) from error.__cause__


def is_ours(name: str) -> bool:
    """Return whether a renderer is part of msb."""
    return name in BUILT_IN or name in ENGINES


@cache
def renderers() -> dict[str, str]:
    """Return name -> "module:Class": ours first, then engines, then others. Nothing is imported."""
    ours = {**BUILT_IN, **ENGINES}
    others = installed("renderer", ours, lambda _, value: value, pattern=None)
    return ours | {name: value for name, (value, _) in others.items()}


def what_is_missing(name: str) -> str | None:
    """Return what is missing before the renderer `name` can draw, or what is wrong with it; else None."""
    try:
        with contained():
            factory = _factory(name)
            missing: Callable[[], str | None] | None = getattr(factory, "missing", None)
            reason = None if missing is None else missing()
            return str(reason) if reason else None
    except PackageError as error:
        return str(error)


def check_supported(asset: Asset, tier: str) -> None:
    """Refuse a tier that the asset's method does not support."""
    if tier not in TIERS:
        text = f'there is no tier "{shorten(str(tier), 40)}"; there are {", ".join(TIERS)}'
        raise UsageError("USAGE", text)
    refused = refusal(asset.manifest, tier)
    if refused is not None:
        raise Unsupported("UNSUPPORTED_TIER", refused, file=asset.opened_from)


def class_for(asset: Asset, tier: str, name: str | None, options: Mapping[str, Any]) -> Factory:
    """Return the class that draws an asset on a tier, ours or the one that renderer `name` has for it.

    This is where a tier and its options are checked: that the method has the tier, the renderer draws it, and
    takes the options.
    """
    check_supported(asset, tier)
    make = find_renderer(name or tier)
    with blaming(name or tier):
        drawn = getattr(make, "tiers", TIERS)
        if tier not in drawn:
            raise UsageError("USAGE", f"renderer {name} draws tier {', '.join(drawn)}, not {tier}")
        if (name or tier) == "dedicated":
            from msb.render.dedicated import pipeline_of

            make = pipeline_of(asset)
        elif hasattr(make, "of_tier"):
            make = make.of_tier(tier)
        _check_options(make, options, asset, f"renderer {name}" if name else f"tier {tier}")
    return make


def _check_options(make: Factory, options: Mapping[str, Any], asset: Asset, name: str) -> None:
    """Refuse options that a class has no keyword for."""
    parameters = signature(make).parameters.values()
    if any(parameter.kind is Parameter.VAR_KEYWORD for parameter in parameters):
        return
    known = {parameter.name for parameter in parameters} - {"asset", "device", "settings"}
    for option in options:
        if option not in known:
            text = f'{asset.manifest.method} on {name}: there is no option "{shorten(option, 40)}"; '
            text += f"there are {', '.join(sorted(known))}" if known else "there are none"
            text += _ELSEWHERE.get(option, "")
            raise Unsupported("UNSUPPORTED_OPTION", text, file=asset.opened_from)


# Option -> where it is one.
_ELSEWHERE = {
    **dict.fromkeys(("order", "sampling"), "; the tiers dedicated and reference have it"),
    "supersample": "; the tier standard has it",
}


def lean_options(tier: str, renderer: str | None, *, ids: bool = False) -> dict[str, Any]:
    """Return the options with which our renderer of `tier` computes only what a command writes."""
    if tier != "dedicated" or renderer is not None:
        return {}
    return {"outputs": ("face_id",) if ids else ()}
