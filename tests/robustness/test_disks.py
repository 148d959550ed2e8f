"""Commands on full disks, read-only folders and unreadable inputs: one error line, existing files are kept.

The functions that write files are tested in tests/base/test_atomic.py.
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
from tests.bench.protocols import make_protocol
from tests.cli.conftest import Here
from tests.conftest import ROOT
from tests.robustness.conftest import Bound, Disk

pytestmark = pytest.mark.slow
FULL = Path("/dev/full")
CHECKPOINT = ROOT / "data_stubs" / "checkpoint"

TURN = ("render", "--turntable", "2", "--size", "64x48", "-f")


def python(*line: object, **streams: Any) -> subprocess.CompletedProcess[str]:
    """Run Python and return its output."""
    # On a full disk Python 3.11 leaves damaged compiled modules that break later processes, hence -B.
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
def test_an_existing_output_is_kept_on_a_full_disk(
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


def test_a_kernel_cache_on_a_full_disk_is_not_used(disk: Disk, monkeypatch: pytest.MonkeyPatch) -> None:
    """With such a cache, PoCL's compiler would abort the process."""
    disk.fill()
    monkeypatch.delenv("POCL_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(disk.folder))
    done = python("-m", "msb", "devices", "-v")
    assert done.returncode == 0
    assert str(disk.folder) in done.stdout + done.stderr


def test_a_run_continues_after_a_full_disk(disk: Disk) -> None:
    disk.resize("132k")
    file = make_protocol(disk.folder, ("two_dts",))
    full = run_protocol(file)
    assert full.exit_status == 3
    assert {reason.code for row in full.rows for reason in row.reasons.values()} == {"OUTPUT_UNWRITABLE"}
    assets = {path: path.stat().st_mtime_ns for path in disk.folder.rglob("*.triasset")}
    assert assets
    disk.resize("8m")
    assert run_protocol(file, only=["exported_mesh"]).exit_status == 0
    assert {path: path.stat().st_mtime_ns for path in assets} == assets, (
        "finished assets are not written again"
    )


@pytest.mark.skipif(not FULL.exists(), reason="this system has no /dev/full")
def test_full_standard_streams() -> None:
    with FULL.open("wb") as full:
        done = python("-m", "msb", "methods", stdout=full)
        assert (done.returncode, done.stderr.partition(":")[0]) == (3, "OUTPUT_UNWRITABLE")
        assert python("-m", "msb", "info", "missing.triasset", stderr=full).returncode == 3


ASSET = ROOT / "data_stubs" / "splat_like.triasset"


def test_a_read_only_folder_is_detected_first(bound: Bound, read_only: Path) -> None:
    out = read_only / "a.triasset"
    status, _, err = bound("-m", "msb", "export", ROOT / "data_stubs" / "checkpoint", out)
    assert (status, err.count("\n")) == (3, 1)
    assert err.startswith(f"OUTPUT_UNWRITABLE: {out}: ")


def test_an_unreadable_input_does_not_stop_the_others(bound: Bound, tmp_path: Path) -> None:
    locked = tmp_path / "locked"
    locked.mkdir()
    for folder in (locked, tmp_path):
        shutil.copy(ASSET, folder / "a.triasset")
    locked.chmod(0)
    try:
        status, _, err = bound("-m", "msb", "audit", locked / "a.triasset")
        assert status == 3
        assert err.startswith(f"FILE_UNREADABLE: {locked / 'a.triasset'}: ")
        status, _, err = bound("-m", "msb", "audit", "--jsonl", tmp_path / "out.jsonl", tmp_path)
        assert (status, err.count("\n"), err.split(":")[0]) == (3, 1, "FILE_UNREADABLE")
        assert (tmp_path / "out.jsonl").read_text().count("msb.audit/1") == 2
    finally:
        locked.chmod(stat.S_IRWXU)
