"""`msb track`: the command's own arguments, streams and status go through untouched."""

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


def test_a_signal_that_ends_it_is_128_and_more(msb: Msb, tmp_path: Path) -> None:
    code = "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"
    msb("track", "-o", tmp_path / "t.json", sys.executable, "-c", code, status=137)
    msb("track", "-o", tmp_path / "u.json", tmp_path / "nothing", status=3)
    assert not (tmp_path / "u.json").exists()


@pytest.mark.slow
def test_a_record_that_exists_is_kept_before_and_after_the_command(msb: Msb, tmp_path: Path) -> None:
    target, ran = tmp_path / "t.json", tmp_path / "ran"
    write = [sys.executable, "-c", f"open({str(target)!r}, 'w').write('precious'); open({str(ran)!r}, 'w')"]
    assert "\nOUTPUT_EXISTS: " in msb("track", "-o", target, "--", *write, status=2).err
    assert (target.read_text(), ran.exists()) == ("precious", True)
    ran.unlink()
    msb("track", "-o", target, "--", *write).ends(2, "OUTPUT_EXISTS: ")
    assert not ran.exists(), "nothing runs"
    msb("track", "-f", "-o", target, "--", *write, status=0)
    assert json.loads(target.read_text())["schema"] == "msb.track/1"
    msb("track", "-o", "-", "--", *write, cwd=tmp_path).ends(2, "USAGE: --out")
