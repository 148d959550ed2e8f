"""Where tasks are computed: processes of this machine, or a Dask cluster, behind one interface.

A task is a function of this package and plain data. What a task raises is an outcome like any other; a worker
that dies costs at most what it was computing.
"""

import contextlib
import os
import re
import signal
import sys
import threading
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, as_completed
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any, Self, TypeVar

from msb.base.extras import need_extra
from msb.base.packages import PackageWarning
from msb.errors import DeviceError, UsageError, shorten

_CONNECT_SECONDS = 10
Task = TypeVar("Task")
Answer = TypeVar("Answer")


class Workers(ABC):
    """Workers that compute tasks, `jobs` at a time."""

    jobs: int

    @abstractmethod
    def executor(self) -> Executor:
        """Return the executor that runs tasks; a fresh one if the last one broke."""

    @abstractmethod
    def close(self) -> None:
        """Release all workers, and stop their unfinished tasks where that is possible."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def run_all(
    workers: Workers, function: Callable[[Task], Answer], tasks: Sequence[Task], *, alone: bool = False
) -> Iterator[tuple[Task, Answer | Exception]]:
    """Compute ``function(task)`` for all tasks; yield each with its answer or its exception, as they end.

    A worker must be able to import the function. With `alone` tasks run one after the other, so that nothing
    else of this run computes during a timing.

    When a process dies, the pool cannot say which task it had, only that it was one of the first unfinished
    ones. Those are then computed one at a time, and the task during which a process dies again gets
    RUN_WORKER_DIED; the others go on as before. A Dask scheduler does the same by itself.
    """
    waiting = list(tasks)
    while waiting:
        suspects = 1 if alone else workers.jobs
        numbers = range(len(waiting))
        broken = []
        for group in ([number] for number in numbers) if alone else [numbers]:
            for number, answer in _at_once(workers, function, {k: waiting[k] for k in group}):
                if isinstance(answer, BrokenExecutor):
                    broken.append(number)
                else:
                    yield waiting[number], answer
        broken.sort()
        for number in broken[:suspects]:
            again: Answer | Exception = _answer(_submitted(workers.executor(), function, waiting[number]))
            yield waiting[number], _death() if isinstance(again, BrokenExecutor) else again
        waiting = [waiting[number] for number in broken[suspects:]]


def _at_once(
    workers: Workers, function: Callable[[Task], Answer], tasks: Mapping[int, Task]
) -> Iterator[tuple[int, Answer | Exception]]:
    executor = workers.executor()
    futures = {_submitted(executor, function, task): number for number, task in tasks.items()}
    try:
        for future in as_completed(futures):
            number, answer = futures.pop(future), _answer(future)
            del future  # Dask computes again what a lost worker had, as long as anybody holds on to it
            yield number, answer
    finally:
        for future in futures:
            future.cancel()


def _submitted(executor: Executor, function: Callable[[Task], Answer], task: Task) -> Future[Answer]:
    """Hand a task over. A pool that broke meanwhile refuses it, which is an answer like a later death."""
    try:
        return executor.submit(function, task)
    except BrokenExecutor as error:
        refused: Future[Answer] = Future()
        refused.set_exception(error)
        return refused


def _answer(future: Future[Answer]) -> Answer | Exception:
    try:
        return future.result()
    except Exception as error:
        name = type(error).__name__  # Dask's, which need not be installed
        if name == "KilledWorker":
            return _death()
        if name in ("CancelledError", "FutureCancelledError", "CommClosedError"):
            text = "the connection to the scheduler was lost; what is finished is kept, start the run again"
            raise UsageError("RUN_SCHEDULER", text) from error
        return error


def _death() -> DeviceError:
    text = "the process that computed this died, twice: out of memory, or a crash of the OpenCL platform"
    return DeviceError("RUN_WORKER_DIED", text)


class _Process(SpawnProcess):
    """A process that Ctrl-C does not reach before it ignores that: it would print a traceback."""

    def start(self) -> None:
        if sys.platform == "win32":
            super().start()
            return
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            super().start()  # it inherits what is blocked
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Context(SpawnContext):
    Process = _Process


class LocalWorkers(Workers):
    """Processes of this machine, started afresh so that none inherits an OpenCL context.

    They end when this process ends, in whatever way: each watches a pipe whose other end only this process
    holds.
    """

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs
        self._pool: ProcessPoolExecutor | None = None
        self._context = _Context()
        self._leash, self._held = self._context.Pipe(duplex=False)

    def executor(self) -> Executor:
        if self._pool is None or _is_broken(self._pool):
            self._pool = ProcessPoolExecutor(
                self.jobs, mp_context=self._context, initializer=_begin, initargs=(self._leash,)
            )
        return self._pool

    def close(self) -> None:
        """End all processes, whatever they are doing."""
        self._held.close()
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
        self._leash.close()


def _is_broken(pool: ProcessPoolExecutor) -> bool:
    try:
        pool.submit(os.getpid).result()
    except BrokenExecutor:
        return True
    return False


def _begin(leash: Connection) -> None:
    """Prepare a process: interrupts are the parent's business, and its end is ours."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    warnings.simplefilter("ignore", PackageWarning)  # the parent says it

    def wait() -> None:
        with contextlib.suppress(EOFError, OSError):
            leash.recv_bytes()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def check_address(address: str) -> None:
    """Refuse what is no address of a scheduler: Dask would wait for it, and give up with a traceback."""
    match = re.fullmatch(r"(?:[a-z]+://)?[^\s/:][^\s/]*:(\d{1,5})", address)
    if match is None or not 0 < int(match[1]) < 1 << 16:
        text = f'--scheduler is "{shorten(address, 60)}"; it must look like tcp://HOST:8786'
        raise UsageError("USAGE", text)


class DaskWorkers(Workers):
    """The workers of the existing Dask cluster at "tcp://HOST:PORT"."""

    def __init__(self, address: str) -> None:
        need_extra("distributed", "distributed", what="--scheduler")
        import distributed

        try:
            connect: Any = distributed.Client
            self._client = connect(address, timeout=_CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            text = f"no Dask scheduler answers at {shorten(address, 60)}: {shorten(str(error))}"
            raise UsageError("RUN_SCHEDULER", text) from error
        self.jobs = len(self._client.ncores())
        if not self.jobs:
            self._client.close()
            text = f"the scheduler at {shorten(address, 60)} has no workers; start some with dask worker"
            raise UsageError("RUN_SCHEDULER", text)

    def executor(self) -> Executor:
        executor: Executor = self._client.get_executor(pure=False)
        return executor

    def close(self) -> None:
        """Disconnect from the cluster; tasks that were not begun are dropped, the workers stay."""
        self._client.close()
