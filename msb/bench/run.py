"""A run: export and bake models, write ground truth, compute benchmark cells, take timings and write videos.

Each stage submits tasks to the workers, and continues if a task fails. Finished work is stored on disk, so
starting an interrupted run again continues the run.
"""

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from msb.adapters.training_cameras import CAMERAS
from msb.base.atomic import new_file
from msb.bench.bakes import BakeTask, make_bake
from msb.bench.cell import compute, make_reason, write_lost, write_result
from msb.bench.folder import Results, lock_results
from msb.bench.inputs import InputReader
from msb.bench.job import Job, JobOutcome
from msb.bench.missing_inputs import Missing, find_missing, find_start_errors, find_unknown_cells
from msb.bench.models import ModelAsset, ModelTask, find_known_model, prepare_model
from msb.bench.photographs import PhotographTask, write_photographs
from msb.bench.plan import Pair, Planned, Planner, find_pairs
from msb.bench.pool import DaskWorkers, LocalWorkers, Workers, check_address, run_all
from msb.bench.progress import Stage
from msb.bench.protocol import PROTOCOL_NAME, ProtocolFile
from msb.bench.protocol_tables import AUTO
from msb.bench.records import Cell, Reason, Result
from msb.bench.videos import plan_grids, plan_videos, write_grid, write_video
from msb.errors import EXIT_STATUS, InputError, MsbError
from msb.render.machine import machine
from msb.scenes import write_cameras

# Exit status of an unexpected error, EX_SOFTWARE of sysexits.h.
_INTERNAL_STATUS = 70


class Watch(Protocol):
    """Receives progress reports of a run."""

    def stage(self, stage: Stage) -> AbstractContextManager[Callable[[str], None]]:
        """Enter a stage. Call the yielded function with the name of each finished task."""
        return contextlib.nullcontext(lambda _name: None)

    def note(self, text: str) -> None:
        """Report one line of text."""
        return


class _SilentWatch(Watch):
    """Ignores all reports."""


@dataclass(frozen=True)
class CellOutcome:
    """The outcome of one benchmark cell in a run."""

    planned: Planned
    # The current record; None if a dry run finds no record.
    result: Result | None
    # The reason for each missing part of the benchmark cell.
    seconds: float
    # The reason for each missing part of the benchmark cell. The reason for the whole cell has the key
    # "cell".
    reasons: Mapping[str, Reason]


@dataclass(frozen=True)
class Report:
    """The outcome of a run."""

    rows: tuple[CellOutcome, ...]
    # Errors about models that cannot be read. The key is the path of the model.
    models: Mapping[str, Reason]
    seconds: float
    # The missing inputs of a dry run.
    missing: tuple[Missing, ...] = ()

    @property
    def exit_status(self) -> int:
        """The highest exit status of all failures. An unsupported condition is not a failure.

        A dry run with a missing input has the status 3.
        """
        if self.missing:
            return EXIT_STATUS[InputError]
        codes = [reason.code for reason in self.models.values()]
        codes += [reason.code for row in self.rows for reason in row.reasons.values()]
        return max((get_exit_status(code) for code in codes), default=0)


def get_exit_status(code: str) -> int:
    """Return the exit status for an error code."""
    status = next((status for kind, status in EXIT_STATUS.items() if code in kind.codes), _INTERNAL_STATUS)
    return 0 if code.startswith("UNSUPPORTED_") else status


