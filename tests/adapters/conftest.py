"""What imports torch is left to the session that has it."""

from pathlib import Path

import pytest


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Say that the module which compares with torch is none of an ordinary session's."""
    ours = collection_path.name == "test_against_torch.py"
    return True if ours and config.option.markexpr != "torch" else None
