"""From what the methods' training writes to assets; torch is needed for none of it."""

from __future__ import annotations

from msb.adapters.exporter import export, read_model
from msb.adapters.locate import is_checkpoint

__all__ = ["export", "is_checkpoint", "read_model"]
