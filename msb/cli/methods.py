"""`msb methods`: what each method has, and what each tier keeps of it, printed from `msb/methods.py`."""

from __future__ import annotations

from dataclasses import asdict, fields
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from msb.cli.options import Debug, Force, JsonFile, Quiet, Verbose, epilog
from msb.cli.output import Output, plain_table

if TYPE_CHECKING:
    from collections.abc import Iterator

EPILOG = epilog("msb methods", "msb methods --format markdown", "msb methods --json -")
SCHEMA = "msb.methods/1"
Cell = bool | str | None
TableRows = list[tuple[str, ...]]


def methods(
    form: Annotated[
        Literal["text", "markdown"], typer.Option("--format", help="How to print the tables.")
    ] = "text",
    json_file: JsonFile = None,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
    debug: Debug = False,
) -> None:
    """Show the methods: what their representations have, what each tier keeps, their settings.

    "-" marks what the source representation does not have, N/A what a tier does not support.
    """
    output = Output(json_file, quiet, verbose, force)
    output.check_free(json_file)
    output.write_json(as_data())
    if not output.prints_text:
        return
    for number, (title, rows) in enumerate(tables()):
        if number:
            typer.echo()
        typer.echo(f"## {title}\n" if form == "markdown" else title)
        if form == "markdown":
            typer.echo("\n".join(_markdown(rows)))
        else:
            # A word a line in the header: the names below it then fit into 80 columns.
            table = plain_table(*(title.replace(" ", "\n") for title in rows[0]), gap=1)
            for row in rows[1:]:
                table.add_row(*row)
            output.console().print(table)


def as_data() -> dict[str, Any]:
    """Return everything about the methods as JSON data."""
    from msb.methods import METHODS

    return {
        "schema": SCHEMA,
        "methods": {
            name: {
                "title": method.title,
                "paper_name": method.paper_name,
                "native": method.native and asdict(method.native),
                "retained": {tier: asdict(kept) for tier, kept in method.retained.items()},
                "unsupported": dict(method.unsupported),
                "settings": {
                    key: {"default": s.default, "kind": s.kind, "choices": list(s.choices)}
                    for key, s in method.settings.items()
                },
            }
            for name, method in METHODS.items()
        },
    }


def tables() -> Iterator[tuple[str, TableRows]]:
    """Yield title and rows, the first one the header, of each table."""
    from msb.methods import METHODS, TIERS, Native, Retained

    native = [field.name for field in fields(Native)]
    rows: TableRows = [("method", *(_words(name) for name in native))]
    rows += [
        (method.title, *(_mark(getattr(method.native, name)) for name in native))
        for method in METHODS.values()
        if method.native
    ]
    yield "What the representation has", rows
    kept = [field.name for field in fields(Retained)]
    for tier in TIERS[1:]:
        rows = [("method", *(_words(name) for name in kept))]
        for method in METHODS.values():
            if method.paper_name:
                found = method.retained.get(tier)
                cells = [_mark(getattr(found, name)) if found else "N/A" for name in kept]
                rows.append((method.title, *cells))
        yield f"What the {tier} tier keeps of it", rows
    rows = [("method", "tier", "why")]
    rows += [
        (method.title, tier, why) for method in METHODS.values() for tier, why in method.unsupported.items()
    ]
    yield "What no tier can do", rows
    rows = [("method", "setting", "default", "values")]
    for name, method in METHODS.items():
        rows += [
            (
                name,
                key,
                _value(s.default),
                ", ".join(s.choices) or s.kind + (" or none" if s.optional else ""),
            )
            for key, s in method.settings.items()
        ]
    yield "Settings", rows


def _words(name: str) -> str:
    return "SH" if name == "sh" else name.replace("_", " ")


def _mark(value: Cell) -> str:
    if value is None:
        return "-"
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else value


def _value(value: object) -> str:
    return "none" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


def _markdown(rows: TableRows) -> list[str]:
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return [lines[0], "|" + "---|" * len(rows[0]), *lines[1:]]
