"""Settings of a method: values in an asset, overrides in a call, and assignments on a command line."""

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from msb.asset.asset import Asset
from msb.asset.manifest import Manifest, StoredSetting
from msb.errors import UsageError, shorten
from msb.registry import ORDERS, SAMPLINGS, SettingValue, lookup

_BOOLS = {"true": True, "yes": True, "on": True, "1": True}
_BOOLS |= {"false": False, "no": False, "off": False, "0": False}


def effective_settings(manifest: Manifest, overrides: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return all settings of the asset's method: the override, otherwise the stored value or the default."""
    method = lookup(manifest.method)
    overrides = check_overrides(manifest.method, overrides or {})
    degree = overrides.get("sh_degree")
    if isinstance(degree, int) and degree > manifest.sh_degree:
        text = f"the setting sh_degree is {degree}; the asset only stores degree {manifest.sh_degree}"
        raise UsageError("SETTING_VALUE", text)
    values = {name: setting.default for name, setting in method.settings.items()}
    if "sh_degree" in values:
        values["sh_degree"] = manifest.sh_degree
    values.update({name: stored.value for name, stored in manifest.settings.items()})
    return {**values, **overrides}


def with_settings(asset: Asset, overrides: Mapping[str, Any]) -> Asset:
    """Return a copy of `asset` that stores `overrides` as its settings."""
    values = effective_settings(asset.manifest, overrides)
    stored = {name: StoredSetting(values[name], "flag") for name in overrides}
    return replace(asset, manifest=replace(asset.manifest, settings={**asset.manifest.settings, **stored}))


def check_overrides(method: str, overrides: Mapping[str, Any]) -> dict[str, SettingValue]:
    """Return `overrides` if all names and values are valid for `method`.

    Raises
    ------
    UsageError
        SETTING_UNKNOWN or SETTING_VALUE.
    """
    known = lookup(method).settings
    for name, value in overrides.items():
        if name not in known:
            valid = ", ".join(known) or "none"
            near = difflib.get_close_matches(str(name), known, 1)
            text = f'{method} has no setting "{shorten(str(name), 40)}"; its settings: {valid}'
            text += f"; did you mean {near[0]}?" if near else ""
            raise UsageError("SETTING_UNKNOWN", text)
        if problem := known[name].problem(value):
            text = f"the setting {name} is {shorten(repr(value), 40)}; it {problem}"
            raise UsageError("SETTING_VALUE", text)
    return dict(overrides)


def check_modes(order: str, sampling: str) -> None:
    """Check that the order and the sampling of native rendering are known."""
    for what, value, known in (("order", order, ORDERS), ("sampling", sampling, SAMPLINGS)):
        if value not in known:
            text = f'the {what} "{shorten(str(value), 40)}" is unknown; use one of {", ".join(known)}'
            raise UsageError("USAGE", text)


def parse_overrides(method: str, assignments: Iterable[str]) -> dict[str, SettingValue]:
    """Return the settings of texts such as ``gamma=20`` or ``ste_threshold=none``."""
    known = lookup(method).settings
    values: dict[str, Any] = {}
    for text in assignments:
        name, equals, value = text.partition("=")
        if not equals:
            raise UsageError("USAGE", f'--set needs NAME=VALUE; "{shorten(text, 40)}" has no "="')
        name = name.strip()
        values[name] = _parse(known[name].kind, value.strip()) if name in known else value
    return check_overrides(method, values)


def _parse(kind: str, text: str) -> SettingValue:
    """Return the value of `text`, or `text` itself if it is invalid. `check_overrides` will report an
    invalid text."""
    if text.lower() in ("none", "null"):
        return None
    if kind == "bool":
        return _BOOLS.get(text.lower(), text)
    if kind in ("int", "float"):
        try:
            return int(text) if kind == "int" else float(text)
        except ValueError:
            return text
    return text
