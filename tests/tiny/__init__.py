"""Tiny scenes, a model of each method for them, and the protocol that runs them, for tests."""

from __future__ import annotations

from pathlib import Path

TINY = Path(__file__).parent
SCENES = TINY / "scenes"
MODELS = TINY / "models"
