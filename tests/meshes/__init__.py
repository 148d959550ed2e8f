"""Tests of msb.meshes."""

from __future__ import annotations
