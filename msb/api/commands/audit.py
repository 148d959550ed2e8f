"""`msb audit` and `msb-audit`: decide whether the structure of a mesh is usable."""

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
    """Additional audits, displays and output files."""

    weld: Annotated[
        str | None, Option("Also audit the mesh with coincident vertices merged.", metavar="exact|EPS")
    ] = None
    cross_check: Annotated[
        bool, Option("Compare the counts with libigl, PyMeshLab, manifold3d, trimesh, NetworkX and NVIDIA.")
    ] = False
    elements: Annotated[
        Path | None,
        file_option(
            "Write the defective elements to a .vtp, .csv or .npz file.", endings=(".vtp", ".csv", ".npz")
        ),
    ] = None
    view: Annotated[bool, Option("Also show the mesh in a window, as msb view does. One mesh only.")] = False
    paper: Annotated[bool, Option("Also show the paper's average values of MeshSplatting.")] = False
    explain: Annotated[str | None, Option("Print the definition of a quantity and exit.", metavar="KEY")] = (
        None
    )
    version: Annotated[bool, Option("Print versions and exit.")] = False


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

    The audit reports how vertices are shared, and where the surface is open, non-manifold or in pieces. The
    verdict says whether a technical artist can use the mesh. Nothing is merged or repaired before counting.
    With several meshes, a table is printed at the end.
    """
    prints_only = options.version or options.explain is not None
    require(
        paths or prints_only, "Missing PATH. Pass a .triasset, mesh file or checkpoint, or a folder of these"
    )
    if paths:
        typed.reject(["explain", "version"], "cannot be combined with PATH")
    if prints_only:
        gates = ["fail_on", "fail_on_verdict", "profile"]
        typed.reject(["elements", "csv_file", *gates], "needs PATH")
    if options.version:
        typed.reject(["json_file", "json_lines", "explain"], "cannot be combined with --version")
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
    """A single run of the command `msb audit`.

    All options are parsed first. After the options, the meshes are read and audited in turn.
    """

    def __init__(self, options: AuditOptions, conditions: GateOptions, output: Output) -> None:
        from msb.topology.weld import parse_weld

        self.options, self.output = options, output
        self.gates = conditions.gates()
        with option_value("--weld"):
            self.weld = None if options.weld is None else parse_weld(options.weld)
        # VTK is tested in the background while the mesh is read.
        self.probe = None
        if options.view:
            from msb_viewers.commands.window import Window, open_probe

            self.probe = open_probe(Window())
        self.audits: dict[str, Audit] = {}
        self.failed_gates = 0
        self.seen: tuple[Path, StoredMesh, Audit, Analysis] | None = None

    def run(self, paths: tuple[Path, ...]) -> int:
        """Audit all inputs in `paths`. Return the highest exit status."""
        from msb.api.command_files import for_each
        from msb.topology.audit import SCHEMA

        single = [f"--{name}" for name in ("elements", "view") if getattr(self.options, name)]
        status, documents = for_each(paths, SCHEMA, self.output, self.audit_mesh, single)
        if len(documents) > 1 and self.output.prints_text:
            self.print_all(documents)
        if len(documents) > 1 or self.audits:
            rows = [_row(each) for each in documents if "counts" in each]
            self.output.write_csv(list(rows[0]) if rows else ["path"], rows)
        if self.options.view and self.seen is not None:
            self.open_window(*self.seen)
        return status

    def audit_mesh(self, path: Path, alone: bool) -> tuple[dict[str, Any], int]:
        """Audit the mesh at `path` and print the report.

        Return the JSON data of the audit, and the exit status that follows from the gates (conditions).
        """
        from msb.api.auditing import audit_stored
        from msb.api.command_files import note_warnings
        from msb.api.commands.audit_text import print_audit
        from msb.api.opening import read_stored

        with self.output.progress(f"reading {path.name}"):
            mesh = read_stored(path, images=self.options.view)
        # Findings with the severity "info", such as ignored normals, do not affect the audit.
        warnings = (warning for warning in mesh.warnings if warning.severity != "info")
        note_warnings(warnings, path, self.output)
        with self.output.progress(f"auditing {path.name}: {len(mesh.faces):,} faces"):
            result, analysis = audit_stored(mesh, weld=self.weld)
        if self.options.cross_check:
            result = self.compare_libraries(result, analysis, mesh, path)
        if self.options.elements is not None:
            from msb.api.elements import write_elements
            from msb.topology.elements import find_elements

            write_elements(find_elements(analysis), self.options.elements, overwrite=self.output.force)
        # Print the report. Print a blank line before every report except the first.
        times = ", ".join(f"{stage} {time:.1f} ms" for stage, time in result.timings_ms.items())
        self.output.note(f"{path}: {result.computed_by}: {times}", level=1)
        if self.output.prints_text:
            if self.audits and not self.output.quiet:
                echo()
            print_audit(result, self.output, paper=self.options.paper, hint=alone)
        self.audits[str(path)] = result
        self.seen = path, mesh, result, analysis
        # Evaluate the gates. A failed gate (condition) prints a line on standard error.
        failed = [error for gate in self.gates if (error := gate.check(result, path))]
        self.failed_gates += bool(failed)
        failed += _disagreements(result, path)
        return result.to_dict(), max(map(report_error, failed), default=0)

    def open_window(self, path: Path, mesh: StoredMesh, result: Audit, analysis: Analysis) -> None:
        """Show the audited mesh in a window."""
        from msb_viewers.commands.view import present
        from msb_viewers.commands.window import Window
        from msb_viewers.model import build_model
        from msb_viewers.options import ViewOptions
        from msb_viewers.viewed_mesh import viewed_mesh

        if self.probe is not None:
            self.probe.check()
        present(build_model(viewed_mesh(mesh, path), result, analysis), ViewOptions(), Window(), self.output)

    def compare_libraries(self, result: Audit, analysis: Analysis, mesh: StoredMesh, path: Path) -> Audit:
        """Return the audit with a comparison with other libraries."""
        from msb.topology.crosscheck import cross_check

        with self.output.progress(f"comparing {path.name} with other libraries"):
            check = cross_check(mesh.vertices, mesh.faces, result, analysis)
        for what, why in check.skipped.items():
            # Report each library that is skipped. If -v is given, also report quantities that a library
            # cannot compute for this mesh.
            self.output.note(f"{path}: {what} skipped: {why}", level=1 if " " in what else 0)
        return replace(result, cross_check=check.to_rows())

    def print_all(self, documents: list[dict[str, Any]]) -> None:
        """Print a row for each mesh and a line of totals. If --quiet is given, print only the totals."""
        from msb.api.commands.audit_text import print_summary, totals

        audits = [(document["path"], self.audits.get(document["path"], document)) for document in documents]
        if not self.output.quiet:
            echo()
            print_summary(audits, self.output)
            echo()
        echo(totals([audit for _, audit in audits], self.failed_gates if self.gates else None))


def _disagreements(result: Audit, path: Path) -> list[GateFailed]:
    """Compare each count with the other libraries, and return an error for each difference."""
    texts = [
        f"{row['quantity']} is {row['ours']}, but {row['theirs']} for {row['peer']}"
        for row in result.cross_check or ()
        if row["verdict"] == "disagrees"
    ]
    return [GateFailed("CROSS_CHECK_DISAGREES", text, file=path) for text in texts]


def _row(data: dict[str, Any]) -> dict[str, Any]:
    """Return the row of --csv from the JSON data of an audit."""
    return {**{key: data[key] for key in ("path", "method", "topology")}, **data["counts"], **data["metrics"]}
