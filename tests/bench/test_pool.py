"""Worker processes return results and errors, a crash loses one task, and workers end with the parent."""

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
from tests.bench.protocols import wait_until
from tests.bench.workers import double, execute
from tests.conftest import ROOT

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals are POSIX")


@pytest.mark.slow
def test_results_errors_and_crashes(tmp_path: Path) -> None:
    tasks = ["a", "die", "b", "raise it", f"once {tmp_path / 'seen'}", "c", "d"]
    with LocalWorkers(2) as workers:
        answers = dict(run_all(workers, execute, tasks))
        assert list(run_all(workers, double, [1, 2, 3], alone=True)) == [(1, 2), (2, 4), (3, 6)]
        alone = dict(run_all(workers, execute, [f"once {tmp_path / 'alone'}", "die", "a"], alone=True))
    assert set(answers) == set(tasks)
    assert [answers[name] for name in ("a", "b", "c", "d", tasks[4])] == ["a", "b", "c", "d", tasks[4]]
    assert isinstance(answers["raise it"], ValueError)
    assert answers["die"].code == "RUN_WORKER_DIED"
    assert [getattr(answer, "code", "done") for answer in alone.values()].count("RUN_WORKER_DIED") == 1


def test_an_interrupt_while_a_worker_starts_does_not_reach_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sitecustomize.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), str(ROOT)]))
    with LocalWorkers(1) as workers:
        assert list(run_all(workers, double, [1])) == [(1, 2)]


class BreaksEarly(ThreadPoolExecutor):
    """A pool that accepts one task and then breaks, as if its worker had died during the submission."""

    def submit(self, function: Any, /, *args: Any, **kwargs: Any) -> Any:
        if self._work_queue.qsize() or self._threads:
            raise BrokenExecutor
        return super().submit(function, *args, **kwargs)


class BreakingWorkers:
    jobs = 2

    def executor(self) -> Executor:
        return BreaksEarly(1)


def test_a_pool_that_breaks_during_the_submission_loses_no_task() -> None:
    assert sorted(run_all(cast("pool.Workers", BreakingWorkers()), double, [1, 2, 3, 4, 5])) == [
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
        wait_until(lambda: len(list(seen.iterdir())) == 2)
        children = [int(path.name) for path in seen.iterdir()]
        assert all(psutil.pid_exists(child) for child in children)
        parent.send_signal(number)
        parent.wait(30)
        wait_until(lambda: not any(_is_running(child) for child in children))
    finally:
        parent.kill()


def _is_running(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.Error:
        return False


@pytest.mark.slow
def test_an_unreachable_scheduler_is_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="extra distributed is not installed")
    monkeypatch.setattr(pool, "_CONNECT_SECONDS", 1)
    for address in ("tcp://127.0.0.1:9", "nonsense://x"):
        with pytest.raises(MsbError, match="RUN_SCHEDULER"):
            DaskWorkers(address)
