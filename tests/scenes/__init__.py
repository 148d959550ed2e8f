"""Tests of msb.scenes."""

from __future__ import annotations
