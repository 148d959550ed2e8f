"""`msb repair`: make a mesh manifold and consistently wound, or see what each way to do so costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from msb.cli.camera_options import Cameras
from msb.cli.failures import report_error
from msb.cli.options import WRITTEN, DeviceName, Force, JsonFile, Quiet, Verbose, epilog, refuse
from msb.cli.output import Output
from msb.errors import UsageError, about

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from msb.asset import Asset
    from msb.meshes import Mesh
    from msb.repair.assets import Repaired
    from msb.repair.plan import Options
    from msb.repair.run import Outcome
    from msb.scenes import Camera
    from msb.topology import Audit

EPILOG = epilog(
    "msb repair data_stubs/checkpoint out/repaired.triasset",
    "msb repair data_stubs/checkpoint out/fewer.glb --plan drop,orient,debris",
    'msb repair -q --fail-on "components>999" data_stubs/checkpoint out/g.ply',
    "msb repair --compare data_stubs/models/walled/mesh_splatting out/costs",
)
_STEP_OPTIONS = {
    "weld": ("weld",),
    "pair_color": ("pair",),
    "debris_faces": ("debris",),
    "debris_share": ("debris",),
    "close_edges": ("close",),
    "close_share": ("close",),
}
"""Option -> the steps that it is about."""


def repair(
    source: Annotated[Path, typer.Argument(metavar="ASSET", help="A .triasset, checkpoint or mesh file.")],
    target: Annotated[
        Path | None,
        typer.Argument(metavar="OUT", help="What to write; with --compare a folder for pictures."),
        WRITTEN,
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE", help="OUT, given as an option."), WRITTEN
    ] = None,
    plan: Annotated[
        str | None,
        typer.Option(
            metavar="STEPS",
            help="Some of orient,pair,cut,drop,weld,debris,close. Default: orient,pair.",
        ),
    ] = None,
    compare: Annotated[
        bool, typer.Option("--compare", help="Write nothing; try ways to repair and show what each costs.")
    ] = False,
    weld: Annotated[
        str | None,
        typer.Option(
            metavar="exact|EPS",
            help="Vertices that weld merges: equal ones, or those within EPS. Default: exact.",
        ),
    ] = None,
    pair_color: Annotated[
        float | None,
        typer.Option(metavar="W", help="How much colour counts to pair, beside the angle. Default: 0.25."),
    ] = None,
    debris_faces: Annotated[
        int | None, typer.Option(metavar="N", help="debris removes components of fewer faces. Default: 10.")
    ] = None,
    debris_share: Annotated[
        float | None,
        typer.Option(
            metavar="SHARE",
            help="debris also removes components of less of the area, or of the pixels. Default: 0.",
        ),
    ] = None,
    close_edges: Annotated[
        int | None, typer.Option(metavar="N", help="close closes holes of at most N edges. Default: 8.")
    ] = None,
    close_share: Annotated[
        float | None,
        typer.Option(
            metavar="SHARE",
            help="close adds no cap of more than this share of a component's area. Default: 0.25.",
        ),
    ] = None,
    peer: Annotated[
        Literal["igl", "pymeshlab"] | None,
        typer.Option("--with", help="Let libigl do cut, or PyMeshLab do drop, in a process of its own."),
    ] = None,
    tasks: Annotated[
        list[str] | None,
        typer.Option(
            "--task",
            metavar="TASK",
            help="With --compare: a task of msb trial to try, or none. May be given again. "
            "Default: uv, decimate_50, subdivide, boolean, solid.",
        ),
    ] = None,
    seconds: Annotated[float, typer.Option(help="Time limit of each other library's process.")] = 60.0,
    memory: Annotated[float, typer.Option(metavar="GIB", help="Its memory limit, in GiB.")] = 4.0,
    cameras: Cameras = None,
    maps: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write an .npz with the rows of ASSET that rows of OUT come from."),
        WRITTEN,
    ] = None,
    form: Annotated[
        Literal["packed", "folder"] | None, typer.Option(help="Form of a .triasset; packed if not given.")
    ] = None,
    fail_on: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COND", help='Fail if e.g. "components>1" holds afterwards. May be given again.'
        ),
    ] = None,
    fail_on_verdict: Annotated[
        Literal["bad", "limited"] | None,
        typer.Option(help="Fail if the verdict afterwards is this or worse."),
    ] = None,
    json_file: JsonFile = None,
    device: DeviceName = None,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Repair a mesh, keeping what its vertices and faces hold; ASSET itself is never changed.

    By default nothing visible changes: faces are turned to a consistent winding, and where more than two
    meet at an edge those that continue each other stay together. A .triasset stays one of its method.

    With --compare nothing is repaired: a table shows what each way would keep, and what it costs.
    """
    from msb.cli.audit import chosen_gates
    from msb.repair.plan import DEFAULT, Options, check_peer, parse_plan

    output = Output(json_file, quiet, verbose, force)
    if target is not None:
        refuse({"out": out}, f"names OUT a second time, which is {target} already")
    target = target or out
    given: dict[str, Any] = {
        "weld": weld,
        "pair_color": pair_color,
        "debris_faces": debris_faces,
        "debris_share": debris_share,
        "close_edges": close_edges,
        "close_share": close_share,
    }
    named = {name: value for name, value in given.items() if value is not None}
    options = Options(**named, peer=peer, seconds=seconds, memory_gib=memory).check()
    if compare:
        rest = {
            "maps": maps,
            "form": form,
            "fail-on": fail_on,
            "fail-on-verdict": fail_on_verdict,
            "with": peer,
        }
        refuse(rest, "does not go with --compare")
        from msb.cli.repair_compare import compare_strategies

        chosen = None if plan is None else parse_plan(plan)
        compare_strategies(source, target, chosen, options, cameras, tasks, device, output)
        return
    refuse({"task": tasks}, "goes with --compare")
    if target is None:
        raise UsageError("USAGE", "OUT is missing; give the .triasset or mesh file to write")
    default = DEFAULT if peer is None else ({"igl": ("cut",), "pymeshlab": ("drop",)}[peer])
    steps = default if plan is None else parse_plan(plan)
    check_peer(steps, peer)
    for name in named:
        if not set(_STEP_OPTIONS[name]) & set(steps):
            refuse({name.replace("_", "-"): named[name]}, f"is for {_STEP_OPTIONS[name][0]}, not in --plan")
    gates = chosen_gates(fail_on or [], None, fail_on_verdict)
    task = _Task(source, target, maps, form, steps, options, cameras, device, output)
    after = task.run()
    failed = [error for gate in gates if (error := gate.check(after, source))]
    raise typer.Exit(max((report_error(error) for error in failed), default=0))


