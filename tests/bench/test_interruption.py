"""Runs that are killed, interrupted, doubled or on a cluster: nothing finished is lost or half there."""

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from msb.bench.folder import check_run
from msb.bench.progress import Stage
from msb.bench.protocol import ProtocolFile
from msb.bench.run import run_protocol
from msb.errors import MsbError
from tests.bench.protocols import Notes, differences, images, records, until
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


WORKERS = 2


class Cluster:
    """A scheduler and workers on the loopback device, each a process."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        file = folder / "scheduler.json"
        self.processes = [self._start("dask_scheduler", "--port", "0", "--scheduler-file", str(file))]
        until(lambda: file.exists() and file.read_text().endswith("}"))
        self.address: str = json.loads(file.read_text())["address"]
        self.processes += [
            self._start("dask_worker", self.address, "--nthreads", "1", "--no-nanny") for _ in range(WORKERS)
        ]
        from distributed import Client

        with Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(WORKERS, timeout=60)

    def _start(self, module: str, *options: str) -> subprocess.Popen[bytes]:
        place = ["--host", "127.0.0.1", "--no-dashboard"]
        return subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.{module}", *options, *place],
            cwd=self.folder,
            env={**os.environ, "PYTHONPATH": str(ROOT), "DASK_LOGGING__DISTRIBUTED": "critical"},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def kill_worker(self) -> int:
        """Kill a worker and return its status."""
        worker = next(one for one in self.processes[1:] if one.poll() is None)
        worker.kill()
        return worker.wait(10)

    def stop(self) -> None:
        for process in self.processes:
            process.kill()  # asked to end, a worker waits for a scheduler that ends as well
            process.wait()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    pytest.importorskip("distributed", reason="extra distributed is not installed")
    made = Cluster(tmp_path_factory.mktemp("cluster"))
    yield made
    made.stop()


class KillsOne(Notes):
    """Watches a run, and kills a worker when the first cell is done."""

    def __init__(self, cluster: Cluster) -> None:
        super().__init__()
        self.cluster, self.killed = cluster, False

    def stage(self, stage: Stage) -> Any:
        def step(_name: str) -> None:
            if stage.title == "cells" and not self.killed:
                self.killed = self.cluster.kill_worker() != 0

        return contextlib.nullcontext(step)


def test_a_worker_killed_in_the_middle_costs_nothing(
    cluster: Cluster, whole: ProtocolFile, tmp_path: Path
) -> None:
    there = replace(whole, path=tmp_path / "there" / "protocol.toml")
    watch = KillsOne(cluster)
    found = run_protocol(there, scheduler=cluster.address, watch=watch)
    assert {str(row.reasons) for row in found.rows} == {"{}"}
    assert watch.killed
    assert found.exit_status == 0
    assert all(row.result is not None and not row.reasons for row in found.rows)
    assert differences(records(there.results), records(whole.results)) == []
    assert images(there.results) == images(whole.results)
    again = run_protocol(there, scheduler=cluster.address)
    assert {row.planned.status for row in again.rows} == {"done", "unsupported"}


def test_a_worker_that_does_not_see_the_results_says_so(tmp_path: Path) -> None:
    with pytest.raises(MsbError, match="RUN_SCHEDULER"):
        check_run(tmp_path, "0123")
