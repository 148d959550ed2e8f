"""Places that may not be written into, and inputs that may not be read, met by commands."""

from __future__ import annotations

import os
import shutil
import stat
from pathlib import Path

import pytest

pytest.importorskip("msb.bench", reason="msb.bench was removed")
from msb.bench.run import run_protocol
from tests.bench.protocols import protocol
from tests.conftest import ROOT
from tests.robustness.conftest import Bound

pytestmark = pytest.mark.slow
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


def test_results_of_somebody_else(bound: Bound, tmp_path: Path) -> None:
    file = protocol(tmp_path, ("two_dts",))
    (tmp_path / "protocol.toml").write_bytes(file.text)
    assert run_protocol(file, only=["exported_mesh"]).exit_status == 0
    before = {path: path.stat().st_mtime_ns for path in file.results.rglob("*")}
    for path in (file.results, *before):
        if os.geteuid() == 0:
            os.chown(path, 65534, 65534)
        path.chmod(0o555 if path.is_dir() else 0o444)
    try:
        for line in (["run", tmp_path / "protocol.toml"], ["report", file.results]):
            status, _, err = bound("-m", "msb", *line)
            assert (status, err.split(":")[0], err.count("\n")) == (3, "OUTPUT_UNWRITABLE", 1)
        assert bound("-m", "msb", "run", "--dry-run", tmp_path / "protocol.toml")[0] == 0
        assert {path: path.stat().st_mtime_ns for path in file.results.rglob("*")} == before
    finally:
        for path in (file.results, *before):
            if path.is_dir():
                path.chmod(0o755)
