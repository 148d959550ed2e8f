"""`msb trial`: try on a mesh what artists do with meshes, and say what happened."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from msb.cli.camera_options import Cameras, Chosen
from msb.cli.failures import report_error
from msb.cli.options import (
    WRITTEN,
    DeviceName,
    FailFast,
    Force,
    JsonFile,
    JsonLines,
    Quiet,
    Verbose,
    epilog,
)
from msb.cli.output import Output, echo, failure, plain_table
from msb.errors import GateFailed, MsbError, UsageError, one_line

if TYPE_CHECKING:
    from msb.base.children import Limits
    from msb.scenes import Camera
    from msb.topology.weld import Weld
    from msb.trial.run import Trial, Trials
    from msb.trial.task import Outcome

EPILOG = epilog(
    "msb trial --task solid --task boolean data_stubs/splat_like.triasset",
    "msb trial --task uv --save out/unwrapped data_stubs/checkpoint",
    "msb trial --task intersections --weld exact --json - data_stubs/checkpoint",
)
_WORDS: dict[Outcome, str] = {"works": "works", "care": "with care", "fails": "FAILS", "not_run": "not run"}
_STYLES: dict[Outcome, str] = {"works": "green", "care": "yellow", "fails": "red", "not_run": "dim"}
"""Outcome -> colour; the word says the same without it."""


def trial(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="ASSET...", help="A .triasset, mesh file or checkpoint, or a folder or pattern of these."
        ),
    ],
    tasks: Annotated[
        list[str] | None,
        typer.Option(
            "--task",
            metavar="TASK",
            help="uv, decimate, subdivide, boolean, collision, solid, intersections. May be given again. "
            "Default: all.",
        ),
    ] = None,
    weld: Annotated[
        str | None, typer.Option(metavar="exact|EPS", help="Merge coincident vertices first.")
    ] = None,
    repair: Annotated[
        bool, typer.Option("--repair", help="Repair the mesh first, as msb repair does by default.")
    ] = False,
    plan: Annotated[
        str | None, typer.Option(metavar="STEPS", help="Repair the mesh first by these steps of msb repair.")
    ] = None,
    cameras: Cameras = None,
    chosen: Chosen = None,
    seconds: Annotated[float, typer.Option(help="Limit of each library for each task.")] = 60.0,
    memory: Annotated[float, typer.Option(metavar="GIB", help="Limit of memory, in GiB.")] = 4.0,
    save: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="Keep what was made: GLB (uv with its UVs), and a picture of each task."
        ),
        WRITTEN,
    ] = None,
    fail_on: Annotated[
        list[str] | None,
        typer.Option(metavar="TASK", help="Fail if this task fails or cannot be run. May be given again."),
    ] = None,
    device: DeviceName = None,
    json_file: JsonFile = None,
    json_lines: JsonLines = None,
    fail_fast: FailFast = False,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Try what artists do with meshes: unwrap, decimate, subdivide, cut, make a collision shape, print.

    Each task is done by the libraries that artists' tools use, on the mesh as it is stored (or welded, or
    repaired, on request), in a process that is ended at its limits. How the results look is judged by
    --cameras, else by the cameras of the training where they lie beside the model, else by views round it.
    """
    from msb.base.children import Limits
    from msb.cli.inputs import expand
    from msb.repair.plan import DEFAULT, parse_plan
    from msb.trial.registry import check_libraries, chosen_tasks

    output = Output(json_file, quiet, verbose, force, json_lines)
    gated = {task.name for task in chosen_tasks(fail_on)} if fail_on else set()
    known = chosen_tasks(tasks or [])
    if away := gated - {task.name for task in known}:
        raise UsageError("USAGE", f"--fail-on names {min(away)}, which --task leaves out")
    check_libraries(known)
    limits = Limits(seconds, memory)
    steps = parse_plan(plan) if plan is not None else DEFAULT if repair else None
    views = None if cameras is None else _views(cameras, chosen)
    if cameras is None and chosen:
        raise UsageError("USAGE", "--camera goes with --cameras")
    output.check_outputs()
    output.check_free(save, folder=True)
    if not limits.limits_memory:
        output.note("warning: this system has no limit of memory for a process; only --seconds holds")
    first = (_weld(weld), steps)
    run = _Run(output, [task.name for task in known], first, views, limits, device, save, gated)
    status = 0
    inputs = [one for path in paths for one in expand(path)]
    if save is not None and len(inputs) > 1:
        raise UsageError("USAGE", f"--save takes one mesh; there are {len(inputs)}")
    documents: list[dict[str, Any]] = []
    for path in inputs:
        if status and fail_fast:
            break
        try:
            found = run.one(path)
        except MsbError as error:
            status = max(status, report_error(error))
            documents.append(failure(_schema(), path, error))
            continue
        documents.append({**found.to_dict(), "path": str(path)})
        for failed in run.failures(found, path):
            status = max(status, report_error(failed))
    if len(documents) > 1 or (documents and "error" not in documents[0]):
        output.write_documents(documents)
    raise typer.Exit(status)


