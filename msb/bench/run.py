"""A whole run: models made ready and baked, photographs written, cells computed, timings taken, films made.

Every stage hands plain tasks to the workers and goes on even if one of them fails. Finished work is on disk,
so a run that ends at any point goes on from there when it is started again.
"""

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from msb.adapters.training_cameras import CAMERAS
from msb.base.atomic import new_file
from msb.bench.bakes import BakeTask, make_bake
from msb.bench.cell import compute, reason_of, write_lost, write_result
from msb.bench.folder import Results, exclusive
from msb.bench.inputs import Known
from msb.bench.job import Done, Job
from msb.bench.missing import Missing, find_missing, find_unknown, start_errors
from msb.bench.models import Model, ModelTask, known_model, prepare_model
from msb.bench.photographs import PhotographTask, write_photographs
from msb.bench.plan import Pair, Planned, Planner, pairs_of
from msb.bench.pool import DaskWorkers, LocalWorkers, Workers, check_address, run_all
from msb.bench.progress import Stage
from msb.bench.protocol import PROTOCOL_NAME, ProtocolFile
from msb.bench.protocol_tables import AUTO
from msb.bench.records import Cell, Reason, Result
from msb.bench.videos import grid_tasks, video_tasks, write_grid, write_video
from msb.errors import EXIT_STATUS, InputError, MsbError
from msb.render.machine import machine
from msb.scenes import write_cameras

_INTERNAL_STATUS = 70


class Watch:
    """The interface by which a run reports its progress; this one ignores all reports."""

    def stage(self, stage: Stage) -> AbstractContextManager[Callable[[str], None]]:
        """Begin a stage, which says how far it is; call the function with the name of each ended task."""
        return contextlib.nullcontext(lambda _name: None)

    def note(self, text: str) -> None:
        """Report a line of text."""
        return


@dataclass(frozen=True)
class Row:
    """The outcome of one cell in this run."""

    planned: Planned
    # The record as it is now; None in a dry run if there is no record.
    result: Result | None
    # The time that this run spent on the cell.
    seconds: float
    # "cell", or a part -> the reason why it is missing.
    reasons: Mapping[str, Reason]


@dataclass(frozen=True)
class Report:
    """The outcome of the whole run."""

    rows: tuple[Row, ...]
    models: Mapping[str, Reason]
    """The models that could not be read and whose method is unknown, and why."""
    seconds: float
    missing: tuple[Missing, ...] = ()
    """In a dry run, all that must be there before the cells that need it can be computed."""

    @property
    def exit_status(self) -> int:
        """The highest exit status among the failures; a condition that is not supported is no failure.

        Of a dry run it is 3 if anything is missing, whatever that is.
        """
        if self.missing:
            return EXIT_STATUS[InputError]
        codes = [reason.code for reason in self.models.values()]
        codes += [reason.code for row in self.rows for reason in row.reasons.values()]
        return max((status_of(code) for code in codes), default=0)


def status_of(code: str) -> int:
    """Return the exit status of a failure with `code`."""
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
    """Evaluate the cells of the protocol `file` that are not done yet.

    The work is done by `jobs` processes of this machine, or by the workers of a Dask `scheduler`. `only`
    selects cells (`msb.bench.plan.selected`), `redo` computes finished parts again. A `dry` run computes and
    writes nothing; its report holds the plan.
    """
    start = time.perf_counter()
    watch = watch or Watch()
    if scheduler is not None:
        check_address(scheduler)
    if dry:
        return _dry(file, scheduler, only, redo, start, watch)
    for error in start_errors(file, watch.note):
        raise error
    with exclusive(file.results) as run, _workers(jobs, scheduler) as workers:
        with new_file(file.results / PROTOCOL_NAME) as copy:
            copy.write(file.text)
        return _Run(file, run, workers, watch).all(only, redo, start)


def _workers(jobs: int, scheduler: str | None) -> Workers:
    return LocalWorkers(jobs) if scheduler is None else DaskWorkers(scheduler)


def _device(workers: Workers, selector: str | None) -> Mapping[str, Any]:
    """Return the OpenCL device of the workers."""
    device: Mapping[str, Any] = workers.executor().submit(machine, selector).result()["device"]
    return device


