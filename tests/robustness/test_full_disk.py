"""A disk that is full, met by commands: one line says so, what was there stays, what is finished is kept."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from msb.bench.run import run_protocol
from tests.bench.protocols import protocol
from tests.cli.conftest import Here
from tests.conftest import ROOT
from tests.robustness.conftest import Disk

pytestmark = pytest.mark.slow
POSIX = pytest.mark.skipif(os.name == "nt", reason="limits are POSIX")

FULL = Path("/dev/full")
STUBS = ROOT / "data_stubs"
ASSET, CHECKPOINT = STUBS / "splat_like.triasset", STUBS / "checkpoint"
TURN = ("render", "--turntable", "2", "--size", "64x48", "-f")


def python(
    *line: object, limit: int | None = None, cwd: Path = ROOT, **more: Any
) -> subprocess.CompletedProcess[str]:
    """Run Python, whose files may have `limit` bytes."""

    def limited() -> None:
        import resource

        resource.setrlimit(resource.RLIMIT_FSIZE, (limit or 0, limit or 0))

    # Python 3.11 keeps the compiled modules it could write half of, for every later process, hence -B.
    return subprocess.run(
        [sys.executable, "-B", *map(str, line)],
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **more},
        text=True,
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        preexec_fn=limited if limit else None,
        check=False,
    )


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("a.triasset", lambda out: ["export", "-f", CHECKPOINT, out]),
        ("00000.png", lambda out: [*TURN, "-o", out.parent, CHECKPOINT]),
        ("a.mp4", lambda out: [*TURN, "--film", out, CHECKPOINT]),
        ("a.json", lambda out: ["audit", "-f", "--json", out, ASSET]),
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
    # Of two images the other may be the first to fail.
    where = re.escape(str(target)).replace("00000", r"0000\d")
    said = rf"OUTPUT_UNWRITABLE: {where}: it cannot be written: No space left on device \(0 bytes are free"
    errors = [text for text in result.err.splitlines() if text.startswith("OUTPUT_UNWRITABLE")]
    assert len(errors) == 1
    assert re.match(said, errors[0])
    assert "INTERNAL" not in result.err
    assert target.read_bytes() == b"the old one"
    assert sorted(disk.folder.rglob("*")) == before


def test_a_report_that_was_there_stays(disk: Disk, here: Here) -> None:
    target = disk.folder / "report"
    target.mkdir()
    (target / "report.json").write_bytes(b'{\n  "schema": "msb.report/1"}')
    disk.fill()
    before = sorted(disk.folder.rglob("*"))
    result = here("report", "-f", "--paper", "--format", "csv", "-o", target)
    assert (result.status, result.err.count("\n")) == (3, 1)
    assert re.match(rf"OUTPUT_UNWRITABLE: {re.escape(str(target))}[^.]*: .* No space left", result.err)
    assert sorted(disk.folder.rglob("*")) == before


def test_the_error_says_how_much_is_needed(disk: Disk, here: Here) -> None:
    result = here("export", CHECKPOINT, disk.folder / "new" / "a.triasset")
    assert re.search(r"No space left on device \([\d,]+ bytes are free, 227,156 are needed\)$", result.err)


def test_a_log_that_ends_early_costs_only_the_log(disk: Disk, here: Here) -> None:
    disk.fill()
    result = here("info", "--log-file", disk.folder / "log", ASSET)
    assert result.status == 0
    said = f"OUTPUT_UNWRITABLE: {disk.folder / 'log'}: the log cannot be written: No space left on device\n"
    assert result.err == said


def test_a_cache_of_kernels_that_is_full_is_not_used(disk: Disk, monkeypatch: pytest.MonkeyPatch) -> None:
    """PoCL's compiler would end the process there."""
    disk.fill()
    monkeypatch.delenv("POCL_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(disk.folder))
    done = python("-m", "msb", "devices", "-v")
    assert done.returncode == 0
    said = f"{disk.folder} cannot be written, so kernels are compiled again in each process"
    assert said in " ".join((done.stdout + done.stderr).split())


def test_a_run_keeps_what_it_finished_and_goes_on(disk: Disk) -> None:
    disk.resize("132k")
    file = protocol(disk.folder, ("two_dts",))
    full = run_protocol(file)
    assert full.exit_status == 3
    assert {reason.code for row in full.rows for reason in row.reasons.values()} == {"OUTPUT_UNWRITABLE"}
    text = " ".join(reason.message for row in full.rows for reason in row.reasons.values())
    assert "No space left on device" in text
    assert ".part" not in text
    assets = {path: path.stat().st_mtime_ns for path in disk.folder.rglob("*.triasset")}
    assert assets
    disk.resize("8m")
    assert run_protocol(file, only=["exported_mesh"]).exit_status == 0
    assert {path: path.stat().st_mtime_ns for path in assets} == assets, "what was finished is not done again"


def test_a_run_without_any_room_ends_with_one_line(disk: Disk, here: Here, tmp_path: Path) -> None:
    (tmp_path / "protocol.toml").write_bytes(protocol(tmp_path, ("two_dts",)).text)
    (disk.folder / "results").mkdir()
    disk.fill()
    result = here("run", "-o", disk.folder / "results", tmp_path / "protocol.toml")
    assert (result.status, result.err.count("\n")) == (3, 1)
    assert result.err.startswith("OUTPUT_UNWRITABLE: ")
    assert "No space left on device" in result.err


@POSIX
def test_a_limit_on_the_size_of_files(tmp_path: Path) -> None:
    """The same where nothing can be mounted: the system refuses the rest of a file."""
    target = tmp_path / "a.glb"
    target.write_bytes(b"the old one")
    done = python("-m", "msb", "convert", "-f", ASSET, target, limit=4096)
    said = f"OUTPUT_UNWRITABLE: {target}: it cannot be written: File too large\n"
    assert (done.returncode, done.stderr) == (3, said)
    assert list(tmp_path.iterdir()) == [target]
    assert target.read_bytes() == b"the old one"


@POSIX
@pytest.mark.parametrize(
    "line",
    [
        ("trial", "--task", "solid", ASSET),
        ("repair", "--with", "igl", "--plan", "cut", ASSET, "-o", "a.triasset"),
        ("audit", "--cross-check", ASSET),
    ],
    ids=["trial", "repair", "audit"],
)
def test_temporary_files_without_room_are_one_line_that_names_their_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: Sequence[object]
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    done = python("-m", "msb", *line, limit=4096, cwd=tmp_path)
    said = f"OUTPUT_UNWRITABLE: {tmp_path}: temporary files cannot be written: File too large; "
    assert done.stderr == f"{said}TMPDIR names another folder\n"
    assert done.returncode == 3
    assert not list(tmp_path.iterdir())


def test_a_comparison_of_repairs_blames_the_folder_that_is_full(
    disk: Disk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(disk.folder))
    done = python("-m", "msb", "repair", "-q", "--compare", "--task", "none", ASSET, tmp_path / "costs")
    assert done.returncode == 3
    assert done.stderr.startswith(f"OUTPUT_UNWRITABLE: {disk.folder}: temporary files cannot be written")
    assert not list(tmp_path.glob("costs*"))


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full here")
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_standard_output_that_is_full(unbuffered: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    with FULL.open("wb") as full:
        done = python("-m", "msb", "methods", stdout=full)
    where = "standard output or a temporary file"
    said = f"OUTPUT_UNWRITABLE: {where}: it cannot be written: No space left on device\n"
    assert (done.returncode, done.stderr) == (3, said)


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full here")
def test_standard_error_that_is_full_changes_no_status() -> None:
    with FULL.open("wb") as full:
        assert python("-m", "msb", "info", "missing.triasset", stderr=full).returncode == 3
