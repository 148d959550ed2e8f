"""Engines that are installed."""

from __future__ import annotations

import pytest

from msb.render.backend import what_is_missing


def need(name: str) -> str:
    """Return `name`, or skip what needs the renderer."""
    missing = what_is_missing(name)
    if missing is not None:
        pytest.skip(f"renderer {name}: {missing}")
    return name
