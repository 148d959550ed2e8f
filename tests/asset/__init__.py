"""Tests of msb.asset."""

from __future__ import annotations