def _schema() -> str:
    from msb.trial.run import SCHEMA

    return SCHEMA


def _weld(text: str | None) -> Weld | None:
    if text is None:
        return None
    from msb.topology.weld import parse_weld

    return parse_weld(text)


def _views(cameras: str, chosen: list[str] | None) -> list[Camera]:
    from msb.cli.camera_options import choose_cameras
    from msb.scenes import read_cameras

    return choose_cameras(read_cameras(cameras), chosen, None, None)


class _Run:
    """One run of the command."""

    def __init__(
        self,
        output: Output,
        tasks: list[str],
        first: tuple[Weld | None, tuple[str, ...] | None],
        views: list[Camera] | None,
        limits: Limits,
        device: str | None,
        save: Path | None,
        gated: set[str],
    ) -> None:
        self.output, self.tasks, self.views = output, tasks, views
        self.weld, self.plan = first
        self.limits, self.device, self.save, self.gated = limits, device, save, gated
        self.printed = False

    def one(self, path: Path) -> Trials:
        """Try the tasks on what is at `path`, keep what was made, and print the table."""
        from msb.base.atomic import new_folder
        from msb.cli.inputs import open_asset

        with self.output.progress(f"reading {path.name}"):
            asset = open_asset(path, self.output)
        if self.save is None:
            found = self.tried(asset, None, path)
        else:
            with new_folder(self.save) as folder:
                found = self.tried(asset, folder, path)
        if "no_pictures" in found.cameras:
            self.output.note(f"{found.cameras['no_pictures']}; so nothing is judged by how it looks")
        elif "see_nothing" in found.cameras:
            self.output.note(
                f"{found.cameras['see_nothing']} of the views see none of the mesh, and do not count"
            )
        if self.output.prints_text:
            self.show(found, path)
        return found

    def tried(self, asset: Any, folder: Path | None, path: Path) -> Trials:
        """Return what became of the tasks, which a bar counts."""
        from msb.trial.run import try_asset

        with self.output.counted("trying", len(self.tasks)) as step:

            def watch(one: Trial) -> None:
                step()
                self.output.note(f"{one.task}: {_WORDS[one.outcome]}, {one.seconds:.1f} s", level=1)

            return try_asset(
                asset,
                self.tasks,
                weld=self.weld,
                repair=self.plan,
                cameras=self.views,
                limits=self.limits,
                device=self.device,
                keep=folder,
                watch=watch,
            )

    def show(self, found: Trials, path: Path) -> None:
        """Print the table, or with --quiet what it comes to."""
        from rich.markup import escape

        from msb.trial.run import summary

        name = one_line(str(path))
        if self.output.quiet:
            echo(f"{name}: {summary(found.trials)}")
            return
        if self.printed:
            echo()
        self.printed = True
        welded = "" if self.weld is None else ", welded"
        if self.plan is not None:
            welded += f", repaired by {','.join(self.plan)}"
        echo(f"{name}: {found.mesh['vertices']:,} vertices, {found.mesh['faces']:,} faces{welded}")
        echo(f"views: {found.cameras['views']}")
        table = plain_table(
            "Task", "Outcome", "Seconds", "What was made, and what is wrong with it", right=(2,)
        )
        for one in found.trials:
            style = _STYLES[one.outcome]
            spent = "-" if one.outcome == "not_run" else f"{one.seconds:.1f}"
            outcome = f"[{style}]{_WORDS[one.outcome]}[/{style}]"
            table.add_row(one.title, outcome, spent, escape(one_line(_line(one))))
        console = self.output.console()
        if not console.is_terminal:
            console.width = 10_000  # no table is as wide
        console.print(table)
        if self.save is not None:
            files = ", ".join(file for one in found.trials for file in one.files)
            echo(f"kept in {one_line(str(self.save))}: {files}")

    def failures(self, found: Trials, path: Path) -> list[GateFailed]:
        """Return the gates of --fail-on that failed."""
        return [
            GateFailed("GATE_FAILED", f"{one.task} {_SAID[one.outcome]}: {one.why}", file=path)
            for one in found.trials
            if one.task in self.gated and one.outcome in _SAID
        ]


_SAID: dict[Outcome, str] = {"fails": "fails", "not_run": "is not run"}
"""The outcomes on which a gate fails."""


def _line(one: Trial) -> str:
    """Return the numbers of a trial, and why it is not better."""
    return "; ".join(filter(None, (one.says, one.why)))
