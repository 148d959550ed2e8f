"""Worker processes: answers and errors come home, a death costs one task, and none outlives its parent."""

import os
import signal
import subprocess
import sys
from concurrent.futures import BrokenExecutor, Executor, ThreadPoolExecutor
from pathlib import Path
from typing import Any, cast

import psutil
import pytest

from msb.bench import pool
from msb.bench.pool import DaskWorkers, LocalWorkers, run_all
from msb.errors import MsbError
from tests.bench.protocols import until
from tests.bench.workers import double, moody
from tests.conftest import ROOT

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals are POSIX")


@pytest.mark.slow
def test_answers_errors_and_deaths(tmp_path: Path) -> None:
    tasks = ["a", "die", "b", "raise it", f"once {tmp_path / 'seen'}", "c", "d"]
    with LocalWorkers(2) as workers:
        found = dict(run_all(workers, moody, tasks))
        assert list(run_all(workers, double, [1, 2, 3], alone=True)) == [(1, 2), (2, 4), (3, 6)]
        alone = dict(run_all(workers, moody, [f"once {tmp_path / 'alone'}", "die", "a"], alone=True))
    assert set(found) == set(tasks)
    assert [found[name] for name in ("a", "b", "c", "d", tasks[4])] == ["a", "b", "c", "d", tasks[4]]
    assert isinstance(found["raise it"], ValueError)
    died = found["die"]
    assert died.code == "RUN_WORKER_DIED"
    assert [getattr(one, "code", "done") for one in alone.values()].count("RUN_WORKER_DIED") == 1


class Refusing(ThreadPoolExecutor):
    """A pool that a death breaks while tasks are being handed over: it takes one, and no more."""

    def submit(self, function: Any, /, *args: Any, **kwargs: Any) -> Any:
        if self._work_queue.qsize() or self._threads:
            raise BrokenExecutor
        return super().submit(function, *args, **kwargs)


class Breaking:
    jobs = 2

    def executor(self) -> Executor:
        return Refusing(1)


def test_a_pool_that_breaks_before_all_tasks_are_handed_over_loses_none() -> None:
    assert sorted(run_all(cast("pool.Workers", Breaking()), double, [1, 2, 3, 4, 5])) == [
        (number, 2 * number) for number in range(1, 6)
    ]


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_workers_end_with_their_parent(tmp_path: Path, number: int) -> None:
    code = (
        "import signal, sys\nfrom msb.bench.pool import LocalWorkers, run_all\n"
        "from tests.bench.workers import linger\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "if __name__ == '__main__':\n    with LocalWorkers(2) as workers:\n"
        "        list(run_all(workers, linger, [sys.argv[1]] * 2))\n"
    )
    script = tmp_path / "parent.py"
    script.write_text(code)
    seen = tmp_path / "seen"
    seen.mkdir()
    parent = subprocess.Popen(
        [sys.executable, str(script), str(seen)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stderr=subprocess.DEVNULL,
    )
    try:
        until(lambda: len(list(seen.iterdir())) == 2)
        children = [int(path.name) for path in seen.iterdir()]
        assert all(psutil.pid_exists(child) for child in children)
        parent.send_signal(number)
        parent.wait(30)
        until(lambda: not any(_runs(child) for child in children))
    finally:
        parent.kill()


def _runs(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.Error:
        return False


@pytest.mark.slow
def test_no_scheduler_is_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="extra distributed is not installed")
    monkeypatch.setattr(pool, "_CONNECT_SECONDS", 1)
    with pytest.raises(MsbError, match="RUN_SCHEDULER"):
        DaskWorkers("tcp://127.0.0.1:9")
    with pytest.raises(MsbError, match="RUN_SCHEDULER"):
        DaskWorkers("nonsense://x")
