"""What the cross-check tests share."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from msb.topology.crosscheck import children


@pytest.fixture
def child(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Let every child process run a Python program of the test's own; `folder` is the mesh's folder."""

    def become(code: str) -> None:
        def command(peer: str, folder: Path) -> list[str]:
            start = f"from pathlib import Path; peer = {peer!r}; folder = Path({str(folder)!r})"
            return [sys.executable, "-c", f"{start}\n{code}"]

        monkeypatch.setattr(children, "command", command)

    return become
