"""`msb validate`: everything that is wrong with an asset, each finding with its code."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from msb.cli.failures import report_error
from msb.cli.options import FailFast, Force, JsonFile, JsonLines, Quiet, Verbose, epilog
from msb.cli.output import Output, echo, failure, plain_table
from msb.errors import (
    CODES,
    EXIT_STATUS,
    Finding,
    InputError,
    MsbError,
    Unsupported,
    UsageError,
    error_finding,
    finding,
    one_line,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

EPILOG = epilog(
    "msb validate data_stubs/splat_like.triasset",
    "msb validate --json - data_stubs/splat_like.triasset",
    "msb validate --explain TRIASSET_INDEX_OUT_OF_RANGE",
)
SCHEMA = "msb.validate/1"
MAX_FINDINGS = 1000
"""JSON holds this many findings of an asset; a hostile manifest of 1 MiB can cause 90 000."""
SHOWN = 50
"""This many findings of an asset are printed."""
_SEVERITIES = ("error", "warning", "info")


def validate(
    paths: Annotated[
        list[Path] | None, typer.Argument(metavar="PATH...", help="Assets, mesh files, or folders of these.")
    ] = None,
    json_file: JsonFile = None,
    json_lines: JsonLines = None,
    fail_fast: FailFast = False,
    explain: Annotated[
        str | None, typer.Option(metavar="CODE", help="Print what a code means, and stop.")
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Check assets completely: container, manifest, sizes, hashes and values.

    Errors make the command fail with status 1; warnings and infos do not. A mesh file or checkpoint is
    judged by the asset that would be made of it.
    """
    output = Output(json_file, quiet, verbose, force, json_lines)
    if explain is not None:
        _explain(explain, output)
        return
    if not paths:
        raise UsageError("USAGE", "PATH is missing; give a .triasset, a mesh file or a folder of these")
    output.check_outputs()
    raise typer.Exit(_run(paths, output, fail_fast=fail_fast))


def _run(paths: list[Path], output: Output, *, fail_fast: bool) -> int:
    from msb.cli.inputs import expand

    status = 0
    inputs: list[Path] = []
    reports: list[dict[str, Any]] = []
    for path in paths:
        try:
            inputs += expand(path)
        except MsbError as error:
            status = max(status, report_error(error))
            reports.append(failure(SCHEMA, path, error))
    for item in inputs:
        if status and fail_fast:
            break
        try:
            with output.progress(f"validating {item.name}"):
                found = check(item)
        except MsbError as error:
            status = max(status, report_error(error))
            reports.append(failure(SCHEMA, item, error))
            continue
        errors = sum(f.severity == "error" for f in found)
        status = max(status, 1 if errors else 0)
        reports.append(
            {
                "schema": SCHEMA,
                "path": str(item),
                "valid": errors == 0,
                "findings": [f.to_dict() for f in found[:MAX_FINDINGS]],
                "truncated": len(found) > MAX_FINDINGS,
            }
        )
        if output.prints_text:
            _print(item, found, output)
    if len(reports) > 1 or "error" not in reports[0]:  # the line on standard error says it all
        output.write_documents(reports)
    return status


def check(path: Path) -> list[Finding]:
    """Return all findings about the asset or mesh file at `path`.

    Raises
    ------
    InputError
        If it does not exist, cannot be read or is not recognised.
    """
    from msb.asset import is_asset
    from msb.asset import validate as validate_asset

    if not is_asset(path):
        return _check_mesh(path)
    result = validate_asset(path)
    # Errors first: they must not drown in warnings.
    found = sorted(result.findings, key=lambda item: _SEVERITIES.index(item.severity))
    if result.asset is not None and result.valid:
        found += degenerate_findings(result.asset.buffers["positions"], result.asset.buffers["indices"])
    return found


def _check_mesh(path: Path) -> list[Finding]:
    from msb.adapters import export

    try:
        asset = export(path)
    except (InputError, Unsupported):
        raise
    except MsbError as error:
        return [error_finding(error)]
    return [*asset.warnings, *degenerate_findings(asset.buffers["positions"], asset.buffers["indices"])]


def degenerate_findings(positions: Any, indices: Any) -> Iterator[Finding]:
    """Yield infos about faces that draw nothing or twice, and vertices that nothing uses."""
    import numpy as np

    from msb.topology.arrays import mesh_arrays
    from msb.topology.faces import extra_duplicates, face_areas, has_no_area, names_vertex_twice

    points, faces = mesh_arrays(positions, indices)
    repeated = names_vertex_twice(faces)
    area, finite = face_areas(points, faces)
    unused = np.ones(len(points), bool)
    unused[faces[~repeated]] = False
    for code, where, what in (
        ("TRIASSET_FACE_REPEATED_INDEX", repeated, "faces name a vertex twice"),
        ("TRIASSET_FACE_DUPLICATE", extra_duplicates(faces), "faces repeat an earlier one"),
        ("TRIASSET_FACE_ZERO_AREA", has_no_area(area, finite, repeated), "faces have no area"),
        ("TRIASSET_VERTEX_UNREFERENCED", unused, "vertices are in no proper face"),
    ):
        if count := int(np.count_nonzero(where)):
            text = f"{count:,} {what}, the first is {int(np.argmax(where))}"
            yield finding(code, text, severity="info", pointer="indices", value=count)


def _print(path: Path, found: list[Finding], output: Output) -> None:
    from rich.markup import escape

    console = output.console()
    counts = {s: sum(f.severity == s for f in found) for s in _SEVERITIES}
    word = "not valid" if counts["error"] else "valid"
    console.print(f"{escape(one_line(str(path)))}: [bold]{word}[/bold], {_summary(counts)}", soft_wrap=True)
    if not found or output.quiet:
        return
    table = plain_table("Severity", "Code", "Finding")
    styles = {"error": "red", "warning": "yellow", "info": "dim"}
    for item in found[:SHOWN]:
        where = f" (at {item.pointer})" if item.pointer else ""
        table.add_row(f"[{styles[item.severity]}]{item.severity}[/]", item.code, escape(item.message + where))
    console.print(table)
    if len(found) > SHOWN:
        console.print(f"... and {len(found) - SHOWN:,} more; --json lists up to {MAX_FINDINGS:,}")


def _summary(counts: dict[str, int]) -> str:
    parts = [f"{n} {name}{'s' if n != 1 else ''}" for name, n in counts.items() if n]
    return ", ".join(parts) or "nothing to report"


def _explain(name: str, output: Output) -> None:
    import difflib

    code = name.upper()
    if code not in CODES:
        near = ", ".join(difflib.get_close_matches(code, CODES, 3, 0.4)) or "docs/errors.md lists all"
        raise UsageError("EXPLAIN_UNKNOWN", f'there is no code "{name}"; did you mean {near}?')
    entry = CODES[code]
    status = EXIT_STATUS[entry.kind]
    output.write_json(
        {
            "schema": "msb.code/1",
            "code": code,
            "exit_status": status,
            "summary": entry.summary,
            "remedy": entry.remedy,
        }
    )
    if output.prints_text:
        echo(f"{code}: {entry.summary}\nRemedy: {entry.remedy}\nExit status: {status}")