class _Task:
    """One repair: outputs are checked before anything is read, and written when all is computed."""

    def __init__(
        self,
        source: Path,
        target: Path,
        maps: Path | None,
        form: Literal["packed", "folder"] | None,
        plan: tuple[str, ...],
        options: Options,
        cameras: str | None,
        device: str | None,
        output: Output,
    ) -> None:
        from msb.adapters.locate import is_mesh_file
        from msb.api.saving import checked_ending, output_suffix
        from msb.asset import ASSET_SUFFIX

        self.source, self.target, self.maps, self.form = source, target, maps, form
        self.plan, self.options = plan, options
        self.cameras, self.device, self.output = cameras, device, output
        self.suffix = output_suffix(target, "OUT")
        if form is not None and self.suffix != ASSET_SUFFIX:
            raise UsageError("USAGE", f"--form is for .triasset; {target.name} is a mesh file")
        if cameras is not None and not {"debris", "drop"} & set(plan):
            raise UsageError("USAGE", "--cameras weigh faces for debris and drop, which are not in --plan")
        if maps is not None:
            checked_ending(maps, "--maps", (".npz",))
        output.check_free(target, folder=form == "folder")
        output.check_free(maps)
        output.check_outputs()
        self.written: Audit | None = None
        """The audit of the mesh file that was written, if it is one."""
        self.split = False
        """Whether its format gives every face vertices of its own."""
        self.in_file_precision = self.suffix != ASSET_SUFFIX and is_mesh_file(source) and cameras is None

    def run(self) -> Audit:
        """Repair, write and print; return the audit of the result."""
        from msb.cli.mesh_files import why_split
        from msb.cli.repair_text import document, print_repair
        from msb.repair.run import what_is_left

        made = self.repair_mesh() if self.in_file_precision else self.repair_asset()
        done = made if self.written is None else replace(made, after=self.written)
        split = self.split and made.after.topology != "triangle_soup"
        left = what_is_left(done.after, why_split(self.suffix) if split else None)
        if self.maps is not None:
            _write_maps(self.maps, done)
        self.output.write_json(document(self.source, self.target, self.plan, done, left))
        if self.output.prints_text:
            repaired = made.after.counts.components if split else None
            print_repair(self.source, self.target, done, left, repaired, self.output)
        return done.after

    def repair_asset(self) -> Repaired:
        """Repair what an asset holds, and write it as one or as its standard-tier mesh."""
        from msb.api.saving import save
        from msb.asset import ASSET_SUFFIX
        from msb.cli.inputs import open_asset
        from msb.cli.mesh_files import beyond_a_mesh, note_up
        from msb.cli.repair_text import note_turned
        from msb.meshes.assets import mesh_from_asset
        from msb.repair.assets import repair_asset

        with self.output.progress(f"reading {self.source.name}"):
            asset = open_asset(self.source, self.output)
        weights = None if self.cameras is None else self.pixels(asset)
        with self.output.progress(f"repairing {self.source.name}"), about(self.source):
            done = repair_asset(asset, self.plan, self.options, weights)
        note_turned(done.asset, done, self.output)
        if self.suffix != ASSET_SUFFIX:
            mesh = mesh_from_asset(done.asset)
            written = self.write(mesh, beyond_a_mesh(done.asset))
            known = asset.manifest.coordinate_frame.known_up is not None
            note_up(mesh, self.target, self.suffix, self.output, known=known)
            self.written = replace(written, path=done.after.path, method=done.after.method)
            return done
        with self.output.progress(f"writing {self.target.name}"):
            save(done.asset, self.target, overwrite=True, form=self.form or "packed")
        return done

    def pixels(self, asset: Asset) -> NDArray[Any]:
        """Return how many pixels each face covers."""
        from msb.repair.seen import seen_pixels
        from msb.scenes import read_cameras

        cameras: Sequence[Camera] = read_cameras(str(self.cameras))
        with self.output.counted("looking at faces", len(cameras)) as step:
            return seen_pixels(asset, cameras, self.device, step)

    def repair_mesh(self) -> Outcome:
        """Repair a mesh file in its own precision."""
        from msb.meshes import read_mesh
        from msb.repair.assets import repair_mesh

        with self.output.progress(f"reading {self.source.name}"):
            mesh = read_mesh(self.source)
        with self.output.progress(f"repairing {self.source.name}"), about(self.source):
            made, done = repair_mesh(mesh, self.plan, self.options)
        self.written = self.write(made, mesh.left_out)
        return done

    def write(self, made: Mesh, left_out: Sequence[str]) -> Audit:
        """Write `made` to a mesh file, and return the audit of what the file holds."""
        from msb.base.atomic import new_file
        from msb.cli.mesh_files import is_split, note_losses
        from msb.meshes import write_mesh
        from msb.meshes.assets import as_held
        from msb.topology import audit_arrays

        with (
            self.output.progress(f"writing {self.target.name}"),
            about(self.source),
            new_file(self.target) as file,
        ):
            held = as_held(made, self.suffix)
            write_mesh(held, file, suffix=self.suffix)
        note_losses(made, held, self.target, self.suffix, left_out, self.output)
        self.split = is_split(made, held)
        return audit_arrays(held.vertices, held.faces)[0]


def _write_maps(path: Path, done: Repaired | Outcome) -> None:
    from msb.base.atomic import new_file
    from msb.base.npz import write_npz

    with new_file(path) as file:
        write_npz(file, {"vertex": done.vertex_map, "face": done.face_map, "turned": done.turned})
