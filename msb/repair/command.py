"""`msb repair`: make a mesh manifold and consistently wound, or compare repair plans."""

from __future__ import annotations

import math
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
from msb.render.options import ONLY_GENERATED, RendererOptions, Source, ViewOptions
from msb.repair.options import PLAN_STEPS, STEPS

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from rich.console import Console

    from msb.asset import Asset
    from msb.meshes import Mesh
    from msb.repair import Options, Repaired
    from msb.repair.run import Outcome
    from msb.topology import Audit
    from msb.trial.repairs import StrategyResult, TierLikeness
    from msb.trial.run import Trial

MIN_FACES_KEPT = 0.9  # share; a repair that removes more faces is recommended only if the images stay alike
MIN_LIKENESS = 40.0  # dB of the repaired mesh to the stored mesh; differences above are hard to see


@dataclass(frozen=True)
class RepairOptions:
    """The options of `msb repair`."""

    out: Annotated[
        Path | None,
        Option("Write the mesh to FILE, instead of OUT.", ("--out", "-o"), metavar="FILE", output="own"),
    ] = None
    plan: Annotated[
        str | None,
        Option(f"{PLAN_STEPS} Default: orient,pair.", metavar="STEPS"),
    ] = None
    compare: Annotated[bool, Option("Compare several plans instead of writing a repaired mesh.")] = False
    peer: Annotated[
        Literal["igl", "pymeshlab"] | None,
        Option("Use libigl for cut, or PyMeshLab for drop, in a child process.", ("--with",)),
    ] = None
    tasks: Annotated[
        tuple[str, ...],
        Option(
            "With --compare: run this task of msb trial on every result (none: no task). May be repeated. "
            "Default: uv, decimate_50, subdivide, boolean, solid.",
            ("--task",),
            metavar="TASK",
        ),
    ] = ()
    maps: Annotated[
        Path | None,
        file_option("Write the original row of each vertex and face to an .npz file.", endings=(".npz",)),
    ] = None