def _dry(
    file: ProtocolFile,
    scheduler: str | None,
    only: Sequence[str],
    redo: bool,
    start: float,
    watch: Watch,
) -> Report:
    wrong = list({str(error): error for error in start_errors(file, watch.note)}.values())
    device: Mapping[str, Any] | None = None
    try:
        if scheduler is None:
            device = machine(file.protocol.device)["device"]
        else:
            with DaskWorkers(scheduler) as workers:
                device = _device(workers, file.protocol.device)
    except MsbError as error:
        wrong.append(error)
    results = Results(file.results)
    lost: dict[str, MsbError] = {}
    pairs = pairs_of(file, only, lost)
    models: dict[Pair, Model | Exception] = {}
    for pair in pairs:
        task = pair.task(file.results, "")
        known = None if task is None else known_model(results, task)
        if known is not None:
            models[pair] = known
    planner = Planner(file, "", Known(device), only, redo=redo)
    planned, missing = find_missing(planner, planner.plan(pairs, models) if pairs else [], wrong)
    for line in planner.known.notes():
        watch.note(line)
    rows = tuple(_row(results, one, 0.0) for one in planned)
    missing += find_unknown(lost, pairs)
    return Report(rows, {}, time.perf_counter() - start, tuple(missing))


class _Run:
    """One run: the stages in their order."""

    def __init__(self, file: ProtocolFile, run: str, workers: Workers, watch: Watch) -> None:
        self.file, self.run, self.workers, self.watch = file, run, workers, watch
        self.results = Results(file.results)
        self.spent: dict[Cell, float] = {}

    def all(self, only: Sequence[str], redo: bool, start: float) -> Report:
        """Go through all stages."""
        pairs = pairs_of(self.file, only)
        models = self.models(pairs)
        known = Known(_device(self.workers, self.file.protocol.device))
        planner = Planner(self.file, self.run, known, only, redo=redo)
        planned = self.bakes(planner, planner.plan(pairs, models))
        made = [model for model in models.values() if isinstance(model, Model)]
        for line in dict.fromkeys([*(line for model in made for line in model.warnings), *known.notes()]):
            self.watch.note(line)
        self.keep_cameras(planned)
        planned = self.photographs(planned)
        for one in planned:
            if one.reason is not None:
                self.record(one)
        pending = [one.job for one in planned if one.job is not None and one.status == "pending"]
        first = [_only(job, timing=False) for job in pending]
        second = [_only(job, timing=True) for job in pending]
        later = ["videos"] if self.file.protocol.videos is not None else []
        then = ["timing", *later] if any(job.parts for job in second) else later
        failed = self.cells("cells", [job for job in first if job.parts], then)
        timed = [job for job in second if job.parts and job.name not in failed]
        self.cells("timing", timed, later, alone=True)
        self.videos(planned)
        rows = tuple(_row(self.results, one, self.spent.get(one.cell, 0.0)) for one in planned)
        unknown = {
            str(pair.model): reason_of(model)
            for pair, model in models.items()
            if isinstance(model, Exception) and pair.method.name == AUTO
        }
        return Report(rows, unknown, time.perf_counter() - start)

    def models(self, pairs: Sequence[Pair]) -> dict[Pair, Model | Exception]:
        """Make every model ready."""
        tasks = {pair: pair.task(self.file.results, self.run) for pair in pairs}
        unique = list(dict.fromkeys(task for task in tasks.values() if task is not None))
        made = dict(self.each("models", prepare_model, unique))
        return {pair: made[task] for pair, task in tasks.items() if task is not None}

    def bakes(self, planner: Planner, planned: list[Planned]) -> list[Planned]:
        """Make the bakes that are not there, and plan their cells."""
        tasks = [one.bake for one in planned if one.bake is not None]
        made = {id(task): answer for task, answer in self.each("bakes", make_bake, tasks)}
        for one in planned:
            answer = made.get(id(one.bake))
            if isinstance(answer, Model) and answer.bake is not None:
                self.spent[one.cell] = answer.bake.seconds
        return [
            one if one.bake is None else planner.with_bake(one.cell, made[id(one.bake)]) for one in planned
        ]

    def keep_cameras(self, planned: Sequence[Planned]) -> None:
        """Write each scene's cameras beside the assets made of its models: they judge these later, too."""
        jobs = [one.job for one in planned if one.job is not None]
        scenes = {Path(job.model.asset.path).parent: job.scene for job in jobs if job.model is not None}
        for folder, at in scenes.items():
            if folder.is_relative_to(self.results.root / "assets"):
                scene = at.read()
                write_cameras([*scene.train, *scene.test], folder / CAMERAS)

    def photographs(self, planned: list[Planned]) -> list[Planned]:
        """Write missing or changed ground truth; if that fails, the cells that need it have failed."""
        tasks = {
            one.job.photographs: PhotographTask(self.results.root, self.run, one.job.scene, one.job.views)
            for one in planned
            if one.job is not None and one.cell.condition != "exported_mesh"
        }
        broken: dict[Any, Reason] = {}
        for task, answer in self.each("photographs", write_photographs, list(tasks.values())):
            if isinstance(answer, Exception):
                broken[task.folder] = reason_of(answer)
            elif answer:
                self.watch.note(f"warning: {task.folder}: {answer}; the ground truth was written again")
        return [
            one
            if one.job is None or "quality" not in one.job.parts or one.job.photographs not in broken
            else replace(one, job=None, status="failed", reason=broken[one.job.photographs])
            for one in planned
        ]

    def cells(self, stage: str, jobs: list[Job], then: Sequence[str], *, alone: bool = False) -> set[str]:
        """Compute jobs; return the names of those whose cell failed."""
        failed = set()
        for job, answer in self.each(stage, compute, jobs, then, alone=alone):
            if isinstance(answer, Done):
                self.spent[job.cell] = self.spent.get(job.cell, 0.0) + answer.seconds
                if answer.status == "failed":
                    failed.add(job.name)
            else:
                failed.add(job.name)
                write_lost(job, reason_of(answer))
        return failed

    def record(self, planned: Planned) -> None:
        """Record a cell that cannot be computed."""
        assert planned.status in ("failed", "unsupported")
        result = Result(cell=planned.cell, status=planned.status, reason=planned.reason, seconds=0.0)
        write_result(self.results.cell(planned.cell), result)

    def videos(self, planned: list[Planned]) -> None:
        """Make the films the protocol asks for."""
        options = self.file.protocol.videos
        if options is None:
            return
        jobs = [one.job for one in planned if one.job is not None]
        for write, tasks in ((write_video, video_tasks), (write_grid, grid_tasks)):  # grids are of the films
            for task, answer in self.each("videos", write, tasks(options, jobs)):
                if isinstance(answer, Exception):
                    self.watch.note(f"warning: {task.name}: no film: {answer}")

    def each(
        self,
        title: str,
        function: Callable[[Any], Any],
        tasks: Sequence[Any],
        then: Sequence[str] = (),
        *,
        alone: bool = False,
    ) -> Iterator[tuple[Any, Any]]:
        """Compute tasks and yield them with their answers; raise errors that concern the whole run."""
        if not tasks:
            return
        kinds, at_once = list(map(_kind, tasks)), 1 if alone else self.workers.jobs
        stage = Stage(title, [task.name for task in tasks], kinds, at_once=at_once, then=then)
        numbers = {id(task): number for number, task in enumerate(tasks)}
        with self.watch.stage(stage) as step:
            for task, answer in run_all(self.workers, function, tasks, alone=alone):
                if isinstance(answer, MsbError) and answer.code == "RUN_SCHEDULER":
                    raise answer
                done = answer if isinstance(answer, Done) else None
                failed = isinstance(answer, Exception) or (done is not None and done.status == "failed")
                stage.end(numbers[id(task)], None if done is None else done.seconds, failed=failed)
                step(task.name)
                yield task, answer


def _kind(task: Any) -> str:
    """Return what tasks have in common that take about the same time."""
    if isinstance(task, Job):
        return " ".join((task.cell.condition_key, *task.parts))
    if isinstance(task, BakeTask):
        return task.label
    return task.method if isinstance(task, ModelTask) else ""


def _only(job: Job, *, timing: bool) -> Job:
    parts = {part: inputs for part, inputs in job.parts.items() if (part == "timing") is timing}
    return replace(job, parts=parts)


def _row(results: Results, planned: Planned, seconds: float) -> Row:
    try:
        result: Result | None = results.read(planned.cell)
    except MsbError:
        result = None
    if planned.status == "failed" and planned.reason is not None:
        return Row(planned, result, seconds, {"cell": planned.reason})
    reasons = {} if result is None else dict(result.reasons)
    if result is not None and result.status == "failed" and result.reason is not None:
        reasons["cell"] = result.reason
    return Row(planned, result, seconds, reasons)
