"""Given hostile bytes, all readers return a value or raise our error. They run in a guarded process."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from fuzz.targets import TARGETS
from tests.conftest import ROOT
from tests.fuzz.corpora import write_all

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the memory limit needs Linux")
STUCK = 1800
"""Limit of wall time in seconds, for a process that hangs without using processor time."""


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run the driver in the root of the repository, which contains the package `fuzz`."""
    command = [sys.executable, "-m", "tests.fuzz.guarded_driver", *arguments]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.run(
        command, capture_output=True, text=True, timeout=STUCK, env=environment, cwd=ROOT, check=False
    )


@pytest.mark.slow
def test_every_target_survives_its_seeds_and_their_mutations(tmp_path: Path) -> None:
    done = run(tmp_path, *TARGETS)
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout.startswith(f"{len(TARGETS)} targets, ")  # libraries print nothing


@pytest.mark.slow
def test_reading_bad_files_runs_no_code_opens_no_other_file_and_needs_little_memory(tmp_path: Path) -> None:
    count = write_all(tmp_path / "corpora")
    done = run(tmp_path / "corpora", "corpora")
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout == f"{count} files\n"


@pytest.mark.slow
@pytest.mark.parametrize("action", ["exec", "write", "child", "socket", "memory", "slow", "error"])
def test_the_guard_detects(action: str, tmp_path: Path) -> None:
    """The guard detects forbidden actions of a target. Otherwise the test of all targets could not fail."""
    done = run(tmp_path, action)
    assert done.returncode != 0
    messages = {
        "exec": "exec of code from '<input>'",
        "write": "opened for writing",
        "child": "forbidden: subprocess.Popen",
        "socket": "forbidden: socket.",
        "memory": "MemoryError",
        "slow": "s of processor time",
        "error": "KeyError",
    }
    assert messages[action] in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("action", "event"), [("import", "import ('this'"), ("read", "beside' opened"), ("compile", "compile (")]
)
def test_the_closed_guard_detects(action: str, event: str, tmp_path: Path) -> None:
    path = str(tmp_path / "x")
    (tmp_path / "index.json").write_text(json.dumps([[action, path, path, "x"]]))
    done = run(tmp_path, "corpora")
    assert done.returncode != 0
    assert f"forbidden: {event}" in done.stderr or f"{event} with mode" in done.stderr


# --- prefixes

PREFIXES = {
    "triasset": {"TRIASSET_DAMAGED", "FILE_NOT_RECOGNISED"},
    "checkpoint": {"CHECKPOINT_DAMAGED", "CHECKPOINT_NOT_RECOGNISED"},
    **dict.fromkeys(("ply", "stl", "glb", "colmap_cameras_bin", "colmap_images_bin", "colmap_points_bin")),
    **dict.fromkeys(("transforms_json", "cameras_json", "views_json")),
}
"""Targets of formats that store their length, with the expected codes of truncated files (None: any code)."""


@pytest.mark.slow
@pytest.mark.parametrize("name", PREFIXES)
def test_truncated_files_are_rejected(name: str, tmp_path: Path) -> None:
    feed, whole = TARGETS[name].at(tmp_path), TARGETS[name].small_seeds()[0]
    assert feed(whole) is None
    codes = set()
    for length in range(len(whole.rstrip())):
        error = feed(whole[:length])
        assert error is not None, length
        codes.add(error.code)
    assert PREFIXES[name] in (None, codes)
