"""`msb audit` and `msb-audit`: is the mesh structurally usable?"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from msb.api.gates import GateOptions
from msb.base.option import Argument, Option
from msb.cli.command import Typed, command, option_value, require
from msb.cli.output import Output, echo, file_option, report_error
from msb.errors import GateFailed

if TYPE_CHECKING:
    from msb.api.opening import StoredMesh
    from msb.topology import Audit
    from msb.topology.analysis import Analysis


@dataclass(frozen=True)
class AuditOptions:
    """What is audited beside the mesh as it is stored, and what is shown and written of it."""

    weld: Annotated[
        str | None, Option("Also audit with coincident vertices merged.", metavar="exact|EPS")
    ] = None
    cross_check: Annotated[
        bool, Option("Ask libigl, PyMeshLab, manifold3d, trimesh, NetworkX and NVIDIA about the mesh.")
    ] = False
    elements: Annotated[
        Path | None,
        file_option(
            "Write the offending elements to a .vtp, .csv or .npz file.", endings=(".vtp", ".csv", ".npz")
        ),
    ] = None
    view: Annotated[bool, Option("Then show the mesh in a window, as msb view does; one mesh only.")] = False
    paper: Annotated[bool, Option("Show the paper's mean row beside ours.")] = False
    explain: Annotated[str | None, Option("Print how a quantity is defined, and stop.", metavar="KEY")] = None
    version: Annotated[bool, Option("Print versions and stop.")] = False


@command(
    "msb-audit data_stubs/splat_like.triasset",
    "msb-audit --json - data_stubs/splat_like.triasset",
    'msb-audit --cross-check --fail-on "components>999" data_stubs/checkpoint',
    "msb-audit --explain nonmanifold_vertex_ratio",
)
def audit(
    paths: Annotated[
        tuple[Path, ...],
        Argument(
            "A .triasset, mesh file or checkpoint, or a folder or pattern of these.",
            metavar="PATH...",
        ),
    ] = (),
    *,
    options: AuditOptions,
    conditions: GateOptions,
    output: Annotated[
        Output, ("json_file", "json_lines", "csv_file", "fail_fast", "force", "quiet", "verbose")
    ],
    typed: Typed,
) -> int:
    """Audit the structure of meshes exactly as they are stored.

    The audit says how vertices are shared, where the surface is open, non-manifold or in pieces, and whether
    a technical artist can use it. Nothing is merged or repaired first. Several meshes end with one table.
    """
    alone = options.version or options.explain is not None
    require(paths or alone, "Missing PATH. Pass a .triasset, mesh file or checkpoint, or a folder of these")
    if paths:
        typed.reject(["explain", "version"], "stands alone, without PATH")
    if alone:
        gates = ["fail_on", "fail_on_verdict", "profile"]
        typed.reject(["elements", "csv_file", *gates], "needs a mesh")
    if options.version:
        typed.reject(["json_file", "json_lines", "explain"], "does not go with --version")
        from msb.cli.app import print_version

        print_version()
        return 0
    if options.explain is not None:
        from msb.topology.explain import explain

        entry = explain(options.explain)
        output.write_documents([{"schema": "msb.definition/1", **entry.to_dict()}])
        if output.prints_text:
            echo(entry.to_text())
        return 0
    return _Task(options, conditions, output).run(paths)


class _Task:
    """One run of the command: options are parsed before any mesh is read, then mesh after mesh."""

    def __init__(self, options: AuditOptions, conditions: GateOptions, output: Output) -> None:
        from msb.topology.weld import parse_weld
        from msb_viewers.commands.window import Window, open_probe

        self.options, self.output = options, output
        self.gates = conditions.gates()
        with option_value("--weld"):
            self.weld = None if options.weld is None else parse_weld(options.weld)
        self.probe = open_probe(Window()) if options.view else None
        self.audits: dict[str, Audit] = {}
        self.failed_gates = 0
        self.seen: tuple[Path, StoredMesh, Audit, Analysis] | None = None

    def run(self, paths: tuple[Path, ...]) -> int:
        """Audit everything below `paths`; return the highest exit status of all."""
        from msb.api.command_files import for_each
        from msb.topology.audit import SCHEMA

        single = [f"--{name}" for name in ("elements", "view") if getattr(self.options, name)]
        status, documents = for_each(paths, SCHEMA, self.output, self.audit_one, single)
        if len(documents) > 1 and self.output.prints_text:
            self.print_all(documents)
        if len(documents) > 1 or self.audits:
            rows = [_row(each) for each in documents if "counts" in each]
            self.output.write_csv(list(rows[0]) if rows else ["path"], rows)
        if self.options.view and self.seen is not None:
            self.open_window(*self.seen)
        return status

    def audit_one(self, path: Path, alone: bool) -> tuple[dict[str, Any], int]:
        """Audit the mesh at `path` and print it; return the JSON data, and the status of the gates."""
        from msb.api.auditing import audit_stored
        from msb.api.command_files import note_warnings
        from msb.api.commands.audit_text import print_audit
        from msb.api.opening import read_stored

        with self.output.progress(f"reading {path.name}"):
            mesh = read_stored(path, images=self.options.view)
        # What a file holds beside its triangles is nothing that an audit counts.
        note_warnings((one for one in mesh.warnings if one.severity != "info"), path, self.output)
        with self.output.progress(f"auditing {path.name}: {len(mesh.faces):,} faces"):
            result, analysis = audit_stored(mesh, weld=self.weld)
        if self.options.cross_check:
            result = self.ask_peers(result, analysis, mesh, path)
        if self.options.elements is not None:
            from msb.api.elements import write_elements
            from msb.topology.elements import find_elements

            write_elements(find_elements(analysis), self.options.elements, overwrite=self.output.force)
        times = ", ".join(f"{stage} {time:.1f} ms" for stage, time in result.timings_ms.items())
        self.output.note(f"{path}: {result.computed_by}: {times}", level=1)
        if self.output.prints_text:
            if self.audits and not self.output.quiet:
                echo()
            print_audit(result, self.output, paper=self.options.paper, hint=alone)
        self.audits[str(path)] = result
        self.seen = path, mesh, result, analysis
        failed = [error for gate in self.gates if (error := gate.check(result, path))]
        self.failed_gates += bool(failed)
        failed += _disagreements(result, path)
        return result.to_dict(), max(map(report_error, failed), default=0)

    def open_window(self, path: Path, mesh: StoredMesh, result: Audit, analysis: Analysis) -> None:
        """Show the mesh that was audited."""
        from msb_viewers.commands.view import present
        from msb_viewers.commands.window import Window
        from msb_viewers.model import build_model
        from msb_viewers.options import ViewOptions
        from msb_viewers.viewed_mesh import viewed_mesh

        if self.probe is not None:
            self.probe.check()
        present(build_model(viewed_mesh(mesh, path), result, analysis), ViewOptions(), Window(), self.output)

    def ask_peers(self, result: Audit, analysis: Analysis, mesh: StoredMesh, path: Path) -> Audit:
        """Return the audit with the verdicts of the peers."""
        from msb.topology.crosscheck import cross_check

        with self.output.progress(f"asking the peers about {path.name}"):
            check = cross_check(mesh.vertices, mesh.faces, result, analysis)
        for what, why in check.skipped.items():
            # A whole peer is worth a note; a single quantity that does not apply only if asked for more.
            self.output.note(f"{path}: {what} skipped: {why}", level=1 if " " in what else 0)
        return replace(result, cross_check=check.to_rows())

    def print_all(self, documents: list[dict[str, Any]]) -> None:
        """Print a row for each mesh and a line of totals; with --quiet the totals alone."""
        from msb.api.commands.audit_text import print_summary, totals

        audits = [(each["path"], self.audits.get(each["path"], each)) for each in documents]
        if not self.output.quiet:
            echo()
            print_summary(audits, self.output)
            echo()
        echo(totals([one for _, one in audits], self.failed_gates if self.gates else None))


def _disagreements(result: Audit, path: Path) -> list[GateFailed]:
    texts = [
        f"{row['peer']} says {row['quantity']} is {row['theirs']}, we say {row['ours']}"
        for row in result.cross_check or ()
        if row["verdict"] == "disagrees"
    ]
    return [GateFailed("CROSS_CHECK_DISAGREES", text, file=path) for text in texts]


def _row(data: dict[str, Any]) -> dict[str, Any]:
    return {**{key: data[key] for key in ("path", "method", "topology")}, **data["counts"], **data["metrics"]}
