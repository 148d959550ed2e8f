"""The command `msb trial` tries typical tasks of artists on a mesh, and prints the results."""

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
from msb.render.options import NO_CAMERAS, ONLY_GENERATED, RendererOptions, ViewOptions
from msb.repair.options import PLAN_STEPS

if TYPE_CHECKING:
    from msb.trial.run import Trial, Trials
    from msb.trial.task import Outcome

# Maps outcomes to their text and colour in the table.
_WORDS: dict[Outcome, tuple[str, str]] = {
    "works": ("works", "green"),
    "care": ("with limitations", "yellow"),
    "fails": ("FAILS", "red"),
    "not_run": ("not run", "dim"),
}
# The outcomes that --fail-on reports. The values are the texts in the message.
_FAILING: dict[Outcome, str] = {"fails": "fails", "not_run": "is not run"}


@dataclass(frozen=True)
class TrialOptions:
    """The options of `msb trial`."""

    tasks: Annotated[
        tuple[str, ...],
        Option(
            "The task: uv, decimate, subdivide, boolean, collision, solid or intersections. May be "
            "repeated. Default: all.",
            ("--task",),
            metavar="TASK",
        ),
    ] = ()
    weld: Annotated[str | None, Option("Merge coincident vertices first.", metavar="exact|EPS")] = None
    plan: Annotated[
        str | None,
        Option(f"Repair the mesh first. {PLAN_STEPS}", metavar="STEPS"),
    ] = None
    save: Annotated[
        Path | None,
        Option(
            "Save the results as GLB files, and an image of each task, in FOLDER.",
            metavar="FOLDER",
            output="own",
        ),
    ] = None
    fail_on: Annotated[
        tuple[str, ...],
        Option("Exit with status 1 if this task fails or cannot run. May be repeated.", metavar="TASK"),
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
    views: Annotated[ViewOptions, ("cameras", "camera", "kind")],
    limits: Limits,
    drawing: Annotated[RendererOptions, ("device",)],
    output: LinesOutput,
    typed: Typed,
) -> int:
    """Try typical tasks of artists: unwrap, decimate, subdivide, cut, make a collision shape, print.

    Each task runs libraries that artists' tools use, in a child process with time and memory limits. The
    tasks use the mesh as stored. Options can merge the vertices of the mesh or repair the mesh first. Results
    are rendered and compared in the views of --cameras. By default, --cameras are the training views if the
    model stores the views, else generated views.
    """
    from msb.api.command_files import for_each
    from msb.trial.run import SCHEMA

    if views.cameras is None:
        typed.reject(["camera"], NO_CAMERAS)
    else:
        typed.reject(["kind"], ONLY_GENERATED)
    run = _Run(options, views, limits, drawing, output)
    return for_each(paths, SCHEMA, output, run.try_path, ["--save"] if options.save else [])[0]


class _Run:
    """One run of the command `msb trial`. The options are validated before any mesh is read."""

    def __init__(
        self,
        options: TrialOptions,
        views: ViewOptions,
        limits: Limits,
        drawing: RendererOptions,
        output: Output,
    ) -> None:
        from msb.repair.plan import parse_plan
        from msb.topology.weld import parse_weld
        from msb.trial.registry import check_libraries, select_tasks

        gated = {task.name for task in select_tasks(options.fail_on)} if options.fail_on else set()
        tasks = select_tasks(options.tasks)
        if missing := gated - {task.name for task in tasks}:
            raise UsageError(
                "USAGE",
                f"--fail-on {min(missing)} has no effect without the same task in --task; add the task there",
            )
        check_libraries(tasks)
        self.output, self.save, self.gated = output, options.save, gated
        self.tasks = [task.name for task in tasks]
        with option_value("--plan"):
            self.plan = None if options.plan is None else parse_plan(options.plan)
        with option_value("--weld"):
            weld = None if options.weld is None else parse_weld(options.weld)
        self.arguments: dict[str, Any] = {
            "weld": weld,
            "repair": options.plan,
            "cameras": None if views.cameras is None else views.read(output.note),
            "view_kind": views.kind,
            "limits": limits,
            "device": drawing.device,
        }
        if options.save is not None:
            output.check_folder(options.save)
        drawing.check_device()  # without a device, only tasks without renderings are tried
        if not limits.limits_memory:
            output.note("warning: --memory has no effect on this system; only --seconds limits the libraries")
        self.printed = False

    def try_path(self, path: Path, _alone: bool) -> tuple[dict[str, Any], int]:
        """Try the tasks on the asset at `path`. Return the JSON data and the exit status."""
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

                def watch(trial: Trial) -> None:
                    step()
                    word, _ = _WORDS[trial.outcome]
                    self.output.note(f"{trial.task}: {word}, {trial.seconds:.1f} s", level=1)

                result = try_asset(asset, self.tasks, **self.arguments, keep=keep, watch=watch)
        except MsbError as error:  # Print the results, because the tasks took minutes.
            if result is None:
                raise
            self.output.reword(error)
            status = report_error(error)
        self.show(result, one_line(str(path)), saved=self.save is not None and not status)
        gated = (entry for entry in result.trials if entry.task in self.gated and entry.outcome in _FAILING)
        texts = (f"{entry.task} {_FAILING[entry.outcome]}: {entry.why}" for entry in gated)
        status = max(status, *(report_error(GateFailed("GATE_FAILED", text, file=path)) for text in texts), 0)
        return {**result.to_dict(), "path": str(path)}, status

    def show(self, result: Trials, name: str, *, saved: bool) -> None:
        """Print the results as a table, or as one line with --quiet. Also note missing renderings."""
        from msb.trial.run import summarize_trials

        seen_by = result.cameras
        if "no_pictures" in seen_by:
            self.output.note(f"{seen_by['no_pictures']}; renderings of the results are not compared")
        elif "see_nothing" in seen_by:
            text = f"{seen_by['see_nothing']} of the views do not show the mesh; they are ignored"
            self.output.note(text)
        if not self.output.prints_text:
            return
        if self.output.quiet:
            echo(f"{name}: {summarize_trials(result.trials)}")
            return
        if self.printed:
            echo()
        self.printed = True
        changed = "" if self.arguments["weld"] is None else ", welded"
        changed += "" if self.plan is None else f", repaired with {','.join(self.plan.plan)}"
        echo(f"{name}: {result.mesh['vertices']:,} vertices, {result.mesh['faces']:,} faces{changed}")
        echo(f"Views: {result.cameras['views']}")
        rows = [
            (
                trial.title,
                _WORDS[trial.outcome],
                "-" if trial.outcome == "not_run" else f"{trial.seconds:.1f}",
                one_line("; ".join(filter(None, (trial.says, trial.why)))),
            )
            for trial in result.trials
        ]
        headers = ("Task", "Outcome", "Seconds", "Result and problems")
        self.output.table(headers, rows, right=[2], whole=True)
        if saved:
            files = ", ".join(file for trial in result.trials for file in trial.files)
            echo(f"Saved in {one_line(str(self.save))}: {files}")
