"""The same run on a Dask cluster: equal results, also when a worker is killed in the middle."""

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
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

pytestmark = pytest.mark.slow

pytest.importorskip("distributed", reason="extra distributed is not installed")
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


@pytest.mark.skipif(os.name == "nt", reason="signals are POSIX")
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
