"""`msb track`: the command's own arguments, streams and status go through untouched."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from tests.cli.conftest import Msb

ECHO = "import sys; print(sys.argv[1:]); sys.exit(3)"


def test_arguments_and_status_go_through(msb: Msb, tmp_path: Path) -> None:
    args = ["--debug", "-q", "--", "--json", "a b", ""]
    result = msb("track", "-o", tmp_path / "t.json", "--", sys.executable, "-c", ECHO, *args, status=3)
    assert result.out == f"{args}\n"
    record = json.loads((tmp_path / "t.json").read_text())
    assert record["schema"] == "msb.track/1"
    assert record["command"] == [sys.executable, "-c", ECHO, *args]
    assert record["exit_status"] == 3
    assert (record["peak_gpu_memory_bytes"] is None) is (record["gpu_reason"] is not None)
    assert str(tmp_path / "t.json") in result.err


@pytest.mark.slow
def test_two_dashes_may_be_left_out_and_outputs_are_kept(msb: Msb, tmp_path: Path) -> None:
    target = tmp_path / "t.json"
    msb("track", "-q", "-o", target, sys.executable, "-c", "pass", status=0)
    msb("track -o", target, sys.executable, "-c", f"open({str(tmp_path / 'ran')!r}, 'w')").ends(
        2, "OUTPUT_EXISTS: "
    )
    assert not (tmp_path / "ran").exists(), "nothing runs for hours only to find that"
    msb("track", "-f", "-o", target, sys.executable, "-c", "raise SystemExit(9)", status=9)
    assert json.loads(target.read_text())["exit_status"] == 9


def test_a_signal_that_ends_it_is_128_and_more(msb: Msb, tmp_path: Path) -> None:
    code = "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"
    msb("track", "-o", tmp_path / "t.json", sys.executable, "-c", code, status=137)
    msb("track", "-o", tmp_path / "u.json", tmp_path / "nothing", status=3)
    assert not (tmp_path / "u.json").exists()


def test_what_the_command_wrote_to_the_records_place_is_kept(msb: Msb, tmp_path: Path) -> None:
    target = tmp_path / "t.json"
    line = [sys.executable, "-c", f"open({str(target)!r}, 'w').write('precious')"]
    result = msb("track", "-o", target, "--", *line, status=2)
    assert f"OUTPUT_EXISTS: {target}: it exists; --force replaces it\n" in result.err
    assert target.read_text() == "precious"
    msb("track", "-f", "-o", target, "--", *line, status=0)
    assert json.loads(target.read_text())["schema"] == "msb.track/1"


def test_standard_output_is_the_commands(msb: Msb, tmp_path: Path) -> None:
    for name in ("-", "/dev/stdout"):
        msb("track", "-o", name, "--", sys.executable, "-c", "print(1)", cwd=tmp_path).ends(
            2, "USAGE: --out: standard output is that of COMMAND"
        )
    assert not list(tmp_path.iterdir())
