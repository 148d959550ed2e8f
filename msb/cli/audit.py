"""`msb audit` and `msb-audit`: is the mesh structurally usable?"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from msb.cli.failures import report_error
from msb.cli.options import (
    WRITTEN,
    CsvFile,
    FailFast,
    Force,
    JsonFile,
    JsonLines,
    Quiet,
    Verbose,
    Version,
    epilog,
)
from msb.cli.output import Output, echo, failure
from msb.errors import GateFailed, MsbError, UsageError

if TYPE_CHECKING:
    from msb.api.opening import StoredMesh
    from msb.cli.gates import FailingLevel, Gate, Profile, VerdictGate
    from msb.topology import Audit
    from msb.topology.analysis import Analysis
    from msb.topology.weld import Weld
    from msb_viewers.gl import GlProbe

EPILOG = epilog(
    "msb-audit data_stubs/splat_like.triasset",
    "msb-audit --json - data_stubs/splat_like.triasset",
    'msb-audit --cross-check --fail-on "components>999" data_stubs/checkpoint',
    "msb-audit --explain nonmanifold_vertex_ratio",
)


def audit(
    paths: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="PATH...", help="A .triasset, mesh file or checkpoint, or a folder or pattern of these."
        ),
    ] = None,
    json_file: JsonFile = None,
    json_lines: JsonLines = None,
    csv_file: CsvFile = None,
    weld: Annotated[
        str | None,
        typer.Option(metavar="exact|EPS", help="Also audit with coincident vertices merged."),
    ] = None,
    cross_check: Annotated[
        bool,
        typer.Option(
            "--cross-check",
            help="Ask libigl, PyMeshLab, manifold3d, trimesh and NetworkX about the same mesh.",
        ),
    ] = False,
    elements: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the offending elements to a .vtp, .csv or .npz file."),
        WRITTEN,
    ] = None,
    fail_on: Annotated[
        list[str] | None,
        typer.Option(metavar="COND", help='Fail if e.g. "components>1" holds. May be given again.'),
    ] = None,
    fail_on_verdict: Annotated[
        Literal["bad", "limited"] | None,
        typer.Option(help="Fail if the verdict is this or worse."),
    ] = None,
    profile: Annotated[
        Literal["game", "print", "research"] | None,
        typer.Option(help="Fail unless the mesh is fit for this; docs/cli.md has the conditions."),
    ] = None,
    fail_fast: FailFast = False,
    view: Annotated[
        bool, typer.Option("--view", help="Then show the mesh in a window, as msb view does; one mesh only.")
    ] = False,
    paper: Annotated[bool, typer.Option("--paper", help="Show the paper's mean row beside ours.")] = False,
    explain: Annotated[
        str | None, typer.Option(metavar="KEY", help="Print how a quantity is defined, and stop.")
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
    version: Version = False,
) -> None:
    """Audit the structure of meshes exactly as they are stored.

    The audit says how vertices are shared, where the surface is open, non-manifold or in pieces, and whether
    a technical artist can use it. Nothing is merged or repaired first. Several meshes end with one table.
    """
    output = Output(json_file, quiet, verbose, force, json_lines, csv_file)
    if explain is not None:
        _explain(explain, output)
        return
    if not paths:
        raise UsageError(
            "USAGE", "PATH is missing; give a .triasset, mesh file or checkpoint, or a folder of these"
        )
    gates = chosen_gates(fail_on or [], profile, fail_on_verdict)
    task = _Task(output, weld, cross_check, elements, gates, paper, view, fail_fast)
    raise typer.Exit(task.run(paths))


def chosen_gates(
    fail_on: list[str], profile: Profile | None, level: FailingLevel | None
) -> list[Gate | VerdictGate]:
    """Return the gates of --fail-on, of the profile and of the verdict; without any nothing is loaded."""
    if not fail_on and profile is None and level is None:
        return []
    from msb.cli.gates import PROFILES, VerdictGate, parse_gate

    of_profile = [replace(parse_gate(text), profile=profile) for text in PROFILES[profile]] if profile else []
    return [*map(parse_gate, fail_on), *of_profile, *([VerdictGate(level)] if level else [])]


def _explain(key: str, output: Output) -> None:
    from msb.topology.explain import explain

    entry = explain(key)
    output.write_json({"schema": "msb.definition/1", **entry.to_dict()})
    if output.prints_text:
        echo(entry.to_text())


class _Task:
    """One run of the command: options parsed before any mesh is read, then mesh after mesh."""

    def __init__(
        self,
        output: Output,
        weld: str | None,
        cross_check: bool,
        elements: Path | None,
        gates: list[Gate | VerdictGate],
        paper: bool,
        view: bool,
        fail_fast: bool,
    ) -> None:
        self.output = output
        self.cross_check = cross_check
        self.elements = elements
        self.gates = gates
        self.paper = paper
        self.view = view
        self.fail_fast = fail_fast
        self.weld: Weld | None = None
        self.probe: GlProbe | None = None
        self.seen: tuple[Path, StoredMesh, Audit, Analysis] | None = None
        if weld is not None:
            from msb.topology.weld import parse_weld

            self.weld = parse_weld(weld)
        if elements is not None:
            from msb.cli.elements import check_suffix

            check_suffix(elements)
        output.check_outputs()
        output.check_free(elements)
        if view:
            from msb.cli.window import Window, open_probe

            self.probe = open_probe(Window())

    def run(self, paths: list[Path]) -> int:
        """Audit everything below `paths`; return the highest exit status of all."""
        from msb.cli.inputs import expand

        status = failed_gates = 0
        inputs: list[Path] = []
        done: list[tuple[Path, Audit | MsbError]] = []
        for path in paths:
            try:
                inputs += expand(path)
            except MsbError as error:
                status = max(status, report_error(error))
                done.append((path, error))
        if self.elements is not None and len(inputs) > 1:
            raise UsageError("USAGE", f"--elements takes one mesh; there are {len(inputs)}")
        if self.view and len(inputs) > 1:
            raise UsageError("USAGE", f"--view takes one mesh; there are {len(inputs)}")
        for path in inputs:
            if status and self.fail_fast:
                break
            try:
                found = self.audit_one(path)
            except MsbError as error:
                status = max(status, report_error(error))
                done.append((path, error))
                continue
            if self.output.prints_text:
                first = all(isinstance(one, MsbError) for _, one in done)
                self.print_one(found, first=first, alone=len(inputs) == 1)
            done.append((path, found))
            failures = self.failures(found, path)
            failed_gates += any(failed.code == "GATE_FAILED" for failed in failures)
            for failed in failures:
                status = max(status, report_error(failed))
        if len(done) > 1 and self.output.prints_text:
            self.print_all(done, failed_gates)
        self.write_files(done)
        if self.view and self.seen is not None:
            self.open_window(*self.seen)
        return status

    def audit_one(self, path: Path) -> Audit:
        """Return the audit of the mesh at `path`, cross-checked and with elements written if asked for."""
        from msb.api.auditing import audit_stored
        from msb.api.opening import read_stored
        from msb.cli.inputs import note_warnings

        with self.output.progress(f"reading {path.name}"):
            mesh = read_stored(path)
        # What a file holds beside its triangles is nothing that an audit counts.
        note_warnings((one for one in mesh.warnings if one.severity != "info"), path, self.output)
        with self.output.progress(f"auditing {path.name}: {len(mesh.faces):,} faces"):
            found, analysis = audit_stored(mesh, weld=self.weld)
        if self.cross_check:
            found = self.ask_peers(found, analysis, mesh, path)
        if self.elements is not None:
            from msb.cli.elements import write_elements
            from msb.topology.elements import find_elements

            write_elements(find_elements(analysis), self.elements)
        if self.view:
            self.seen = path, mesh, found, analysis
        self.output.note(
            f"{path}: {found.computed_by}: "
            + ", ".join(f"{k} {v:.1f} ms" for k, v in found.timings_ms.items()),
            level=1,
        )
        return found

    def open_window(self, path: Path, mesh: StoredMesh, found: Audit, analysis: Analysis) -> None:
        """Show the mesh that was audited."""
        from msb.cli.view import ViewOptions, present
        from msb.cli.window import Window
        from msb_viewers.model import build_model
        from msb_viewers.viewed_mesh import viewed_mesh

        if self.probe is not None:
            self.probe.check()
        present(build_model(viewed_mesh(mesh, path), found, analysis), ViewOptions(), Window(), self.output)

    def ask_peers(self, found: Audit, analysis: Analysis, mesh: StoredMesh, path: Path) -> Audit:
        """Return `found` with the verdicts of the peers."""
        from msb.topology.crosscheck import cross_check

        with self.output.progress(f"asking the peers about {path.name}"):
            check = cross_check(mesh.vertices, mesh.faces, found, analysis)
        for what, why in check.skipped.items():
            # A whole peer is worth a note; a single quantity that does not apply only if asked for more.
            self.output.note(f"{path}: {what} skipped: {why}", level=1 if " " in what else 0)
        return replace(found, cross_check=check.to_rows())

    def print_one(self, found: Audit, *, first: bool, alone: bool) -> None:
        """Print the report of one mesh on standard output; with --quiet the verdict alone."""
        from msb.cli.audit_text import print_audit, print_verdict

        console = self.output.console()
        if self.output.quiet:
            print_verdict(found, console)
            return
        if not first:
            console.print()
        print_audit(found, console, paper=self.paper, verbose=self.output.verbose > 0, hint=alone)

    def print_all(self, done: list[tuple[Path, Audit | MsbError]], failed_gates: int) -> None:
        """Print a row for each mesh and a line of totals; with --quiet the totals alone."""
        from msb.cli.audit_text import print_summary, totals

        if not self.output.quiet:
            echo()
            print_summary(done, self.output.console())
            echo()
        echo(totals([one for _, one in done], failed_gates if self.gates else None))

    def failures(self, found: Audit, path: Path) -> list[MsbError]:
        """Return the gates that failed."""
        failed: list[MsbError] = [e for gate in self.gates if (e := gate.check(found, path))]
        for row in found.cross_check or ():
            if row["verdict"] == "disagrees":
                text = f"{row['peer']} says {row['quantity']} is {row['theirs']}, we say {row['ours']}"
                failed.append(GateFailed("CROSS_CHECK_DISAGREES", text, file=path))
        return failed

    def write_files(self, done: list[tuple[Path, Audit | MsbError]]) -> None:
        """Write what --json, --jsonl and --csv asked for."""
        from msb.topology.audit import SCHEMA

        if len(done) == 1 and isinstance(done[0][1], MsbError):
            return  # the one input failed; its line on standard error says it all
        results = [
            failure(SCHEMA, path, one) if isinstance(one, MsbError) else one.to_dict() for path, one in done
        ]
        self.output.write_documents(results)
        rows = [_row(data) for data in results if "counts" in data]
        self.output.write_csv(list(rows[0]) if rows else ["path"], rows)


def _row(data: dict[str, Any]) -> dict[str, Any]:
    return {**{key: data[key] for key in ("path", "method", "topology")}, **data["counts"], **data["metrics"]}
