"""`msb repair`: make a mesh manifold and consistently wound, or see what each way to do so costs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from msb.api.gates import GateOptions
from msb.base.limits import Limits
from msb.base.option import Argument, Option
from msb.base.paths import shell_word
from msb.cli.command import Typed, command, option_value, require
from msb.cli.output import JsonOutput, Output, echo, file_option, plain_table, report_error
from msb.errors import UsageError, about, one_line
from msb.render.options import Drawing, Source, Views

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from rich.console import Console

    from msb.asset import Asset
    from msb.meshes import Mesh
    from msb.repair import Options, Repaired
    from msb.repair.run import Outcome
    from msb.topology import Audit
    from msb.trial.repairs import Look, Row
    from msb.trial.run import Trial


@dataclass(frozen=True)
class RepairOptions:
    """What is done to a mesh, and what is written of it."""

    out: Annotated[
        Path | None, Option("OUT, given as an option.", ("--out", "-o"), metavar="FILE", output="own")
    ] = None
    plan: Annotated[
        str | None,
        Option(
            "Some of orient,pair,cut,drop,weld,debris,close, numbers after them: weld:0.01, pair:0.25, "
            "debris:10:0, close:8:0.25. Default: orient,pair.",
            metavar="STEPS",
        ),
    ] = None
    compare: Annotated[bool, Option("Write nothing; try ways to repair and show what each costs.")] = False
    peer: Annotated[
        Literal["igl", "pymeshlab"] | None,
        Option("Let libigl do cut, or PyMeshLab do drop, in a process of its own.", ("--with",)),
    ] = None
    tasks: Annotated[
        tuple[str, ...],
        Option(
            "With --compare: a task of msb trial to try, or none. May be given again. "
            "Default: uv, decimate_50, subdivide, boolean, solid.",
            ("--task",),
            metavar="TASK",
        ),
    ] = ()
    maps: Annotated[
        Path | None,
        file_option("Write an .npz with the rows of ASSET that rows of OUT come from.", endings=(".npz",)),
    ] = None


@command(
    "msb repair data_stubs/checkpoint out/repaired.triasset",
    "msb repair data_stubs/checkpoint out/fewer.glb --plan drop,orient,debris",
    'msb repair -q --fail-on "components>999" data_stubs/checkpoint out/g.ply',
    "msb repair --compare --task solid \\\n      data_stubs/models/walled/mesh_splatting out/costs",
)
def repair(
    source: Source,
    target: Annotated[
        Path | None,
        Argument("What to write; with --compare a folder for pictures.", metavar="OUT", output="own"),
    ] = None,
    *,
    options: RepairOptions,
    views: Annotated[Views, ("cameras",)],
    limits: Limits,
    conditions: Annotated[GateOptions, ("fail_on", "fail_on_verdict")],
    drawing: Annotated[Drawing, ("device",)],
    output: JsonOutput,
    typed: Typed,
) -> int:
    """Repair a mesh, keeping what its vertices and faces hold; ASSET itself is never changed.

    By default nothing visible changes: faces are turned to a consistent winding, and where more than two
    meet at an edge those that continue each other stay together. A .triasset stays one of its method.

    With --compare nothing is repaired: a table shows what each way would keep, and what it costs.
    """
    from msb.repair.plan import parse_plan

    require(target or options.out or options.compare, "Missing OUT. Pass the .triasset or mesh file to write")
    if target is not None:
        typed.reject(["out"], "names OUT a second time")
    if options.compare:
        typed.reject(["maps", "fail_on", "fail_on_verdict", "peer"], "does not go with --compare")
    else:
        typed.reject(["tasks"], "needs --compare")
    target = target or options.out
    with option_value("--plan"):
        plan = parse_plan(options.plan, peer=options.peer, limits=limits)
    drawing.check_device()
    if options.compare:
        compare_strategies(source, target, plan, views, options.tasks, drawing.device, output)
        return 0
    assert target is not None
    gates = conditions.gates()
    after = _Repair(source, target, plan, views, drawing.device, output).run(options.maps)
    failed = [error for gate in gates if (error := gate.check(after, target))]
    return max(map(report_error, failed), default=0)


class _Repair:
    """One repair: where it goes is checked before anything is read."""

    def __init__(
        self, source: Path, target: Path, plan: Options, views: Views, device: str | None, output: Output
    ) -> None:
        from msb.adapters.locate import is_mesh_file
        from msb.asset import ASSET_SUFFIX
        from msb.delivery.saving import output_suffix

        self.source, self.target, self.plan, self.output = source, target, plan, output
        self.views, self.device = views, device
        self.suffix = output_suffix(target, "OUT")
        if views.cameras is not None and not {"debris", "drop"} & set(plan.plan):
            raise UsageError("USAGE", "--cameras weigh faces for debris and drop, which are not in --plan")
        output.check_free(target)
        self.to_asset = self.suffix == ASSET_SUFFIX
        self.in_file_precision = not self.to_asset and is_mesh_file(source) and views.cameras is None

    def run(self, maps: Path | None) -> Audit:
        """Repair, write and print; return the audit of what was written."""
        from msb.meshes.losses import why_split
        from msb.repair.run import what_is_left

        made, done, left_out = self.repair_mesh() if self.in_file_precision else self.repair_asset()
        with self.rows_kept(done, maps):
            after = self.write(made, done.after, left_out)
        splits = done.after.counts.all_apart != after.judged.counts.all_apart
        left = what_is_left(after, why_split(self.suffix) if splits else None)
        self.output.write_json(self.document(done, after, left))
        if self.output.prints_text:
            self.show(done, after, left, splits=splits)
        return after

    @contextmanager
    def rows_kept(self, done: Repaired | Outcome, maps: Path | None) -> Iterator[None]:
        """Write the maps, which take their place when the block that writes OUT ends.

        It is both or neither, but for a file that another program puts in the maps' place meanwhile.
        """
        from msb.base.atomic import is_stream, new_file
        from msb.base.npz import write_npz

        with ExitStack() as stack:
            if maps is not None:
                file = stack.enter_context(new_file(maps, overwrite=self.output.force))
                arrays = {"vertex": done.vertex_map, "face": done.face_map, "turned": done.turned}
                write_npz(file, arrays)
                file.flush()  # a full disk is noticed here
                if is_stream(maps):  # gets everything at the end, which must not fail after OUT is there
                    stack.close()
            yield

    def repair_asset(self) -> tuple[Asset | Mesh, Repaired, Sequence[str]]:
        """Repair an asset; if OUT is a mesh file, return its standard-tier mesh and what that lacks."""
        from msb.api.command_files import open_asset
        from msb.meshes.assets import mesh_from_asset
        from msb.meshes.losses import beyond_a_mesh, what_is_up
        from msb.repair.assets import repair_asset

        asset = open_asset(self.source, self.output)
        weights = None if self.views.cameras is None else self.pixels(asset)
        with self.output.progress(f"repairing {self.source.name}"), about(self.source):
            done = repair_asset(asset, self.plan, weights)
        _note_turned(asset, done, self.output)
        if self.to_asset:
            return done.asset, done, ()
        made = mesh_from_asset(done.asset)
        known = asset.manifest.coordinate_frame.known_up is not None
        for text in what_is_up(made, self.suffix, known=known):
            self.output.note(f"{self.target}: {text}")
        return made, done, beyond_a_mesh(done.asset)

    def pixels(self, asset: Asset) -> NDArray[Any]:
        """Return how many pixels each face covers."""
        from msb.repair.coverage import seen_pixels

        cameras = self.views.read(self.output.note)
        with self.output.counted("looking at faces", len(cameras)) as step:
            return seen_pixels(asset, cameras, self.device, step)

    def repair_mesh(self) -> tuple[Mesh, Outcome, Sequence[str]]:
        """Repair a mesh file in its own precision; return what its source has beside the mesh, too."""
        from msb.meshes import read_mesh
        from msb.repair.assets import repair_mesh

        with self.output.progress(f"reading {self.source.name}"):
            mesh = read_mesh(self.source)
        with self.output.progress(f"repairing {self.source.name}"), about(self.source):
            return *repair_mesh(mesh, self.plan), mesh.left_out

    def write(self, made: Asset | Mesh, after: Audit, left_out: Sequence[str]) -> Audit:
        """Write what was repaired, whose audit is `after`; return the audit of the file."""
        from msb.api.command_files import write_mesh_files
        from msb.asset import Asset
        from msb.delivery.saving import save
        from msb.meshes.assets import as_held
        from msb.meshes.losses import losses
        from msb.topology import audit_arrays

        with self.output.progress(f"writing {self.target.name}"), about(self.source):
            if isinstance(made, Asset):
                save(made, self.target, overwrite=self.output.force)
                return after
            held = as_held(made, self.suffix)
            write_mesh_files(held, self.target, self.output)
        for text in losses(made, held, self.suffix, left_out):
            self.output.note(f"{self.target}: {text}")
        audit, _ = audit_arrays(held.vertices, held.faces, attributes=held.attributes)
        return replace(audit, path=after.path, method=after.method)

    def document(self, done: Repaired | Outcome, written: Audit, left: list[str]) -> dict[str, Any]:
        """Return the JSON data of the repair."""
        before, after = done.before.to_dict(), written.to_dict()
        return {
            "schema": "msb.repair/1",
            "path": str(self.source),
            "output": str(self.target),
            "plan": list(self.plan.plan),
            "steps": [step.to_dict() for step in done.steps],
            "edges_cut": len(done.cut_edges),
            "faces_turned": int(done.turned.sum()),
            "left": left,
            "before": {key: before[key] for key in ("counts", "metrics")},
            "after": {key: after[key] for key in ("counts", "metrics")},
            "verdict_before": before["verdict"],
            "verdict_after": after["verdict"],
        }

    def show(self, done: Repaired | Outcome, after: Audit, left: list[str], *, splits: bool) -> None:
        """Print the verdict on the result; unless quiet its steps, what is left and what comes next, too."""
        from msb.api.auditing import advice
        from msb.topology.verdict import judge

        source, target = (one_line(str(path)) for path in (self.source, self.target))
        echo(f"{target}: {judge(after).word}; {source} was {judge(done.before).word}")
        if self.output.quiet:
            return
        self.output.table(
            ("Step", "Faces removed", "added", "turned", "Vertices removed", "added", "Seconds"),
            [
                (step.step, *(f"{count:,}" for count in step.counts), f"{step.seconds:.2f}")
                for step in done.steps
            ],
            right=range(1, 7),
        )
        for note in dict.fromkeys(note for step in done.steps for note in step.notes):
            echo(one_line(note))
        pieces = [audit.judged.counts.components for audit in (done.before, done.after, after)]
        in_file = f", {pieces[2]:,} in the file" if splits else ""
        cut = f"edges cut{' by the repair' if splits else ''}: {len(done.cut_edges):,}"
        echo(f"Components: {pieces[0]:,} before, {pieces[1]:,} after{in_file}; {cut}")
        echo(f"Left: {'; '.join(left) or 'nothing'}")
        source, target = shell_word(source), shell_word(target)
        helps = advice(done.before, f"--force -o {target}", source)
        if helps and "weld" not in self.plan.plan:
            echo(helps)
        echo(f"next: msb view {source} --repaired {target}")


def _note_turned(asset: Asset, done: Repaired, output: Output) -> None:
    """Say what turned faces change where back faces are culled."""
    turned = int(done.turned.sum())
    if turned:
        stored = asset.manifest.settings.get("back_culling")
        culls = "; this asset has back_culling on" if stored is not None and stored.value else ""
        text = "where back faces are culled they show from the other side"
        output.note(f"{turned:,} of {len(done.turned):,} faces were turned: {text}{culls}")


_NAMES = (
    *("Strategy", "Kept", "Added", "Cut", "Pieces", "Bound.", "Verdict"),
    *("Tasks", "Standard", "Dedicated", "MB", "Seconds"),
)
_WORDS = ("Strategy", "Verdict", "Tasks")  # columns that are aligned to the left
# Columns that a narrow terminal leaves out, in this order.
_LEAST_WANTED = ("MB", "Added", "Bound.", "Seconds", "Cut")
# What --task takes for no task at all.
NO_TASK = "none"


def compare_strategies(
    source: Path,
    folder: Path | None,
    options: Options,
    views: Views,
    tasks: Sequence[str],
    device: str | None,
    output: Output,
) -> None:
    """Print the table of `msb.trial.repairs`, and write its JSON and a picture of each strategy."""
    from msb.api.command_files import open_asset
    from msb.base.own_folder import own_folder
    from msb.trial.repairs import compare, document, strategies
    from msb.views import choose_views

    wanted = _tasks(tasks)
    if folder is not None:
        output.check_folder(folder)
    asset = open_asset(source, output)
    given = None if views.cameras is None else views.read(output.note)
    with about(source):
        seen = choose_views(asset, given, size=(960, 720), device=device).seeing(asset, device)
    which = seen.said if given is None else seen.said.replace("given", f"of {views.cameras}")
    rows = None
    try:
        with (
            output.counted("trying repairs", len(strategies(options)) + 1) as step,
            nullcontext() if folder is None else own_folder(folder, overwrite=output.force) as keep,
        ):
            rows = compare(asset, seen, options, tasks=wanted, device=device, keep=keep, step=step)
    finally:  # it is said even if pictures cannot be kept: minutes of work
        if rows is not None:
            if output.prints_text:
                _print(rows, which, output)
            output.write_json(document(str(source), which, rows))


def _tasks(given: Sequence[str]) -> list[str]:
    from msb.trial.registry import chosen_tasks
    from msb.trial.repairs import TASKS

    if given == (NO_TASK,):
        return []
    return [task.name for task in chosen_tasks(given or TASKS)]


def _print(rows: list[Row], which: str, output: Output) -> None:
    console = output.console()
    if not console.is_terminal:
        console.width = 10_000  # no table is as wide
    print_table([_cells(row) for row in rows], console)
    if output.quiet:
        return
    stored = rows[0]
    if stored.before is not None and stored.before.judged.corners_coincide is False:
        echo("No two corners coincide: it is no surface, and no repair makes it one.")
    for row in rows:
        if row.why is not None:
            echo(f"{row.strategy}: {row.why}")
    tried = [one.task for one in stored.tried if one.outcome != "not_run"]
    if tried:
        echo(f"Tasks: how many of {', '.join(tried)} work, with care or without; msb trial says why.")
    for one in stored.tried:
        if one.outcome == "not_run":
            echo(f"{one.task}: not run: {one.why}")
    looks = [(tier, look.why) for row in rows for tier, look in (row.looks or {}).items() if look.why]
    for tier, why in dict.fromkeys(looks):
        echo(f"{tier.capitalize()}: not drawn: {why}")
    if any(look.same or look.psnr is not None for look in (stored.looks or {}).values()):
        echo(f"PSNR in dB against the asset as stored, the mean over {which}.")


def _cells(row: Row) -> list[str]:
    from msb.topology.shown import structure_text
    from msb.topology.verdict import judge

    if row.before is None or row.after is None or row.looks is None:
        return [row.strategy, *[""] * (_NAMES.index("Verdict") - 1), "not done"]
    ratio = row.after.judged.metrics.boundary_edge_ratio
    return [
        row.strategy,
        f"{100 * row.faces_kept / max(row.before.counts.faces, 1):.1f} %",
        f"{row.faces_added:,}",
        f"{row.edges_cut:,}",
        f"{row.after.judged.counts.components:,}",
        "-" if ratio is None else structure_text("boundary_edge_ratio", ratio),
        judge(row.after).word,
        _passed_text(row.tried),
        *(_look_text(look) for look in row.looks.values()),
        f"{row.size / 1e6:.2f}",
        f"{row.seconds:.1f}",
    ]


def print_table(rows: list[list[str]], console: Console) -> None:
    """Print as much of the table as the terminal is wide; what says nothing is left out first."""
    full = [[*row, *[""] * (len(_NAMES) - len(row))] for row in rows]
    silent = [name for name, *cells in zip(_NAMES, *full, strict=True) if not {*cells} - {"", "-"}]
    boundless = console.options.update(width=10_000)
    order = [*silent, *(name for name in _LEAST_WANTED if name not in silent)]
    for count in range(len(order) + 1):
        names = [name for name in _NAMES if name not in order[:count]]
        table = plain_table(*names, right=tuple(i for i, name in enumerate(names) if name not in _WORDS))
        for row in full:
            table.add_row(*(cell for name, cell in zip(_NAMES, row, strict=True) if name in names))
        if console.measure(table, options=boundless).maximum <= console.width:
            break
    console.print(table)
    if lost := order[len(silent) : count]:
        console.print(f"[dim]A wider terminal and --json also show: {', '.join(lost)}[/dim]")


def _passed_text(trials: tuple[Trial, ...]) -> str:
    from msb.trial.repairs import passed

    done = [one for one in trials if one.outcome != "not_run"]
    return f"{passed(done)} of {len(done)}" if done else "-"


def _look_text(look: Look) -> str:
    if look.same:
        return "same"
    return "-" if look.psnr is None else f"{look.psnr:.1f}"
