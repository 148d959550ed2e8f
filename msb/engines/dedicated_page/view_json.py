"""What web/dedicated.js fills the camera record with, as JSON, and which settings change it alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np

from msb.asset.settings import effective_settings
from msb.engines.hardware.packing import VIEW, model_of
from msb.errors import MsbError
from msb.registry import lookup

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.engines.hardware.packing import Packed
    from msb.render.splat.model import Model
    from msb.render.surface import Surface

_TYPES = {"f": "f32", "i": "i32", "u": "u32"}


def view_json(packed: Packed) -> dict[str, Any]:
    """Return what the camera record is filled with, and where.

    `members` has name, type, count and byte offset of each member, the method's own last, whose values are
    `own`; `near` and `far` are the planes of the official projection.
    """
    model = packed.model
    members: list[list[Any]] = []
    for name in VIEW.names or ():
        dtype, offset = VIEW.fields[name][:2]  # type: ignore[index]
        count = int(np.prod(dtype.shape, dtype=int))
        members.append([name, _TYPES[dtype.base.kind], count, offset])
    offset = VIEW.itemsize
    for name, value in model.own.items():
        members.append([name, _TYPES[value.dtype.kind], 1, offset])
        offset += 4
    return {
        "members": members,
        "bytes": -(-offset // 16) * 16,
        "near": model.near,
        "far": model.far,
        "degree": packed.degree,
        "own": {name: value.item() for name, value in model.own.items()},
    }


def live_settings(asset: Asset, settings: Mapping[str, Any], model: Model | Surface) -> list[dict[str, Any]]:
    """Return the settings of the method that change nothing but the camera record.

    Each has its `name`, its `value` and `options`: a value, and the record's members with it.
    """
    found = []
    values = effective_settings(asset.manifest, settings)
    for name, setting in lookup(asset.manifest.method).settings.items():
        choices = {"bool": (False, True), "choice": setting.choices}.get(setting.kind, ())
        options = []
        for choice in choices:
            try:
                other = model_of(asset, {**values, name: choice})
            except MsbError:
                break
            if not _alike(model, other):
                break
            options.append({"value": choice, "own": {key: value.item() for key, value in other.own.items()}})
        if len(options) == len(choices) > 1:
            found.append({"name": name, "value": values[name], "options": options})
    return found


def _alike(model: Model | Surface, other: Model | Surface) -> bool:
    """Return whether two models differ in the method's own members of the record at most."""
    for name in (field.name for field in fields(model)):
        one, two = getattr(model, name), getattr(other, name)
        if name == "projection":
            continue  # the page computes it, of the camera and `own`
        if name == "own":
            one, two = set(one), set(two)
        if not (np.array_equal(one, two) if isinstance(one, np.ndarray) else one == two):
            return False
    return True