def run_protocol(
    file: ProtocolFile,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    only: Sequence[str] = (),
    redo: bool = False,
    dry: bool = False,
    watch: Watch | None = None,
) -> Report:
    """Evaluate the benchmark cells of a protocol that are not finished yet.

    The tasks run in `jobs` processes on this machine, or on the workers of a Dask `scheduler`. `only` selects
    benchmark cells (`msb.bench.plan.is_selected`), and `redo` computes finished parts again. A `dry` run does
    not compute or write results. The report of a dry run contains the plan and the missing inputs.
    """
    start = time.perf_counter()
    watch = watch or _SilentWatch()
    if scheduler is not None:
        check_address(scheduler)
    if dry:
        return _run_dry(file, scheduler, only, redo, start, watch)
    for error in find_start_errors(file, watch.note):
        raise error
    with lock_results(file.results) as run, _connect_workers(jobs, scheduler) as workers:
        with new_file(file.results / PROTOCOL_NAME) as copy:
            copy.write(file.text)
        return _Run(file, run, workers, watch).execute(only, redo, start)


def _connect_workers(jobs: int, scheduler: str | None) -> Workers:
    return LocalWorkers(jobs) if scheduler is None else DaskWorkers(scheduler)


def _find_device(workers: Workers, selector: str | None) -> Mapping[str, Any]:
    """Return the record of the OpenCL device of the workers."""
    device: Mapping[str, Any] = workers.executor().submit(machine, selector).result()["device"]
    return device


def _run_dry(
    file: ProtocolFile,
    scheduler: str | None,
    only: Sequence[str],
    redo: bool,
    start: float,
    watch: Watch,
) -> Report:
    """Return the report of a dry run: the plan of all benchmark cells and the missing inputs."""
    errors = list({str(error): error for error in find_start_errors(file, watch.note)}.values())
    device: Mapping[str, Any] | None = None
    try:
        if scheduler is None:
            device = machine(file.protocol.device)["device"]
        else:
            with DaskWorkers(scheduler) as workers:
                device = _find_device(workers, file.protocol.device)
    except MsbError as error:
        errors.append(error)
    results = Results(file.results)
    # A dry run does not export models. The dry run uses the models that an earlier run has exported.
    folder_errors: dict[str, MsbError] = {}
    pairs = find_pairs(file, only, folder_errors)
    models: dict[Pair, ModelAsset | Exception] = {}
    for pair in pairs:
        task = pair.task(file.results, "")
        known = None if task is None else find_known_model(results, task)
        if known is not None:
            models[pair] = known
    planner = Planner(file, "", InputReader(device), only, redo=redo)
    cells, missing = find_missing(planner, planner.plan(pairs, models) if pairs else [], errors)
    for line in planner.reader.list_notes():
        watch.note(line)
    rows = tuple(_make_outcome(results, planned, 0.0) for planned in cells)
    missing += find_unknown_cells(folder_errors, pairs)
    return Report(rows, {}, time.perf_counter() - start, tuple(missing))


