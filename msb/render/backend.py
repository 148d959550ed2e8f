"""The interface of a renderer, and functions that find a renderer by its tier or by its name."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from inspect import Parameter, signature
from typing import TYPE_CHECKING, Any, Literal, Protocol

from msb.asset.tiers import refusal
from msb.base.packages import PackageError, contain_errors, describe_entry, find_installed, load
from msb.errors import DeviceError, Unsupported, UsageError, shorten
from msb.registry import TIERS

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.render.frame import Frame
    from msb.scenes import Camera

Factory = Callable[..., "Backend"]

# Maps each renderer tier to its built-in renderer.
BUILT_IN = {
    "standard": "msb.render.standard.renderer:StandardRenderer",
    "dedicated": "msb.render.dedicated:dedicated_renderer",
    "reference": "msb.reference:ReferenceRenderer",
}
# Renderer tiers whose built-in renderer needs an OpenCL device.
ON_OPENCL = ("standard", "dedicated")
# The renderer class for each engine that msb does not implement itself.
ENGINES = {
    "wgpu": "msb.engines.webgpu:WgpuRenderer",
    "threejs": "msb.engines.threejs:ThreeJsRenderer",
    "blender_cycles": "msb.engines.blender:CyclesRenderer",
    "blender_workbench": "msb.engines.blender:WorkbenchRenderer",
}

# The purpose of device memory: the mesh, its colours, intermediate results of a frame, or the images of a
# frame.
Group = Literal["geometry", "appearance", "scratch", "targets"]

# A renderer may reorganise its data before it draws the frame with this number. From this frame on, the
# memory of a frame depends on its camera, not on the number of earlier frames. Benchmarks measure frame times
# from this frame.
SETTLED_AT = 3


@dataclass(frozen=True)
class DrawTime:
    """The time that a frame took on the device, in milliseconds."""

    # Run time of the commands of each stage. The sum over stages is the time during which the device was
    # busy.
    stages: Mapping[str, float]
    # Time from the start of the first command to the end of the last command.
    span: float
    # Time from queueing the first command to the end of the last command; None if it is unknown.
    since_queued: float | None = None


class Backend(Protocol):
    """A renderer that holds one asset and draws it.

    A renderer is created as ``Class(asset, device=None, settings={})``. `device` selects where to compute: a
    selector ("cpu", "gpu", "pocl:0") or an open device. A renderer that cannot choose a device ignores
    `device`. `settings` override settings of the asset.

    A renderer may also have the following members:

    - The attribute `device_info`: a mapping with `platform`, `name` and `kind` ("cpu" or "gpu") of the
      drawing device. Renderers that do not draw on an OpenCL device need this attribute.

    - The class attribute `tiers`: the tiers that the class draws. The default is all tiers.

    - The class method `of_tier(tier)`: returns the class that draws a tier, if tiers have different classes.

    - The class method `missing()`: returns the name of missing software, or None. The call must be quick.

    - The class method `installed()`: returns the version string without starting the engine. Implement
      `installed` if `version` is known only after the first frame, because `msb run` renders images again
      when the version changes.

    - The method `memory_groups()`: returns the `Group` of each purpose in `memory()`. Purposes without an
      entry count as scratch memory.
    """

    name: str
    """The name of the renderer in reports."""
    version: str
    """The version of the drawing software; results of different versions are never mixed."""

    def render(self, camera: Camera, background: tuple[float, float, float]) -> Frame:
        """Draw the asset from `camera` over `background` (RGB)."""

    def draw(self, camera: Camera, background: tuple[float, float, float]) -> DrawTime:
        """Draw a frame and wait until it is complete, without reading it back. Benchmarks time this."""

    def memory(self) -> Mapping[str, int]:
        """Return the bytes of device memory for this asset by purpose.

        If the renderer cannot count these bytes, return an empty mapping.
        """

    def close(self) -> None:
        """Release all memory. A second call of `close` has no effect."""


def find_renderer(name: str) -> Factory:
    """Return the class of renderer `name`. The name is a tier or an entry point of the group
    `msb.renderers`."""
    with attribute_errors(name):
        return _factory(name)


def _factory(name: str) -> Factory:
    # Built-in renderers cannot be replaced, so entry points with their names are ignored.
    if is_ours(name):
        module, _, attribute = {**BUILT_IN, **ENGINES}[name].partition(":")
        return getattr(import_module(module), attribute)  # type: ignore[no-any-return]
    place = renderers().get(name)
    if place is None:
        text = f'renderer "{shorten(name, 40)}" does not exist; choose one of {", ".join(renderers())}'
        raise UsageError("NAME_UNKNOWN", text)
    make: Any = load(place)
    if not callable(make):
        raise PackageError(
            f"the entry point is not a renderer class, but an object of type {type(make).__name__}"
        )
    if isinstance(make, type):
        _check_contract(make, ("render", "memory", "close"))
    return make  # type: ignore[no-any-return]


def _check_contract(renderer: Any, members: tuple[str, ...]) -> None:
    """Raise an error if `renderer` lacks one of the `members` of `Backend`."""
    if lacking := [member for member in members if not hasattr(renderer, member)]:
        raise PackageError(f"the class is not a renderer: the member {', '.join(lacking)} is missing")


def make_backend(factory: Factory, name: str, asset: Asset, **options: Any) -> Backend:
    """Create the renderer `name` for an asset by calling its `factory`."""
    with attribute_errors(name):
        backend = factory(asset, **options)
        _check_contract(backend, ("name", "version", "render", "memory", "close"))
        return backend


@contextmanager
def attribute_errors(name: str) -> Iterator[None]:
    """Run code of renderer `name`. If the renderer is from another package, its errors become ENGINE_FAILED
    with its name."""
    if is_ours(name):
        yield
        return
    try:
        with contain_errors():
            yield
    except PackageError as error:
        text = f"{describe_entry('renderer', name, renderers().get(name, ''))}: {error}"
        raise DeviceError("ENGINE_FAILED", text) from error.__cause__


def is_ours(name: str) -> bool:
    """Return whether a renderer is part of this package."""
    return name in BUILT_IN or name in ENGINES


@cache
def renderers() -> dict[str, str]:
    """Return "module:Class" of each renderer by name: first built-in renderers, then engines, then entry
    points.

    Nothing is imported.
    """
    ours = {**BUILT_IN, **ENGINES}
    others = find_installed("renderer", ours, lambda _, value: value, pattern=None)
    return ours | {name: value for name, (value, _) in others.items()}


def why_unavailable(name: str) -> str | None:
    """Return why the renderer `name` cannot draw on this machine (missing software or an error), or None if
    it can."""
    try:
        with contain_errors():
            factory = _factory(name)
            missing: Callable[[], str | None] | None = getattr(factory, "missing", None)
            reason = None if missing is None else missing()
            return str(reason) if reason else None
    except PackageError as error:
        return str(error)


def check_supported(asset: Asset, tier: str) -> None:
    """Raise an error if the asset's method does not support the renderer tier."""
    if tier not in TIERS:
        text = f'tier "{shorten(str(tier), 40)}" does not exist; choose one of {", ".join(TIERS)}'
        raise UsageError("USAGE", text)
    reason = refusal(asset.manifest, tier)
    if reason is not None:
        raise Unsupported("UNSUPPORTED_TIER", reason, file=asset.opened_from)


