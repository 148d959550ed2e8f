"""A disk that is full: one line says so, what was there stays, and what is finished is kept."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from msb.api.demo import CONTENTS
from msb.base.atomic import new_file
from msb.bench.run import run_protocol
from msb.errors import OutputError
from tests.bench.protocols import protocol
from tests.conftest import ROOT
from tests.robustness.commands import QUICK_VIEWS

if TYPE_CHECKING:
    from tests.cli.conftest import Here
    from tests.robustness.conftest import Disk

pytestmark = pytest.mark.slow

FULL = Path("/dev/full")
STUBS = ROOT / "data_stubs"
ASSET, CHECKPOINT = STUBS / "splat_like.triasset", STUBS / "checkpoint"
TURN = ("render", "--turntable", "2", "--size", "64x48", "-f")
FILES: dict[str, tuple[str, Callable[[Path], list[Any]]]] = {
    "export": ("a.triasset", lambda out: ["export", "-f", CHECKPOINT, out]),
    "convert to GLB": ("a.glb", lambda out: ["convert", "-f", ASSET, out]),
    "render to PNG": ("00000.png", lambda out: [*TURN, "-o", out.parent, CHECKPOINT]),
    "render an MP4": ("a.mp4", lambda out: [*TURN, "--film", out, CHECKPOINT]),
    "audit --json": ("a.json", lambda out: ["audit", "-f", "--json", out, ASSET]),
    "audit --elements .vtp": ("a.vtp", lambda out: ["audit", "-f", "--elements", out, ASSET]),
    "audit --elements .npz": ("a.npz", lambda out: ["audit", "-f", "--elements", out, ASSET]),
    "repair": ("a.triasset", lambda out: ["repair", "-f", CHECKPOINT, "-o", out]),
    "repair --maps": (
        "a.npz",
        lambda out: ["repair", "-f", CHECKPOINT, "-o", out.parents[1] / "b.triasset", "--maps", out],
    ),
    "trial --json": (
        "a.json",
        lambda out: ["trial", "-f", "--task", "intersections", "--json", out, CHECKPOINT],
    ),
    "why --json": ("a.json", lambda out: ["why", "-f", "--size", "64x48", "--json", out, CHECKPOINT]),
    "view --html": ("a.html", lambda out: ["view", "-f", "--html", out, ASSET]),
    "compare --html": ("a.html", lambda out: ["compare", "-f", *QUICK_VIEWS, "--html", out, CHECKPOINT]),
    "web": ("a.html", lambda out: ["web", "-f", "--out", out]),
    "track": ("a.json", lambda out: ["track", "-f", "-o", out, "--", sys.executable, "--version"]),
}


@pytest.mark.parametrize("command", FILES)
def test_what_was_there_stays(disk: Disk, here: Here, command: str) -> None:
    name, line = FILES[command]
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


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("a.triasset", lambda out: ["export", "-f", "--form", "folder", CHECKPOINT, out]),
        ("kept", lambda out: ["trial", "-q", "-f", "--task", "intersections", "--save", out, CHECKPOINT]),
        ("costs", lambda out: ["repair", "-q", "-f", "--compare", "--task", "none", CHECKPOINT, "-o", out]),
        ("report", lambda out: ["report", "-f", "--paper", "--format", "csv", "-o", out]),
        ("demo", lambda out: ["demo-data", "-f", out]),
    ],
    ids=["export", "trial", "compare", "report", "demo-data"],
)
def test_a_folder_that_was_there_stays(
    disk: Disk, here: Here, name: str, line: Callable[[Path], list[Any]]
) -> None:
    target = disk.folder / name
    target.mkdir()
    (target / "report.md").write_bytes(b"the old one")
    if name == "report":  # by which msb report knows what it may replace
        (target / "report.json").write_bytes(b'{\n  "schema": "msb.report/1"}')
    if name == "demo":  # by which msb demo-data does
        (target / "report.md").rename(target.parent / "report.md")
        for each in CONTENTS:
            (target / each).write_bytes(b"the old one")
    disk.fill()
    before = sorted(disk.folder.rglob("*"))
    result = here(*line(target))
    assert (result.status, result.err.count("\n")) == (3, 1)
    where = rf"{re.escape(str(target))}[^.]*(\.png)?"
    assert re.match(rf"OUTPUT_UNWRITABLE: {where}: .* No space left", result.err)
    assert (target / ("views.json" if name == "demo" else "report.md")).read_bytes() == b"the old one"
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


def test_a_cache_of_kernels_that_is_full_is_not_used(disk: Disk) -> None:
    """PoCL's compiler would end the process there."""
    disk.fill()
    variables = {key: value for key, value in os.environ.items() if key != "POCL_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, "-m", "msb", "devices", "-v"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={**variables, "XDG_CACHE_HOME": str(disk.folder)},
        check=False,
    )
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


