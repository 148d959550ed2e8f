"""Tests that need torch run in a separate session."""

from pathlib import Path

import pytest


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Collect the comparison with torch only in the session of the mark `torch`."""
    ours = collection_path.name == "test_against_torch.py"
    return True if ours and config.option.markexpr != "torch" else None