@command(
    "msb repair data_stubs/checkpoint out/repaired.triasset",
    "msb repair data_stubs/checkpoint out/fewer.glb --plan drop,orient,debris",
    'msb repair -q --fail-on "components>999" data_stubs/checkpoint out/g.ply',
    "msb repair --compare --task solid \\\n      data_stubs/models/walled/mesh_splatting out/costs",
    instead={f"--{step}": f"--plan {step}{{value}}" for step in STEPS},
)
def repair(
    source: Source,
    target: Annotated[
        Path | None,
        Argument(
            "The .triasset or mesh file to write; with --compare, a folder for images.",
            metavar="OUT",
            output="own",
        ),
    ] = None,
    *,
    options: RepairOptions,
    views: Annotated[ViewOptions, ("cameras", "kind")],
    limits: Limits,
    conditions: Annotated[GateOptions, ("fail_on", "fail_on_verdict")],
    drawing: Annotated[RendererOptions, ("device",)],
    output: JsonOutput,
    typed: Typed,
) -> int:
    """Repair a mesh and keep the data of its vertices and faces. ASSET is not changed.

    The default plan does not change the appearance of the model. The default plan turns faces to a consistent
    winding, and cuts edges of more than two faces. At a cut edge, the pairs of faces that are closest to flat
    stay connected. A .triasset file keeps its method.

    With --compare, no mesh is written. With --compare, a table shows the remaining faces, the image quality
    and the working tasks of each plan.
    """
    from msb.repair.plan import parse_plan

    require(target or options.out or options.compare, "Missing OUT. Pass the .triasset or mesh file to write")
    if target is not None:
        typed.reject(["out"], "repeats the argument OUT; pass only one of them")
    if options.compare:
        typed.reject(["maps", "fail_on", "fail_on_verdict", "peer"], "cannot be combined with --compare")
    else:
        typed.reject(["tasks", "kind"], "needs --compare")
    if views.cameras is not None:
        typed.reject(["kind"], ONLY_GENERATED)
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
    """One run of the command msb repair. The output path is checked before any input is read."""

    def __init__(
        self,
        source: Path,
        target: Path,
        plan: Options,
        views: ViewOptions,
        device: str | None,
        output: Output,
    ) -> None:
        from msb.adapters.locate import is_mesh_file
        from msb.asset import ASSET_SUFFIX
        from msb.delivery.saving import output_suffix

        self.source, self.target, self.plan, self.output = source, target, plan, output
        self.views, self.device = views, device
        self.suffix = output_suffix(target, "OUT")
        if views.cameras is not None and not {"debris", "drop"} & set(plan.plan):
            raise UsageError("USAGE", "--cameras needs debris or drop in --plan")
        output.check_free(target, label="OUT")
        self.to_asset = self.suffix == ASSET_SUFFIX
        self.in_file_precision = not self.to_asset and is_mesh_file(source) and views.cameras is None

    def run(self, maps: Path | None) -> Audit:
        """Repair, write and print. Return the audit of the written file."""
        from msb.meshes.losses import explain_split
        from msb.repair.run import list_defects

        repaired, done, left_out = self.repair_mesh() if self.in_file_precision else self.repair_asset()
        with self.write_maps(done, maps):
            after = self.write(repaired, done.after, left_out)
        splits = done.after.counts.all_apart != after.judged.counts.all_apart
        left = list_defects(after, explain_split(self.suffix) if splits else None)
        self.output.write_json(self.document(done, after, left))
        if self.output.prints_text:
            self.show(done, after, left, splits=splits)
        return after

    @contextmanager
    def write_maps(self, done: Repaired | Outcome, maps: Path | None) -> Iterator[None]:
        """Write the maps to a temporary file. Move the file into place after the block has written OUT.

        Either both files or neither file are written.
        """
        from msb.base.atomic import is_stream, new_file
        from msb.base.npz import write_npz

        with ExitStack() as stack:
            if maps is not None:
                file = stack.enter_context(new_file(maps, overwrite=self.output.force))
                arrays = {"vertex": done.vertex_map, "face": done.face_map, "turned": done.turned}
                write_npz(file, arrays)
                file.flush()  # Flushing fails if the disk is full.
                if is_stream(maps):  # Closing the stream may fail, so close it before OUT is written.
                    stack.close()
            yield

    def repair_asset(self) -> tuple[Asset | Mesh, Repaired, Sequence[str]]:
        """Repair an asset. Return the asset, or its standard-tier mesh if OUT is a mesh file.

        Also return the parts of the asset that the mesh file cannot store.
        """
        from msb.api.command_files import open_asset
        from msb.meshes.assets import mesh_from_asset
        from msb.meshes.losses import describe_up_axis, list_dropped_features
        from msb.repair.assets import repair_asset

        asset = open_asset(self.source, self.output)
        weights = None if self.views.cameras is None else self.pixels(asset)
        with self.output.progress(f"repairing {self.source.name}"), about(self.source):
            done = repair_asset(asset, self.plan, weights)
        _note_turned(asset, done, self.output)
        if self.to_asset:
            return done.asset, done, ()
        mesh = mesh_from_asset(done.asset)
        known = asset.manifest.coordinate_frame.known_up is not None
        for text in describe_up_axis(mesh, self.suffix, known=known):
            self.output.note(f"{self.target}: {text}")
        return mesh, done, list_dropped_features(done.asset)

    def pixels(self, asset: Asset) -> NDArray[Any]:
        """Return the number of pixels (F,) that each face covers in the views of --cameras."""
        from msb.repair.coverage import count_pixels

        cameras = self.views.read(self.output.note)
        with self.output.counted("rendering views", len(cameras)) as step:
            return count_pixels(asset, cameras, self.device, step)

    def repair_mesh(self) -> tuple[Mesh, Outcome, Sequence[str]]:
        """Repair a mesh file in the precision of its coordinates.

        Also return the parts of the file that were not read.
        """
        from msb.meshes import read_mesh
        from msb.repair.assets import repair_mesh

        with self.output.progress(f"reading {self.source.name}"):
            mesh = read_mesh(self.source)
        with self.output.progress(f"repairing {self.source.name}"), about(self.source):
            return *repair_mesh(mesh, self.plan), mesh.left_out

    def write(self, repaired: Asset | Mesh, after: Audit, left_out: Sequence[str]) -> Audit:
        """Write the repaired asset or mesh, and return the audit of the file.

        The argument `after` is the audit of the repaired mesh. The argument `left_out` lists the parts of the
        input that the repaired mesh does not contain.
        """
        from msb.api.command_files import write_mesh_files
        from msb.asset import Asset
        from msb.delivery.saving import save
        from msb.meshes.assets import fit_to_format
        from msb.meshes.losses import list_losses
        from msb.topology import audit_arrays

        with self.output.progress(f"writing {self.target.name}"), about(self.source):
            if isinstance(repaired, Asset):
                save(repaired, self.target, overwrite=self.output.force)
                return after
            stored = fit_to_format(repaired, self.suffix)
            write_mesh_files(stored, self.target, self.output)
        for text in list_losses(repaired, stored, self.suffix, left_out):
            self.output.note(f"{self.target}: {text}")
        audit, _ = audit_arrays(stored.vertices, stored.faces, attributes=stored.attributes)
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
        """Print the verdict and, unless --quiet, the steps, the remaining defects and the next command.

        `splits` is true if the file format gives each face separate vertices.
        """
        from msb.api.auditing import next_command
        from msb.repair.plan import parse_plan
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
        echo(f"Remaining defects: {', '.join(left) or 'none'}")
        source, target = shell_word(source), shell_word(target)
        echo(f"To see the changes: msb view {source} --repaired {target}")
        # The last line names the remaining defects. Running the same plan again would not change the mesh.
        plan = judge(after).plan
        if plan not in ("", "bake") and self.plan.covers(parse_plan(plan)):
            plan = "bake"
        suffix = ".glb" if plan == "bake" else self.suffix
        output = shell_word(one_line(str(self.target.with_suffix(""))) + f"_next{suffix}")
        if command := next_command(after, target, output, plan):
            echo(f"Next, for the remaining defects: {command}")


