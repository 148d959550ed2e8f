"""MeshSplatBench: decide whether a trained triangle or mesh splatting model is a usable graphics asset.

This package exports the public API. Public names are imported at their first use, so that `import msb`
takes milliseconds.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from msb.base.version import __version__

if TYPE_CHECKING:
    from msb import metrics
    from msb.adapters.exporter import export
    from msb.api.auditing import audit
    from msb.api.opening import open
    from msb.api.validating import validate
    from msb.asset import Asset, Validation, load
    from msb.bake import Baked, bake
    from msb.delivery.converting import convert
    from msb.delivery.saving import save
    from msb.errors import MsbError, Unsupported
    from msb.render import Frame, Renderer, render
    from msb.repair import Repaired, repair
    from msb.scenes import Camera, read_cameras
    from msb.topology import Audit
    from msb.trial import trial
    from msb.why import why
    from msb_viewers.deployment.comparing import compare

_HOME = {
    "Asset": "msb.asset",
    "Validation": "msb.asset",
    "load": "msb.asset",
    "open": "msb.api.opening",
    "compare": "msb_viewers.deployment.comparing",
    "convert": "msb.delivery.converting",
    "save": "msb.delivery.saving",
    "Baked": "msb.bake",
    "MsbError": "msb.errors",
    "Unsupported": "msb.errors",
    "Camera": "msb.scenes",
    "read_cameras": "msb.scenes",
    "export": "msb.adapters.exporter",
    "Frame": "msb.render",
    "Renderer": "msb.render",
    "Repaired": "msb.repair",
    "Audit": "msb.topology",
    "audit": "msb.api.auditing",
    "validate": "msb.api.validating",
}
# Packages of the public API. All these packages except `metrics` can also be called as functions.
_PACKAGES = ("bake", "metrics", "render", "repair", "trial", "why")

__all__ = [
    "Asset",
    "Audit",
    "Baked",
    "Camera",
    "Frame",
    "MsbError",
    "Renderer",
    "Repaired",
    "Unsupported",
    "Validation",
    "__version__",
    "audit",
    "bake",
    "compare",
    "convert",
    "export",
    "load",
    "metrics",
    "open",
    "read_cameras",
    "render",
    "repair",
    "save",
    "trial",
    "validate",
    "why",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME and name not in _PACKAGES:
        text = f"module 'msb' has no attribute {name!r}"
        raise AttributeError(text)
    if name in _PACKAGES:
        return import_module(f"msb.{name}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
