"""`msb trial`: try on a mesh what artists do with meshes, and say what happened."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from msb.base.limits import Limits
from msb.base.option import Argument, Option
from msb.cli.command import Typed, command, option_value
from msb.cli.output import LinesOutput, Output, echo, report_error
from msb.errors import GateFailed, MsbError, UsageError, one_line
from msb.render.options import NO_CAMERAS, Drawing, Views

if TYPE_CHECKING:
    from msb.trial.run import Trial, Trials
    from msb.trial.task import Outcome

# Outcome -> what is printed, and its colour.
_WORDS: dict[Outcome, tuple[str, str]] = {
    "works": ("works", "green"),
    "care": ("with care", "yellow"),
    "fails": ("FAILS", "red"),
    "not_run": ("not run", "dim"),
}
# The outcomes on which a gate fails.
_FAILING: dict[Outcome, str] = {"fails": "fails", "not_run": "is not run"}


@dataclass(frozen=True)
class TrialOptions:
    """What is tried, on what, and what is kept of it."""

    tasks: Annotated[
        tuple[str, ...],
        Option(
            "uv, decimate, subdivide, boolean, collision, solid, intersections. May be given again. "
            "Default: all.",
            ("--task",),
            metavar="TASK",
        ),
    ] = ()
    weld: Annotated[str | None, Option("Merge coincident vertices first.", metavar="exact|EPS")] = None
    plan: Annotated[
        str | None,
        Option(
            "Repair the mesh first by these steps of msb repair, whose default is orient,pair.",
            metavar="STEPS",
        ),
    ] = None
    save: Annotated[
        Path | None,
        Option(
            "Keep what was made: GLB (uv with its UVs), and a picture of each task.",
            metavar="FOLDER",
            output="own",
        ),
    ] = None
    fail_on: Annotated[
        tuple[str, ...],
        Option("Fail if this task fails or cannot be run. May be given again.", metavar="TASK"),
    ] = ()


@command(
    "msb trial --task solid --task boolean data_stubs/splat_like.triasset",
    "msb trial --task uv --save out/unwrapped data_stubs/checkpoint",
    "msb trial --task intersections --weld exact --json - data_stubs/checkpoint",
)
def trial(
    paths: Annotated[
        tuple[Path, ...],
        Argument(
            "A .triasset, mesh file or checkpoint, or a folder or pattern of these.",
            metavar="ASSET...",
        ),
    ],
    options: TrialOptions,
    views: Annotated[Views, ("cameras", "camera")],
    limits: Limits,
    drawing: Annotated[Drawing, ("device",)],
    output: LinesOutput,
    typed: Typed,
) -> int:
    """Try what artists do with meshes: unwrap, decimate, subdivide, cut, make a collision shape, print.

    Each task is done by the libraries that artists' tools use, on the mesh as it is stored (or welded, or
    repaired, on request), in a process that is ended at its limits. How the results look is judged by
    --cameras, else by the cameras of the training where they lie beside the model, else by views round it.
    """
    from msb.api.command_files import for_each
    from msb.trial.run import SCHEMA

    if views.cameras is None:
        typed.reject(["camera"], NO_CAMERAS)
    run = _Run(options, views, limits, drawing, output)
    return for_each(paths, SCHEMA, output, run.one, ["--save"] if options.save else [])[0]


class _Run:
    """One run of the command: what is wrong with its options is said before any mesh is read."""

    def __init__(
        self, options: TrialOptions, views: Views, limits: Limits, drawing: Drawing, output: Output
    ) -> None:
        from msb.repair.plan import parse_plan
        from msb.scenes import read_cameras
        from msb.topology.weld import parse_weld
        from msb.trial.registry import check_libraries, chosen_tasks

        gated = {task.name for task in chosen_tasks(options.fail_on)} if options.fail_on else set()
        tasks = chosen_tasks(options.tasks)
        if away := gated - {task.name for task in tasks}:
            raise UsageError("USAGE", f"--fail-on names {min(away)}, which --task leaves out")
        check_libraries(tasks)
        self.output, self.save, self.gated = output, options.save, gated
        self.tasks = [task.name for task in tasks]
        with option_value("--plan"):
            self.plan = None if options.plan is None else parse_plan(options.plan)
        with option_value("--weld"):
            weld = None if options.weld is None else parse_weld(options.weld)
        self.asked: dict[str, Any] = {
            "weld": weld,
            "repair": options.plan,
            "cameras": None if views.cameras is None else views.of(read_cameras(str(views.cameras))),
            "limits": limits,
            "device": drawing.device,
        }
        if options.save is not None:
            output.check_folder(options.save)
        drawing.check_device()  # without any device it is tried what needs no pictures
        if not limits.limits_memory:
            output.note("warning: this system has no limit of memory for a process; only --seconds holds")
        self.printed = False

    def one(self, path: Path, _alone: bool) -> tuple[dict[str, Any], int]:
        """Try the tasks on what is at `path`; return the JSON data, and the status of the gates."""
        from msb.api.command_files import open_asset
        from msb.base.own_folder import own_folder
        from msb.trial.run import try_asset

        asset = open_asset(path, self.output)
        result, status = None, 0
        try:
            with (
                nullcontext()
                if self.save is None
                else own_folder(self.save, overwrite=self.output.force) as keep,
                self.output.counted("trying", len(self.tasks)) as step,
            ):

                def watch(one: Trial) -> None:
                    step()
                    self.output.note(f"{one.task}: {_WORDS[one.outcome][0]}, {one.seconds:.1f} s", level=1)

                result = try_asset(asset, self.tasks, **self.asked, keep=keep, watch=watch)
        except MsbError as error:  # it is said even if it cannot be kept: minutes of work
            if result is None:
                raise
            self.output.reword(error)
            status = report_error(error)
        self.say(result, one_line(str(path)), kept=self.save is not None and not status)
        failed = (one for one in result.trials if one.task in self.gated and one.outcome in _FAILING)
        texts = (f"{one.task} {_FAILING[one.outcome]}: {one.why}" for one in failed)
        status = max(status, *(report_error(GateFailed("GATE_FAILED", text, file=path)) for text in texts), 0)
        return {**result.to_dict(), "path": str(path)}, status

    def say(self, result: Trials, name: str, *, kept: bool) -> None:
        """Print what came of it, and note what it was judged by."""
        from msb.trial.run import summary

        seen_by = result.cameras
        if "no_pictures" in seen_by:
            self.output.note(f"{seen_by['no_pictures']}; so nothing is judged by how it looks")
        elif "see_nothing" in seen_by:
            text = f"{seen_by['see_nothing']} of the views see none of the mesh, and do not count"
            self.output.note(text)
        if not self.output.prints_text:
            return
        if self.output.quiet:
            echo(f"{name}: {summary(result.trials)}")
            return
        if self.printed:
            echo()
        self.printed = True
        changed = "" if self.asked["weld"] is None else ", welded"
        changed += "" if self.plan is None else f", repaired by {','.join(self.plan.plan)}"
        echo(f"{name}: {result.mesh['vertices']:,} vertices, {result.mesh['faces']:,} faces{changed}")
        echo(f"views: {result.cameras['views']}")
        rows = [
            (
                one.title,
                _WORDS[one.outcome],
                "-" if one.outcome == "not_run" else f"{one.seconds:.1f}",
                one_line("; ".join(filter(None, (one.says, one.why)))),
            )
            for one in result.trials
        ]
        headers = ("Task", "Outcome", "Seconds", "What was made, and what is wrong with it")
        self.output.table(headers, rows, right=[2], whole=True)
        if kept:
            files = ", ".join(file for one in result.trials for file in one.files)
            echo(f"kept in {one_line(str(self.save))}: {files}")