class _Run:
    """The stages of a run in their order."""

    def __init__(self, file: ProtocolFile, run: str, workers: Workers, watch: Watch) -> None:
        self.file, self.run, self.workers, self.watch = file, run, workers, watch
        self.results = Results(file.results)
        # Seconds spent on each benchmark cell in this run.
        self.spent: dict[Cell, float] = {}

    def execute(self, only: Sequence[str], redo: bool, start: float) -> Report:
        """Run all stages, and return the report. The run started at the time `start`."""
        pairs = find_pairs(self.file, only)
        models = self.prepare_models(pairs)
        reader = InputReader(_find_device(self.workers, self.file.protocol.device))
        planner = Planner(self.file, self.run, reader, only, redo=redo)
        cells = self.make_bakes(planner, planner.plan(pairs, models))
        assets = [model for model in models.values() if isinstance(model, ModelAsset)]
        for line in dict.fromkeys(
            [*(line for asset in assets for line in asset.warnings), *reader.list_notes()]
        ):
            self.watch.note(line)
        self.write_scene_cameras(cells)
        cells = self.write_ground_truth(cells)
        for planned in cells:
            if planned.reason is not None:
                self.record(planned)
            elif planned.status == "done" and planned.job is not None:
                self.update_notes(planned.job)
        # Timings run after all other parts, without other tasks at the same time. Cells with a failed part
        # are not timed.
        pending = [
            planned.job for planned in cells if planned.job is not None and planned.status == "pending"
        ]
        untimed = [_split_timing(job, timing=False) for job in pending]
        timed = [_split_timing(job, timing=True) for job in pending]
        later = ["videos"] if self.file.protocol.videos is not None else []
        then = ["timing", *later] if any(job.parts for job in timed) else later
        failed = self.compute_cells("cells", [job for job in untimed if job.parts], then)
        timed = [job for job in timed if job.parts and job.name not in failed]
        self.compute_cells("timing", timed, later, alone=True)
        self.write_videos(cells)
        rows = tuple(
            _make_outcome(self.results, planned, self.spent.get(planned.cell, 0.0)) for planned in cells
        )
        unknown = {
            str(pair.model): make_reason(model)
            for pair, model in models.items()
            if isinstance(model, Exception) and pair.method.name == AUTO
        }
        return Report(rows, unknown, time.perf_counter() - start)

    def prepare_models(self, pairs: Sequence[Pair]) -> dict[Pair, ModelAsset | Exception]:
        """Export all models.

        For each pair of method and scene, return the model or the error about the model.
        """
        tasks = {pair: pair.task(self.file.results, self.run) for pair in pairs}
        unique = list(dict.fromkeys(task for task in tasks.values() if task is not None))
        models = dict(self.run_tasks("models", prepare_model, unique))
        return {pair: models[task] for pair, task in tasks.items() if task is not None}

    def make_bakes(self, planner: Planner, cells: list[Planned]) -> list[Planned]:
        """Compute the missing bakes, and return the plan with the benchmark cells of the bakes."""
        tasks = [planned.bake for planned in cells if planned.bake is not None]
        bakes = {id(task): answer for task, answer in self.run_tasks("bakes", make_bake, tasks)}
        for planned in cells:
            answer = bakes.get(id(planned.bake))
            if isinstance(answer, ModelAsset) and answer.bake is not None:
                self.spent[planned.cell] = answer.bake.seconds
        return [
            planned
            if planned.bake is None
            else planner.plan_after_bake(planned.cell, bakes[id(planned.bake)])
            for planned in cells
        ]

    def write_scene_cameras(self, cells: Sequence[Planned]) -> None:
        """Write the cameras of each scene beside the assets of the scene, for use by later commands."""
        jobs = [planned.job for planned in cells if planned.job is not None]
        scenes = {Path(job.model.asset.path).parent: job.scene for job in jobs if job.model is not None}
        for folder, at in scenes.items():
            if folder.is_relative_to(self.results.root / "assets"):
                scene = at.read()
                write_cameras([*scene.train, *scene.test], folder / CAMERAS)

    def write_ground_truth(self, cells: list[Planned]) -> list[Planned]:
        """Write missing or damaged ground truth, and return the plan with failed benchmark cells marked."""
        jobs = [
            planned.job
            for planned in cells
            if planned.job is not None and planned.cell.condition != "exported_mesh"
        ]
        tasks = {
            job.photographs: PhotographTask(self.results.root, self.run, job.scene, job.views) for job in jobs
        }
        broken: dict[Path, Reason] = {}
        for task, answer in self.run_tasks("photographs", write_photographs, list(tasks.values())):
            if isinstance(answer, Exception):
                broken[task.folder] = make_reason(answer)
            elif answer:
                self.watch.note(f"warning: {task.folder}: {answer}; the ground truth was written again")
        return [
            replace(planned, job=None, status="failed", reason=broken[planned.job.photographs])
            if planned.job is not None
            and "quality" in planned.job.parts
            and planned.job.photographs in broken
            else planned
            for planned in cells
        ]

    def compute_cells(
        self, stage: str, jobs: list[Job], then: Sequence[str], *, alone: bool = False
    ) -> set[str]:
        """Compute jobs, and return the names of the failed jobs."""
        failed = set()
        for job, answer in self.run_tasks(stage, compute, jobs, then, alone=alone):
            if isinstance(answer, JobOutcome):
                self.spent[job.cell] = self.spent.get(job.cell, 0.0) + answer.seconds
                if answer.status == "failed":
                    failed.add(job.name)
            else:
                failed.add(job.name)
                write_lost(job, make_reason(answer))
        return failed

    def record(self, planned: Planned) -> None:
        """Write the record of a benchmark cell that cannot be computed."""
        assert planned.status in ("failed", "unsupported")
        result = Result(cell=planned.cell, status=planned.status, reason=planned.reason, seconds=0.0)
        write_result(self.results.cell(planned.cell), result)

    def update_notes(self, job: Job) -> None:
        """Write the record of a finished benchmark cell again if its notes on the training have changed."""
        result = self.results.read(job.cell)
        if result.trained != job.trained:
            write_result(job.folder, result.model_copy(update={"trained": job.trained}))

    def write_videos(self, cells: list[Planned]) -> None:
        """Write the videos that the protocol requests."""
        options = self.file.protocol.videos
        if options is None:
            return
        jobs = [planned.job for planned in cells if planned.job is not None]
        # A grid shows the videos of several methods. Therefore plan grids after the videos are written.
        for write, plan in ((write_video, plan_videos), (write_grid, plan_grids)):
            for task, answer in self.run_tasks("videos", write, plan(options, jobs)):
                if isinstance(answer, Exception):
                    self.watch.note(f"warning: {task.name}: the video was not written: {answer}")

    def run_tasks(
        self,
        title: str,
        function: Callable[[Any], Any],
        tasks: Sequence[Any],
        then: Sequence[str] = (),
        *,
        alone: bool = False,
    ) -> Iterator[tuple[Any, Any]]:
        """Compute the tasks of a stage. Yield each task with its result or exception.

        If the whole cluster fails, the error is raised. `then` lists the following stages.
        """
        if not tasks:
            return
        kinds, at_once = list(map(_find_kind, tasks)), 1 if alone else self.workers.jobs
        stage = Stage(title, [task.name for task in tasks], kinds, at_once=at_once, then=then)
        numbers = {id(task): number for number, task in enumerate(tasks)}
        with self.watch.stage(stage) as step:
            for task, answer in run_all(self.workers, function, tasks, alone=alone):
                if isinstance(answer, MsbError) and answer.code == "RUN_SCHEDULER":
                    raise answer
                done = answer if isinstance(answer, JobOutcome) else None
                failed = isinstance(answer, Exception) or (done is not None and done.status == "failed")
                stage.end(numbers[id(task)], None if done is None else done.seconds, failed=failed)
                step(task.name)
                yield task, answer


def _find_kind(task: Any) -> str:
    """Return the kind of a task. Tasks of one kind take about the same time."""
    if isinstance(task, Job):
        return " ".join((task.cell.condition_key, *task.parts))
    if isinstance(task, BakeTask):
        return task.label
    return task.method if isinstance(task, ModelTask) else ""


def _split_timing(job: Job, *, timing: bool) -> Job:
    """Return a job that computes only the timing, or all parts except the timing."""
    parts = {part: inputs for part, inputs in job.parts.items() if (part == "timing") is timing}
    return replace(job, parts=parts)


def _make_outcome(results: Results, planned: Planned, seconds: float) -> CellOutcome:
    """Return the outcome of a benchmark cell, including its current record."""
    try:
        result: Result | None = results.read(planned.cell)
    except MsbError:
        result = None
    if planned.status == "failed" and planned.reason is not None:
        return CellOutcome(planned, result, seconds, {"cell": planned.reason})
    reasons = {} if result is None else dict(result.reasons)
    if result is not None and result.status == "failed" and result.reason is not None:
        reasons["cell"] = result.reason
    return CellOutcome(planned, result, seconds, reasons)
