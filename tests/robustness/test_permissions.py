"""Places that may not be written into, and inputs that may not be read, met by commands."""

from __future__ import annotations

import os
import shutil
import stat
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from msb.bench.run import run_protocol
from tests.bench.protocols import protocol
from tests.conftest import ROOT
from tests.robustness.conftest import Bound

Refused = Callable[..., tuple[int, str]]

pytestmark = pytest.mark.slow

ASSET = ROOT / "data_stubs" / "splat_like.triasset"
CHECKPOINT = ROOT / "data_stubs" / "checkpoint"
TURN = ("render", "--turntable", 1, "--size", "64x48")


@pytest.fixture
def refused(bound: Bound) -> Refused:
    """Return a function that runs `msb` as somebody whom permissions bind; status and standard error."""
    return lambda *args, **variables: bound("-m", "msb", *args, **variables)[::2]


@pytest.fixture
def locked(tmp_path: Path) -> Iterator[Path]:
    """A folder with an asset in it, into which nobody may look or write."""
    folder = tmp_path / "locked"
    folder.mkdir()
    shutil.copy(ASSET, folder / "a.triasset")
    folder.chmod(0)
    yield folder
    folder.chmod(stat.S_IRWXU)


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("a.triasset", lambda out: ["export", CHECKPOINT, out]),
        ("00000.png", lambda out: [*TURN, "-o", out.parent, CHECKPOINT]),
        ("t.json", lambda out: ["track", "-o", out, "--", sys.executable, "-c", "print('it ran')"]),
    ],
    ids=["export", "render", "track"],
)
def test_a_folder_that_is_read_only_is_noticed_first(
    refused: Refused, read_only: Path, name: str, line: Callable[[Path], list[object]]
) -> None:
    status, err = refused(*line(read_only / name))
    said = f"OUTPUT_UNWRITABLE: {read_only / name}: it cannot be written: Permission denied: {read_only}\n"
    assert (status, err) == (3, said)


def test_an_input_that_may_not_be_read(refused: Refused, locked: Path) -> None:
    for line in (["audit", locked / "a.triasset"], ["convert", locked / "a.ply", locked.parent / "b.glb"]):
        status, err = refused(*line)
        assert (status, err) == (3, f"FILE_UNREADABLE: {line[1]}: it cannot be read: Permission denied\n")
    # One folder that may not be looked into does not stop the others.
    shutil.copy(ASSET, locked.parent / "b.triasset")
    status, err = refused("audit", "--jsonl", locked.parent / "out.jsonl", locked.parent)
    assert (status, err.count("\n"), err.split(":")[0]) == (3, 1, "FILE_UNREADABLE")
    assert (locked.parent / "out.jsonl").read_text().count("msb.audit/1") == 2


def test_results_of_somebody_else(refused: Refused, tmp_path: Path) -> None:
    file = protocol(tmp_path, ("two_dts",))
    (tmp_path / "protocol.toml").write_bytes(file.text)
    assert run_protocol(file, only=["exported_mesh"]).exit_status == 0
    before = {path: path.stat().st_mtime_ns for path in file.results.rglob("*")}
    for path in (file.results, *before):
        if os.geteuid() == 0:
            os.chown(path, 65534, 65534)
        path.chmod(0o555 if path.is_dir() else 0o444)
    try:
        status, err = refused("run", tmp_path / "protocol.toml")
        said = f"OUTPUT_UNWRITABLE: {file.results}: it cannot be locked: Permission denied\n"
        assert (status, err) == (3, said)
        assert refused("run", "--dry-run", tmp_path / "protocol.toml")[0] == 0
        status, err = refused("report", file.results)
        where = file.results / "report"
        said = f"OUTPUT_UNWRITABLE: {where}: it cannot be written: Permission denied: {file.results}\n"
        assert (status, err) == (3, said)
        assert {path: path.stat().st_mtime_ns for path in file.results.rglob("*")} == before
    finally:
        for path in (file.results, *before):
            if path.is_dir():
                path.chmod(0o755)


def test_a_cache_that_is_read_only(
    refused: Refused, read_only: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("POCL_CACHE_DIR", raising=False)
    status, err = refused("devices", "-q", XDG_CACHE_HOME=str(read_only))
    assert status == 0
    assert "DEVICE_" not in err  # a library of the system's may complain, too
