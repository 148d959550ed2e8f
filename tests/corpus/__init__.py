"""Files that tests feed to readers, made by kept scripts."""

from __future__ import annotations
