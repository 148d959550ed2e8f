"""Full disks, and places and inputs that may not be used, met by commands: one line, what was there stays.

What writes files is tested in tests/base/test_atomic.py.
"""

import shutil
import stat
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
from tests.robustness.conftest import Bound, Disk

pytestmark = pytest.mark.slow
FULL = Path("/dev/full")
CHECKPOINT = ROOT / "data_stubs" / "checkpoint"

TURN = ("render", "--turntable", "2", "--size", "64x48", "-f")


def python(*line: object, **streams: Any) -> subprocess.CompletedProcess[str]:
    """Run Python."""
    # Python 3.11 keeps the compiled modules it could write half of, for every later process, hence -B.
    return subprocess.run(
        [sys.executable, "-B", *map(str, line)],
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **streams},
        text=True,
        cwd=ROOT,
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


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full here")
def test_standard_streams_that_are_full() -> None:
    with FULL.open("wb") as full:
        done = python("-m", "msb", "methods", stdout=full)
        assert (done.returncode, done.stderr.partition(":")[0]) == (3, "OUTPUT_UNWRITABLE")
        assert python("-m", "msb", "info", "missing.triasset", stderr=full).returncode == 3


ASSET = ROOT / "data_stubs" / "splat_like.triasset"


def test_a_folder_that_is_read_only_is_noticed_first(bound: Bound, read_only: Path) -> None:
    out = read_only / "a.triasset"
    status, _, err = bound("-m", "msb", "export", ROOT / "data_stubs" / "checkpoint", out)
    assert (status, err.count("\n")) == (3, 1)
    assert err.startswith(f"OUTPUT_UNWRITABLE: {out}: ")


def test_one_input_that_may_not_be_read_does_not_stop_the_others(bound: Bound, tmp_path: Path) -> None:
    locked = tmp_path / "locked"
    locked.mkdir()
    for folder in (locked, tmp_path):
        shutil.copy(ASSET, folder / "a.triasset")
    locked.chmod(0)
    try:
        status, _, err = bound("-m", "msb", "audit", locked / "a.triasset")
        assert (status, err.partition(": it")[0]) == (3, f"FILE_UNREADABLE: {locked / 'a.triasset'}")
        status, _, err = bound("-m", "msb", "audit", "--jsonl", tmp_path / "out.jsonl", tmp_path)
        assert (status, err.count("\n"), err.split(":")[0]) == (3, 1, "FILE_UNREADABLE")
        assert (tmp_path / "out.jsonl").read_text().count("msb.audit/1") == 2
    finally:
        locked.chmod(stat.S_IRWXU)
