"""Tests of what reads trained checkpoints."""

from __future__ import annotations
