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
    MsbError,
    UsageError,
)

if TYPE_CHECKING:
    from msb.asset import Validation

EPILOG = epilog(
    "msb validate data_stubs/splat_like.triasset",
    "msb validate --json - data_stubs/splat_like.triasset",
    "msb validate --explain TRIASSET_INDEX_OUT_OF_RANGE",
)
SCHEMA = "msb.validate/1"
MAX_FINDINGS = 1000
"""JSON holds this many findings of an asset; a hostile manifest of 1 MiB can cause 90 000."""


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
    from msb.api.validating import validate as check
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
        status = max(status, 0 if found.valid else 1)
        reports.append(
            {
                "schema": SCHEMA,
                "path": str(item),
                "valid": found.valid,
                "findings": [f.to_dict() for f in found.findings[:MAX_FINDINGS]],
                "truncated": len(found.findings) > MAX_FINDINGS,
            }
        )
        if output.prints_text:
            _print(found, output)
    if len(reports) > 1 or "error" not in reports[0]:  # the line on standard error says it all
        output.write_documents(reports)
    return status


def _print(found: Validation, output: Output) -> None:
    from rich.markup import escape

    from msb.asset.validation import SHOWN

    console = output.console()
    path, _, said = found.title.rpartition(": ")
    word, _, counts = said.partition(",")
    console.print(f"{escape(path)}: [bold]{word}[/bold],{counts}", soft_wrap=True)
    if not found.findings or output.quiet:
        return
    table = plain_table("Severity", "Code", "Finding")
    styles = {"error": "red", "warning": "yellow", "info": "dim"}
    for item in found.findings[:SHOWN]:
        where = f" (at {item.pointer})" if item.pointer else ""
        table.add_row(f"[{styles[item.severity]}]{item.severity}[/]", item.code, escape(item.message + where))
    console.print(table)
    if (more := len(found.findings) - SHOWN) > 0:
        console.print(f"... and {more:,} more; --json lists up to {MAX_FINDINGS:,}")


def _explain(name: str, output: Output) -> None:
    import difflib

    code = name.upper()
    if code not in CODES:
        near = ", ".join(difflib.get_close_matches(code, CODES, 3, 0.4)) or "docs/errors.md lists all"
        raise UsageError("NAME_UNKNOWN", f'there is no code "{name}"; did you mean {near}?')
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
