"""The command line as its users meet it: a child process with its exit status and two streams."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import pytest

from tests.cli.forks import run_msb
from tests.conftest import ROOT

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True)
class Result:
    """What a command left behind."""

    status: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """The one JSON document on standard output."""
        return json.loads(self.out, parse_constant=lambda name: pytest.fail(f"bare {name} in JSON"))


class Msb(Protocol):
    """Run a command: ``msb("audit", path)``."""

    def __call__(self, *args: object, cwd: Path = ROOT, **env: str) -> Result: ...


@pytest.fixture(scope="session")
def msb() -> Msb:
    """Return a function that runs `msb` with the given arguments."""

    def run(*args: object, cwd: Path = ROOT, **env: str) -> Result:
        clean = dict.fromkeys(("NO_COLOR", "FORCE_COLOR", "COLUMNS"))
        done = run_msb([*map(str, args)], cwd, {**clean, **env})
        return Result(done.returncode, done.stdout.decode(), done.stderr.decode())

    return run
