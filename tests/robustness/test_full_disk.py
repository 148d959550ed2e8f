"""A disk that is full, met by commands: one line, what was there stays, what is finished is kept.

What writes files is tested in tests/base/test_atomic.py.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("msb.bench", reason="msb.bench was removed")
from msb.bench.run import run_protocol
from tests.bench.protocols import protocol
from tests.cli.conftest import Here
from tests.conftest import ROOT
from tests.robustness.conftest import Disk

pytestmark = pytest.mark.slow
FULL = Path("/dev/full")
ASSET, CHECKPOINT = ROOT / "data_stubs" / "splat_like.triasset", ROOT / "data_stubs" / "checkpoint"

TURN = ("render", "--turntable", "2", "--size", "64x48", "-f")


def python(*line: object, limit: int | None = None, **more: Any) -> subprocess.CompletedProcess[str]:
    """Run Python, whose files may have `limit` bytes."""

    def limited() -> None:
        import resource

        resource.setrlimit(resource.RLIMIT_FSIZE, (limit or 0, limit or 0))

    # Python 3.11 keeps the compiled modules it could write half of, for every later process, hence -B.
    return subprocess.run(
        [sys.executable, "-B", *map(str, line)],
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "cwd": ROOT, **more},
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        preexec_fn=limited if limit else None,
        check=False,
    )


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("a.triasset", lambda out: ["export", "-f", CHECKPOINT, out]),
        ("a.mp4", lambda out: [*TURN, "--film", out, CHECKPOINT]),
    ],
)
def test_what_was_there_stays(
    disk: Disk, here: Here, name: str, line: Callable[[Path], list[object]]
) -> None:
    target = disk.folder / name
    target.write_bytes(b"the old one")
    disk.fill()
    before = sorted(disk.folder.rglob("*"))
    result = here(*line(target))
    assert result.status == 3
    assert result.err.count(f"OUTPUT_UNWRITABLE: {target}: ") == 1
    assert "INTERNAL" not in result.err
    assert target.read_bytes() == b"the old one"
    assert sorted(disk.folder.rglob("*")) == before


def test_a_cache_of_kernels_that_is_full_is_not_used(disk: Disk, monkeypatch: pytest.MonkeyPatch) -> None:
    """PoCL's compiler would end the process there."""
    disk.fill()
    monkeypatch.delenv("POCL_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(disk.folder))
    done = python("-m", "msb", "devices", "-v")
    assert done.returncode == 0
    assert str(disk.folder) in done.stdout + done.stderr


def test_a_run_keeps_what_it_finished_and_goes_on(disk: Disk) -> None:
    disk.resize("132k")
    file = protocol(disk.folder, ("two_dts",))
    full = run_protocol(file)
    assert full.exit_status == 3
    assert {reason.code for row in full.rows for reason in row.reasons.values()} == {"OUTPUT_UNWRITABLE"}
    assets = {path: path.stat().st_mtime_ns for path in disk.folder.rglob("*.triasset")}
    assert assets
    disk.resize("8m")
    assert run_protocol(file, only=["exported_mesh"]).exit_status == 0
    assert {path: path.stat().st_mtime_ns for path in assets} == assets, "what was finished is not done again"


@pytest.mark.skipif(os.name == "nt", reason="limits are POSIX")
def test_temporary_files_without_room_are_one_line_that_names_their_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    done = python("-m", "msb", "trial", "--task", "solid", ASSET, limit=4096, cwd=tmp_path)
    assert done.returncode == 3
    assert done.stderr.startswith(f"OUTPUT_UNWRITABLE: {tmp_path}: ")
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full here")
def test_standard_streams_that_are_full() -> None:
    with FULL.open("wb") as full:
        done = python("-m", "msb", "methods", stdout=full)
        assert (done.returncode, done.stderr.partition(":")[0]) == (3, "OUTPUT_UNWRITABLE")
        assert python("-m", "msb", "info", "missing.triasset", stderr=full).returncode == 3
