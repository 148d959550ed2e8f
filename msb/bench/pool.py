"""Workers that compute the tasks of a run: processes on this machine, or a Dask cluster.

A task is the argument of a function in this package, as plain data. If a task raises an exception, the
exception is returned as the result of the task. If a worker process dies, only its current task is lost.
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

# Seconds to wait for the connection to a Dask scheduler.
_CONNECT_SECONDS = 10
Task = TypeVar("Task")
Answer = TypeVar("Answer")


class Workers(ABC):
    """Workers that compute `jobs` tasks at the same time."""

    jobs: int

    @abstractmethod
    def executor(self) -> Executor:
        """Return the executor that runs the tasks.

        When a worker process has died, a new executor is created.
        """

    @abstractmethod
    def close(self) -> None:
        """Release all workers and stop unfinished tasks if possible."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def run_all(
    workers: Workers, function: Callable[[Task], Answer], tasks: Sequence[Task], *, alone: bool = False
) -> Iterator[tuple[Task, Answer | Exception]]:
    """Compute ``function(task)`` for all tasks. Yield each finished task with its result or exception.

    Worker processes must be able to import the function. If `alone` is true, tasks run one after the other,
    so that they do not disturb timings.

    When a process dies, the process pool does not know which task caused this. A task that was in progress is
    among the first unfinished tasks, because each worker computes one task at a time. The process pool
    repeats the first unfinished tasks, one at a time. If a worker process dies again during the same task,
    the task fails with RUN_WORKER_DIED. All other tasks continue. A Dask scheduler repeats the tasks of a
    dead worker itself.
    """
    waiting = list(tasks)
    while waiting:
        suspects = 1 if alone else workers.jobs
        numbers = range(len(waiting))
        broken = []
        # Submit all tasks as one group. If tasks must run alone, submit each task as a separate group.
        for group in ([number] for number in numbers) if alone else [numbers]:
            for number, answer in _run_group(workers, function, {k: waiting[k] for k in group}):
                if isinstance(answer, BrokenExecutor):
                    broken.append(number)
                else:
                    yield waiting[number], answer
        broken.sort()
        # One of the first unfinished tasks may have ended the worker process. Submit the remaining tasks
        # again.
        for number in broken[:suspects]:
            second_answer: Answer | Exception = _get_answer(
                _submit(workers.executor(), function, waiting[number])
            )
            yield (
                waiting[number],
                _make_death_error() if isinstance(second_answer, BrokenExecutor) else second_answer,
            )
        waiting = [waiting[number] for number in broken[suspects:]]


def _run_group(
    workers: Workers, function: Callable[[Task], Answer], tasks: Mapping[int, Task]
) -> Iterator[tuple[int, Answer | Exception]]:
    """Submit numbered tasks together, and yield each number with the task's result or exception."""
    executor = workers.executor()
    futures = {_submit(executor, function, task): number for number, task in tasks.items()}
    try:
        for future in as_completed(futures):
            number, answer = futures.pop(future), _get_answer(future)
            del future  # Dask repeats the finished tasks of a lost worker while a reference to them exists
            yield number, answer
    finally:
        for future in futures:
            future.cancel()


def _submit(executor: Executor, function: Callable[[Task], Answer], task: Task) -> Future[Answer]:
    """Submit a task. If the process pool is broken, return a future with the pool's error."""
    try:
        return executor.submit(function, task)
    except BrokenExecutor as error:
        broken: Future[Answer] = Future()
        broken.set_exception(error)
        return broken


def _get_answer(future: Future[Answer]) -> Answer | Exception:
    """Return the result or exception of a task. A lost connection to the scheduler is raised as an error."""
    try:
        return future.result()
    except Exception as error:
        name = type(error).__name__  # Dask may be missing, so its classes are compared by name
        if name == "KilledWorker":
            return _make_death_error()
        if name in ("CancelledError", "FutureCancelledError", "CommClosedError"):
            text = "the connection to the scheduler was lost; start the same command again to continue"
            raise UsageError("RUN_SCHEDULER", text) from error
        return error


def _make_death_error() -> DeviceError:
    text = "the worker process died twice during this task: out of memory, or a crash of the OpenCL platform"
    return DeviceError("RUN_WORKER_DIED", text)


class _Process(SpawnProcess):
    """A worker process that starts with blocked interrupts.

    Ctrl-C during the start of the process then prints no traceback.
    """

    def start(self) -> None:
        if sys.platform == "win32":
            super().start()
            return
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            super().start()  # the new process inherits the blocked signals
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Context(SpawnContext):
    Process = _Process


class LocalWorkers(Workers):
    """Worker processes on this machine.

    The processes are spawned instead of forked, so that they inherit no OpenCL context.

    Each process listens to a pipe from the parent process, and ends when the pipe closes. The pipe closes
    even if the parent process is killed.
    """

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs
        self._pool: ProcessPoolExecutor | None = None
        self._context = _Context()
        self._reader, self._writer = self._context.Pipe(duplex=False)

    def executor(self) -> Executor:
        if self._pool is None or _is_broken(self._pool):
            self._pool = ProcessPoolExecutor(
                self.jobs, mp_context=self._context, initializer=_initialize_worker, initargs=(self._reader,)
            )
        return self._pool

    def close(self) -> None:
        """End all worker processes immediately, even during a task."""
        self._writer.close()
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
        self._reader.close()


def _is_broken(pool: ProcessPoolExecutor) -> bool:
    try:
        pool.submit(os.getpid).result()
    except BrokenExecutor:
        return True
    return False


def _initialize_worker(pipe: Connection) -> None:
    """Prepare a worker process: ignore interrupts, which the parent handles, and end with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    warnings.simplefilter("ignore", PackageWarning)  # the parent process already prints this warning

    def wait() -> None:
        with contextlib.suppress(EOFError, OSError):
            pipe.recv_bytes()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def check_address(address: str) -> None:
    """Raise USAGE if `address` is not HOST:PORT.

    Check the address first, because Dask waits for an invalid address and then prints a traceback.
    """
    match = re.fullmatch(r"(?:[a-z]+://)?[^\s/:][^\s/]*:(\d{1,5})", address)
    if match is None or not 0 < int(match[1]) < 1 << 16:
        text = f'--scheduler is "{shorten(address, 60)}", but it must have the form tcp://HOST:8786'
        raise UsageError("USAGE", text)


class DaskWorkers(Workers):
    """The workers of an existing Dask cluster with the address "tcp://HOST:PORT"."""

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
            text = f"the scheduler at {shorten(address, 60)} has no workers; start them with dask worker"
            raise UsageError("RUN_SCHEDULER", text)

    def executor(self) -> Executor:
        executor: Executor = self._client.get_executor(pure=False)
        return executor

    def close(self) -> None:
        """Disconnect from the cluster. Waiting tasks are dropped, and the workers continue to run."""
        self._client.close()