def class_for(asset: Asset, tier: str, name: str | None, options: Mapping[str, Any]) -> Factory:
    """Return the class that draws an asset on a renderer tier.

    The class is the built-in class, or the class of the renderer `name`.

    Check a tier and its options. The method must support the tier, the renderer must draw it, and the class
    must accept the options.
    """
    check_supported(asset, tier)
    make = find_renderer(name or tier)
    with attribute_errors(name or tier):
        drawn = getattr(make, "tiers", TIERS)
        if tier not in drawn:
            raise UsageError("USAGE", f"renderer {name} cannot draw tier {tier}, only {', '.join(drawn)}")
        if (name or tier) == "dedicated":
            from msb.render.dedicated import pipeline_of

            make = pipeline_of(asset)
        elif hasattr(make, "of_tier"):
            make = make.of_tier(tier)
        _check_options(make, options, asset, f"renderer {name}" if name else f"tier {tier}")
    return make


def _check_options(make: Factory, options: Mapping[str, Any], asset: Asset, name: str) -> None:
    """Raise an error if the constructor of a class does not accept one of the `options`."""
    parameters = signature(make).parameters.values()
    if any(parameter.kind is Parameter.VAR_KEYWORD for parameter in parameters):
        return
    known = {parameter.name for parameter in parameters} - {"asset", "device", "settings"}
    for option in options:
        if option not in known:
            text = f'{asset.manifest.method} on {name}: option "{shorten(option, 40)}" does not exist; '
            text += f"available options: {', '.join(sorted(known)) or 'none'}"
            text += _ELSEWHERE.get(option, "")
            raise Unsupported("UNSUPPORTED_OPTION", text, file=asset.opened_from)


# Maps an option to a hint at the tiers that accept the option.
_ELSEWHERE = {
    **dict.fromkeys(("order", "sampling"), "; use it with tier dedicated or reference"),
    "supersample": "; use it with tier standard",
}


def minimal_options(tier: str, renderer: str | None, *, ids: bool = False) -> dict[str, Any]:
    """Return options that limit the built-in renderer of `tier` to the needed outputs.

    A command that writes only colours needs no normals and no median depths. Pass `ids` to include the face
    ids.
    """
    if tier != "dedicated" or renderer is not None:
        return {}
    return {"outputs": ("face_id",) if ids else ()}
