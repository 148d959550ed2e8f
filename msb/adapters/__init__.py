"""From what the methods' training writes to assets; torch is needed for none of it."""

from __future__ import annotations
