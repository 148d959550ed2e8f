"""What a renderer is, and how one is found: by tier, or by the name of an entry point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any, Protocol

from msb.errors import Unsupported, UsageError, shorten
from msb.methods import METHODS, TIERS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from msb.asset import Asset
    from msb.render.frame import Frame
    from msb.scenes import Camera

    Factory = Callable[..., "Backend"]

GROUP = "msb.renderers"
"""Entry-point group of renderers: ``name = "package.module:Class"``."""

BUILT_IN = {
    "standard": "msb.render.standard:StandardRenderer",
    "dedicated": "msb.render.dedicated:DedicatedRenderer",
    "reference": "msb.reference.renderer:ReferenceRenderer",
}
"""Tier -> our renderer of it; the same stand in pyproject.toml, for those who list entry points."""


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
    """Return name -> where it is ("module:Class"), ours first; nothing is imported."""
    others: dict[str, str] = {}
    entry: EntryPoint
    for entry in entry_points(group=GROUP):
        others.setdefault(entry.name, entry.value)
    return {**BUILT_IN, **{name: value for name, value in sorted(others.items()) if name not in BUILT_IN}}


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
    why = METHODS[asset.manifest.method].unsupported.get(tier)
    if why is not None:
        text = f"{asset.manifest.method} on tier {tier}: {why}"
        code = "UNSUPPORTED_STANDARD" if tier == "standard" else "UNSUPPORTED_TIER"
        raise Unsupported(code, text, file=asset.path)
