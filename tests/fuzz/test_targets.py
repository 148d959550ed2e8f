"""Every fuzz target with seeds and mutations: a value or our error, in a process that may do no harm."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from fuzz.targets import TARGETS
from tests.conftest import ROOT

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="memory is capped as Linux does it")


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the driver in the root of the repository, where the package `fuzz` is."""
    command = [sys.executable, "-m", "tests.fuzz.guarded_driver", *arguments]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.run(
        command, capture_output=True, text=True, timeout=120, env=environment, cwd=ROOT, check=False
    )


def test_every_target_survives_its_seeds_and_mutations_of_them(tmp_path: Path) -> None:
    done = run(str(tmp_path), *TARGETS)
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout.startswith(f"{len(TARGETS)} targets, ")  # and nothing was printed by a library


@pytest.mark.parametrize("deed", ["exec", "write", "child", "socket", "memory", "slow", "error"])
def test_the_guard_sees(deed: str, tmp_path: Path) -> None:
    """A target that does what none may do is found out: the test above can fail."""
    done = run(str(tmp_path), deed)
    assert done.returncode != 0
    wanted = {
        "exec": "exec of code from '<input>'",
        "write": "opened for writing",
        "child": "forbidden: subprocess.Popen",
        "socket": "forbidden: socket.",
        "memory": "MemoryError",
        "slow": "s of processor time",
        "error": "KeyError",
    }
    assert wanted[deed] in done.stderr
