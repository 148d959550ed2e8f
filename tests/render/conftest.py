"""Devices for the tests of renderers."""

from __future__ import annotations

from tests.cl.conftest import device, fresh, styled

__all__ = ["device", "fresh", "styled"]