def _note_turned(asset: Asset, done: Repaired, output: Output) -> None:
    """Print a note that turned faces look different if back faces are culled."""
    turned = int(done.turned.sum())
    if turned:
        stored = asset.manifest.settings.get("back_culling")
        culls = "; this asset has back_culling on" if stored is not None and stored.value else ""
        text = "with back-face culling, turned faces are visible from the other side"
        output.note(f"{turned:,} of {len(done.turned):,} faces were turned; {text}{culls}")


_NAMES = (
    *("Strategy", "Kept", "Added", "Cut", "Pieces", "Bound.", "Verdict"),
    *("Tasks", "Standard", "Dedicated", "MB", "Seconds"),
)
# Columns of the table that are left-aligned.
_WORDS = ("Strategy", "Verdict", "Tasks")
# Columns to omit in narrow terminals, in this order.
_OPTIONAL = ("MB", "Added", "Bound.", "Seconds", "Cut")
# The value of --task that selects no task.
NO_TASK = "none"


def compare_strategies(
    source: Path,
    folder: Path | None,
    options: Options,
    views: ViewOptions,
    tasks: Sequence[str],
    device: str | None,
    output: Output,
) -> None:
    """Compare plans with `msb.trial.repairs`: print a table, and write JSON and an image of each result."""
    from msb.api.command_files import open_asset
    from msb.base.own_folder import own_folder
    from msb.trial.repairs import compare, document, list_strategies
    from msb.views import choose_views

    selected = _select_tasks(tasks)
    if folder is not None:
        output.check_folder(folder)
    asset = open_asset(source, output)
    given = None if views.cameras is None else views.read(output.note)
    with about(source):
        chosen = choose_views(asset, given, size=(960, 720), device=device, kind=views.kind)
        chosen = chosen.without_blind(asset, device)
    description = (
        chosen.description if given is None else chosen.description.replace("given", f"of {views.cameras}")
    )
    rows = None
    try:
        with (
            output.counted("comparing plans", len(list_strategies(options)) + 1) as step,
            nullcontext() if folder is None else own_folder(folder, overwrite=output.force) as keep,
        ):
            rows = compare(asset, chosen, options, tasks=selected, device=device, keep=keep, step=step)
    finally:  # Print the comparison even if images cannot be written.
        if rows is not None:
            if output.prints_text:
                _print_comparison(rows, description, output)
            output.write_json(document(str(source), description, rows))


def _select_tasks(given: Sequence[str]) -> list[str]:
    """Return the names of the selected tasks. If no tasks are selected, return the default tasks."""
    from msb.trial.registry import select_tasks
    from msb.trial.repairs import TASKS

    if given == (NO_TASK,):
        return []
    return [task.name for task in select_tasks(given or TASKS)]


