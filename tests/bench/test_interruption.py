"""Runs that are killed, interrupted or started twice: nothing finished is lost, nothing is half there."""

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from msb.bench.protocol import ProtocolFile
from msb.bench.run import run_protocol
from tests.bench.protocols import differences, images, records
from tests.conftest import ROOT

Start = Callable[[], subprocess.Popen[bytes]]

pytestmark = [pytest.mark.slow, pytest.mark.skipif(os.name == "nt", reason="signals are POSIX")]


@pytest.fixture
def start(whole: ProtocolFile, tmp_path: Path) -> Iterator[Start]:
    """Start a run of the same protocol, with results below `tmp_path`."""
    started: list[subprocess.Popen[bytes]] = []
    (tmp_path / "protocol.toml").write_bytes(whole.text)
    # Who is started in the background inherits that interrupts are ignored.
    code = (
        "import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from msb.cli import main\nif __name__ == '__main__':\n    main()\n"
    )
    script = tmp_path / "run.py"
    script.write_text(code)

    def run() -> subprocess.Popen[bytes]:
        process = subprocess.Popen(
            [sys.executable, str(script), "run", "-v", "-j", "2", str(tmp_path / "protocol.toml")],
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        started.append(process)
        return process

    yield run
    for process in started:
        process.kill()
        process.wait()
        process.stderr.close()


def wait_for(process: subprocess.Popen[bytes], stage: bytes) -> None:
    """Wait until a task of the stage is reported."""
    for line in process.stderr:
        if line.startswith(stage):
            return
    pytest.fail("the run ended first")


def test_killed_again_and_again_it_ends_as_if_it_never_had_been(
    whole: ProtocolFile, start: Start, tmp_path: Path
) -> None:
    moments = random.Random(5)
    done: set[str] = set()
    for stage in (b"cells", b"models"):
        process = start()
        wait_for(process, stage)
        time.sleep(moments.random())
        process.kill()
        process.wait()
        # What a killed run leaves are whole records, and never fewer than before.
        left = set(records(tmp_path / "results"))
        assert done <= left
        done = left
    found = run_protocol(replace(whole, path=tmp_path / "protocol.toml"))
    assert found.exit_status == 0
    # The first kill came after a cell was reported, which is on record by then; perhaps it is to be timed.
    again = [
        row.planned.why.keys() & {"quality", "audit"} for row in found.rows if row.planned.job is not None
    ]
    assert set() in again
    assert differences(records(tmp_path / "results"), records(whole.results)) == []
    assert images(tmp_path / "results") == images(whole.results)
    assert not list((tmp_path / "results").rglob("*.part"))


def test_an_interrupt_ends_it_at_once_and_silently(whole: ProtocolFile, start: Start, tmp_path: Path) -> None:
    process = start()
    wait_for(process, b"cells")
    process.send_signal(signal.SIGINT)
    rest = process.stderr.read().decode()
    assert process.wait(30) == 130
    *lines, last = rest.splitlines()
    assert all(line.startswith("cells: ") for line in lines), rest
    assert last.startswith("note: interrupted: ")
    found = run_protocol(replace(whole, path=tmp_path / "protocol.toml"), dry=True)
    left = [dict(row.planned.why) for row in found.rows if row.planned.status == "pending"]
    assert {"timing": "new"} in left, "the images that were done stay"
    assert {"quality": "new", "timing": "new"} in left
