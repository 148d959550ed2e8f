"""`msb validate`: report all errors of an asset with their codes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from msb.base.option import Argument, Option
from msb.cli.command import Typed, command, require
from msb.cli.output import LinesOutput, Output, echo
from msb.errors import EXIT_STATUS, UsageError, explained_codes

if TYPE_CHECKING:
    from msb.asset import Validation

SCHEMA = "msb.validate/1"
# Maximum number of findings per asset in JSON. A hostile manifest of 1 MiB can cause 90,000 findings.
MAX_FINDINGS = 1000


@command(
    "msb validate data_stubs/splat_like.triasset",
    "msb validate --json - data_stubs/splat_like.triasset",
    "msb validate --explain TRIASSET_INDEX_OUT_OF_RANGE",
)
def validate(
    paths: Annotated[
        tuple[Path, ...],
        Argument("Assets, mesh files, or folders of such files.", metavar="PATH..."),
    ] = (),
    *,
    explain: Annotated[
        str | None, Option("Print the meaning of an error code and exit.", metavar="CODE|all")
    ] = None,
    output: LinesOutput,
    typed: Typed,
) -> None:
    """Check assets completely: container, manifest, sizes, hashes and values.

    Errors lead to the exit status 1. Warnings and infos do not change the exit status. A mesh file or
    checkpoint is converted to an asset in memory, and this asset is checked.
    """
    require(paths or explain, "Missing PATH. Pass a .triasset, a mesh file, or a folder with such files")
    if paths:
        typed.reject(["explain"], "cannot be combined with PATH")
    if explain is not None:
        _explain(explain, output)
        return
    from msb.api.command_files import for_each
    from msb.api.validating import validate as check

    def document(path: Path, _alone: bool) -> tuple[dict[str, Any], int]:
        with output.progress(f"validating {path.name}"):
            validation = check(path)
        if output.prints_text:
            _print(validation, output)
        return {
            "schema": SCHEMA,
            "path": str(path),
            "valid": validation.valid,
            "findings": [each.to_dict() for each in validation.findings[:MAX_FINDINGS]],
            "truncated": len(validation.findings) > MAX_FINDINGS,
        }, 0 if validation.valid else 1

    raise typer.Exit(for_each(paths, SCHEMA, output, document)[0])


def _print(validation: Validation, output: Output) -> None:
    from rich.markup import escape

    from msb.asset.validation import SHOWN

    console = output.console()
    path, _, summary = validation.title.rpartition(": ")
    word, _, counts = summary.partition(",")
    console.print(f"{escape(path)}: [bold]{word}[/bold],{counts}", soft_wrap=True)
    if not validation.findings or output.quiet:
        return
    styles = {"error": "red", "warning": "yellow", "info": "dim"}
    rows = [
        (
            (each.severity, styles[each.severity]),
            each.code,
            each.message + (f" (at {each.pointer})" if each.pointer else ""),
        )
        for each in validation.findings[:SHOWN]
    ]
    output.table(("Severity", "Code", "Finding"), rows)
    if (more := len(validation.findings) - SHOWN) > 0:
        console.print(f"... and {more:,} more; --json lists up to {MAX_FINDINGS:,}")


def _explain(name: str, output: Output) -> None:
    import difflib

    code = name.upper()
    if code != "ALL" and code not in explained_codes():
        near = ", ".join(difflib.get_close_matches(code, explained_codes(), 3, 0.4))
        hint = f"did you mean {near}?" if near else "--explain all lists them"
        raise UsageError("NAME_UNKNOWN", f'the code "{name}" is unknown; {hint}')
    documents = [
        {
            "schema": "msb.code/1",
            "code": code,
            "exit_status": EXIT_STATUS[entry.kind],
            "summary": entry.summary,
            "remedy": entry.remedy,
        }
        for code, entry in (explained_codes().items() if code == "ALL" else [(code, explained_codes()[code])])
    ]
    output.write_documents(documents)
    if output.prints_text:
        row = "{code}: {summary}\nRemedy: {remedy}\nExit status: {exit_status}"
        echo("\n\n".join(row.format(**document) for document in documents))