@pytest.mark.skipif(os.name == "nt", reason="limits are POSIX")
@pytest.mark.parametrize("command", ["convert to GLB", "audit --elements .npz"])
def test_a_limit_on_the_size_of_files(tmp_path: Path, command: str) -> None:
    """The same where nothing can be mounted: the system refuses the rest of a file."""
    import resource

    name, line = FILES[command]
    target = tmp_path / name
    target.write_bytes(b"the old one")
    done = subprocess.run(
        # Python 3.11 keeps the compiled modules it could write half of, for every later process, hence -B.
        [sys.executable, "-B", "-m", "msb", *line(target)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096)),
        check=False,
    )
    said = f"OUTPUT_UNWRITABLE: {target}: it cannot be written: File too large\n"
    assert (done.returncode, done.stderr) == (3, said)
    assert list(tmp_path.iterdir()) == [target]
    assert target.read_bytes() == b"the old one"


@pytest.mark.skipif(os.name == "nt", reason="limits are POSIX")
@pytest.mark.parametrize(
    "line",
    [
        ("trial", "--task", "solid", ASSET),
        ("repair", "--with", "igl", "--plan", "cut", ASSET, "-o", "a.triasset"),
        ("audit", "--cross-check", ASSET),
    ],
    ids=lambda line: line[0],
)
def test_temporary_files_without_room_are_one_line_that_names_their_folder(
    tmp_path: Path, line: tuple[Any, ...]
) -> None:
    import resource

    done = subprocess.run(
        [sys.executable, "-B", "-m", "msb", *line],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path)},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096)),
        check=False,
    )
    said = f"OUTPUT_UNWRITABLE: {tmp_path}: temporary files cannot be written: File too large; "
    assert done.stderr == f"{said}TMPDIR names another folder\n"
    assert done.returncode == 3
    assert not list(tmp_path.iterdir())


def test_a_comparison_of_repairs_blames_the_folder_that_is_full(
    disk: Disk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(disk.folder))
    line = ("repair", "-q", "--compare", "--task", "none", ASSET, "-o", tmp_path / "costs")
    done = subprocess.run(
        [sys.executable, "-m", "msb", *line], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert done.returncode == 3
    assert done.stderr.startswith(f"OUTPUT_UNWRITABLE: {disk.folder}: temporary files cannot be written")
    assert not list(tmp_path.glob("costs*"))


def test_quota_and_disk_are_told_alike(tmp_path: Path) -> None:
    import errno

    with pytest.raises(OutputError, match=r"bytes are free, 7 are needed"), new_file(tmp_path / "a", size=7):
        raise OSError(errno.EDQUOT, os.strerror(errno.EDQUOT))
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full here")
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_standard_output_that_is_full(unbuffered: str) -> None:
    with FULL.open("wb") as full:
        done = subprocess.run(
            [sys.executable, "-m", "msb", "methods"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
            check=False,
        )
    assert done.returncode == 3
    where = "standard output or a temporary file"
    said = f"OUTPUT_UNWRITABLE: {where}: it cannot be written: No space left on device\n"
    assert done.stderr == said


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full here")
def test_standard_error_that_is_full_changes_no_status() -> None:
    with FULL.open("wb") as full:
        line = [sys.executable, "-m", "msb", "info", "missing.triasset"]
        assert subprocess.run(line, stderr=full, cwd=ROOT, check=False).returncode == 3
