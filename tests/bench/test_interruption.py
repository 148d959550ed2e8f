"""Runs that are killed, interrupted or on a cluster keep finished work and leave no partial files."""

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
from tests.bench.protocols import Notes, find_differences, read_images, read_records, wait_until
from tests.conftest import ROOT

Start = Callable[[], subprocess.Popen[bytes]]

pytestmark = [pytest.mark.slow, pytest.mark.skipif(os.name == "nt", reason="signals are POSIX")]


@pytest.fixture
def start(whole: ProtocolFile, tmp_path: Path) -> Iterator[Start]:
    """Start a run of the same protocol, with results below `tmp_path`."""
    started: list[subprocess.Popen[bytes]] = []
    (tmp_path / "protocol.toml").write_bytes(whole.text)
    # A background process ignores interrupts by inheritance, so the handler is set again.
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
    """Wait until the run reports a finished task of the stage."""
    for line in process.stderr:
        if line.startswith(stage):
            return
    pytest.fail("the run ended first")


def test_results_after_repeated_kills_equal_an_uninterrupted_run(
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
        # Every record on disk can be read, and none has disappeared.
        left = set(read_records(tmp_path / "results"))
        assert done <= left
        done = left
    report = run_protocol(replace(whole, path=tmp_path / "protocol.toml"))
    assert report.exit_status == 0
    # One cell was reported before the first kill, so at most its timing is computed again.
    repeated = [
        row.planned.why.keys() & {"quality", "audit"} for row in report.rows if row.planned.job is not None
    ]
    assert set() in repeated
    assert find_differences(read_records(tmp_path / "results"), read_records(whole.results)) == []
    assert read_images(tmp_path / "results") == read_images(whole.results)
    assert not list((tmp_path / "results").rglob("*.part"))


def test_an_interrupt_ends_a_run_without_traceback(whole: ProtocolFile, start: Start, tmp_path: Path) -> None:
    process = start()
    wait_for(process, b"cells")
    process.send_signal(signal.SIGINT)
    rest = process.stderr.read().decode()
    assert process.wait(30) == 130
    *lines, last = rest.splitlines()
    assert all(line.startswith("cells: ") for line in lines), rest
    assert last.startswith("note: interrupted after ")
    report = run_protocol(replace(whole, path=tmp_path / "protocol.toml"), dry=True)
    pending = [dict(row.planned.why) for row in report.rows if row.planned.status == "pending"]
    assert {"timing": "new"} in pending, "finished images are kept"
    assert {"quality": "new", "timing": "new"} in pending


WORKERS = 2


class Cluster:
    """A Dask scheduler and workers on the loopback device, each in its own process."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        file = folder / "scheduler.json"
        self.processes = [self._start("dask_scheduler", "--port", "0", "--scheduler-file", str(file))]
        wait_until(lambda: file.exists() and file.read_text().endswith("}"))
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
        worker = next(process for process in self.processes[1:] if process.poll() is None)
        worker.kill()
        return worker.wait(10)

    def stop(self) -> None:
        for process in self.processes:
            process.kill()  # a terminated worker would wait for the scheduler, but the scheduler also ends
            process.wait()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    pytest.importorskip("distributed", reason="extra distributed is not installed")
    started = Cluster(tmp_path_factory.mktemp("cluster"))
    yield started
    started.stop()


class WorkerKiller(Notes):
    """Kills a worker when the first cell of a run is done."""

    def __init__(self, cluster: Cluster) -> None:
        super().__init__()
        self.cluster, self.killed = cluster, False

    def stage(self, stage: Stage) -> Any:
        def step(_name: str) -> None:
            if stage.title == "cells" and not self.killed:
                self.killed = self.cluster.kill_worker() != 0

        return contextlib.nullcontext(step)


def test_a_run_survives_the_death_of_a_cluster_worker(
    cluster: Cluster, whole: ProtocolFile, tmp_path: Path
) -> None:
    file = replace(whole, path=tmp_path / "protocol.toml")
    watch = WorkerKiller(cluster)
    report = run_protocol(file, scheduler=cluster.address, watch=watch)
    assert {str(row.reasons) for row in report.rows} == {"{}"}
    assert watch.killed
    assert report.exit_status == 0
    assert None not in [row.result for row in report.rows]
    assert find_differences(read_records(file.results), read_records(whole.results)) == []
    assert read_images(file.results) == read_images(whole.results)
    again = run_protocol(file, scheduler=cluster.address)
    assert {row.planned.status for row in again.rows} == {"done", "unsupported"}


def test_a_worker_without_access_to_the_results_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(MsbError, match="RUN_SCHEDULER"):
        check_run(tmp_path, "0123")