def _print_comparison(rows: list[StrategyResult], views: str, output: Output) -> None:
    """Print the comparison. The argument `views` names the views used for the PSNR, such as "8 test
    views"."""
    console = output.console()
    if not console.is_terminal:
        console.width = 10_000  # A width in characters that is larger than any table.
    print_table([_format_cells(row) for row in rows], console)
    if output.quiet:
        return
    stored = rows[0]
    if stored.before is not None and stored.before.judged.corners_coincide is False:
        echo("No two corners coincide, so the faces cannot be merged into a surface.")
    for row in rows:
        if row.why is not None:
            echo(f"{row.strategy}: {row.why}")
    if advice := recommend(rows):
        echo(advice)
    tried = [trial.task for trial in stored.trials if trial.outcome != "not_run"]
    if tried:
        echo(
            f"Tasks: the number of {', '.join(tried)} that work, some of them with limitations (details: "
            f"msb trial)"
        )
    for trial in stored.trials:
        if trial.outcome == "not_run":
            echo(f"{trial.task}: not run: {trial.why}")
    looks = [(tier, look.why) for row in rows for tier, look in (row.looks or {}).items() if look.why]
    for tier, why in dict.fromkeys(looks):
        echo(f"{tier.capitalize()}: not rendered: {why}")
    if any(look.same or look.psnr is not None for look in (stored.looks or {}).values()):
        echo(f"Standard, Dedicated: PSNR in dB against the unrepaired asset, averaged over {views}.")


def recommend(rows: list[StrategyResult]) -> str:
    """Recommend the row of the table with the best verdict. Among equal rows, the most tasks, the fewest
    defects and then the highest similarity decide.

    A repair that removes visible parts of the mesh is never recommended.
    """
    from msb.topology.verdict import judge
    from msb.trial.repairs import count_passed

    def rank(row: StrategyResult) -> tuple[float, ...]:
        assert row.after is not None
        assert row.looks is not None
        counts = row.after.judged.counts
        defects = counts.nonmanifold_vertices + counts.boundary_edges + counts.duplicate_faces
        looks = [0.0 if look.psnr is None else -look.psnr for look in row.looks.values() if not look.same]
        level = ("ok", "limited", "bad").index(judge(row.after).level)
        return level, -count_passed(row.trials), defects, max(looks, default=-1000.0)

    def keeps_shape(row: StrategyResult) -> bool:
        assert row.before is not None
        assert row.looks is not None
        close = all(look.same or (look.psnr or math.inf) >= MIN_LIKENESS for look in row.looks.values())
        return close or row.faces_kept >= MIN_FACES_KEPT * row.before.counts.faces

    done = [row for row in rows if row.after is not None and row.looks is not None]
    if not done:
        return ""
    kept = [row for row in done if keeps_shape(row)]
    best = min(kept, key=rank)  # If rows are equally good, prefer the unrepaired asset.
    none_better = "no repair is better" + (" without removing visible faces" if kept != done else "")
    reason = none_better if best is rows[0] else "best verdict, then most tasks"
    return f"Recommended: {best.strategy} ({reason})"


def _format_cells(row: StrategyResult) -> list[str]:
    """Return the table cells of one plan."""
    from msb.topology.metric_text import format_metric
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
        "-" if ratio is None else format_metric("boundary_edge_ratio", ratio),
        judge(row.after).word,
        _format_passed(row.trials),
        *(_format_likeness(look) for look in row.looks.values()),
        f"{row.size / 1e6:.2f}",
        f"{row.seconds:.1f}",
    ]


def print_table(rows: list[list[str]], console: Console) -> None:
    """Print the table, and omit columns that do not fit into the terminal.

    Omit empty columns first.
    """
    full = [[*row, *[""] * (len(_NAMES) - len(row))] for row in rows]
    empty = [name for name, *cells in zip(_NAMES, *full, strict=True) if not {*cells} - {"", "-"}]
    boundless = console.options.update(width=10_000)
    order = [*empty, *(name for name in _OPTIONAL if name not in empty)]
    for count in range(len(order) + 1):
        names = [name for name in _NAMES if name not in order[:count]]
        table = plain_table(*names, right=tuple(i for i, name in enumerate(names) if name not in _WORDS))
        for row in full:
            table.add_row(*(cell for name, cell in zip(_NAMES, row, strict=True) if name in names))
        if console.measure(table, options=boundless).maximum <= console.width:
            break
    console.print(table)
    if omitted := order[len(empty) : count]:
        console.print(f"[dim]Omitted columns (use a wider terminal or --json): {', '.join(omitted)}[/dim]")


def _format_passed(trials: tuple[Trial, ...]) -> str:
    """Return a text with the number of working tasks and the number of all tasks, such as "2 of 5"."""
    from msb.trial.repairs import count_passed

    done = [trial for trial in trials if trial.outcome != "not_run"]
    return f"{count_passed(done)} of {len(done)}" if done else "-"


def _format_likeness(look: TierLikeness) -> str:
    """Return the PSNR on one tier, "same" for equal images, or "-" without images."""
    if look.same:
        return "same"
    return "-" if look.psnr is None else f"{look.psnr:.1f}"
