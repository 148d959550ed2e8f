"""Collect a method's settings, each with its source; a flag replaces the value that the files give."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msb.asset.manifest import StoredSetting
from msb.asset.settings import check_overrides
from msb.errors import CheckpointError, UsageError, shorten
from msb.registry import METHODS

if TYPE_CHECKING:
    from msb.registry import SettingSource


class Settings:
    """The settings of one model while they are collected.

    Parameters
    ----------
    method : str
        The method's name in `METHODS`.
    flags : mapping
        The settings that the user gave; a name or value that the method does not have is a `UsageError`.
    """

    def __init__(self, method: str, flags: Mapping[str, Any]) -> None:
        self._known = METHODS[method].settings
        self._flags = check_overrides(method, flags)
        self._found: dict[str, StoredSetting] = {}

    def add(
        self, name: str, value: Any, source: SettingSource, file: Path | None = None, key: str | None = None
    ) -> None:
        """Take `value` for setting `name`, as found in `file` under `key`, unless a flag sets it."""
        if name in self._flags:
            return
        if not isinstance(value, bool | int | float | str | None):
            value = f"a {type(value).__name__}"
        if problem := self._known[name].problem(value):
            code = "CHECKPOINT_CONFIG" if source == "config" else "CHECKPOINT_LAYOUT"
            text = f"{key or name} is {shorten(repr(value), 40)}; it {problem}"
            raise CheckpointError(code, text, file=file, pointer=key or name)
        self._found[name] = StoredSetting(value, source)

    def finish(self, degree: int | None = None) -> dict[str, StoredSetting]:
        """Return all settings, in the method's order; `degree` is the stored SH degree."""
        wanted = self._flags.get("sh_degree")
        if isinstance(wanted, int) and degree is not None and wanted > degree:
            text = f"setting sh_degree is {wanted}; the checkpoint stores degree {degree} only"
            raise UsageError("SETTING_VALUE", text)
        settings = {}
        for name, setting in self._known.items():
            default = setting.default if name != "sh_degree" else degree
            settings[name] = self._found.get(name, StoredSetting(default, "default"))
            if name in self._flags:
                settings[name] = StoredSetting(self._flags[name], "flag")
        return settings
