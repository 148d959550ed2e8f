"""Adapters turn what the methods' training writes into assets; none of them needs torch."""

from __future__ import annotations

from msb.adapters.exporter import export, read_model
from msb.adapters.locate import is_checkpoint

__all__ = ["export", "is_checkpoint", "read_model"]
