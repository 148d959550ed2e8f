"""Tests of msb.reference."""

from __future__ import annotations
