"""Adapters turn what the methods' training writes into assets; none of them needs torch."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msb.base.lazy import make_lazy

if TYPE_CHECKING:
    from msb.adapters.exporter import export, read_model
    from msb.adapters.locate import is_checkpoint

__all__ = ["export", "is_checkpoint", "read_model"]

make_lazy(
    __name__,
    {
        "export": "msb.adapters.exporter",
        "is_checkpoint": "msb.adapters.locate",
        "read_model": "msb.adapters.exporter",
    },
)
