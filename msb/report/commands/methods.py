"""The command `msb methods`: features and settings of each method, from `msb.registry`."""

from collections.abc import Iterator
from dataclasses import asdict
from typing import Annotated, Any, Literal

from msb.base.option import Option
from msb.cli.command import command
from msb.cli.output import JsonOutput, echo
from msb.report.table import Table

# Rows of texts. The first row is the header.
TextRows = list[tuple[str, ...]]


@command("msb methods", "msb methods --format markdown", "msb methods --json -")
def methods(
    *,
    format: Annotated[Literal["text", "markdown"], Option("Format of the tables.")] = "text",
    output: JsonOutput,
) -> None:
    """List the methods: features of their representations, the features that each tier keeps, and settings.


    The mark -- means that the representation lacks the feature. N/A means that the tier does not support the
    feature.
    """
    output.write_json(as_data())
    if not output.prints_text:
        return
    for number, (title, rows) in enumerate(tables()):
        if number:
            echo()
        echo(f"## {title}\n" if format == "markdown" else title)
        if format == "markdown":
            echo("\n".join(_markdown(rows)))
        else:
            # Write one word per line in the header, so that the table fits into 80 columns.
            output.table([title.replace(" ", "\n") for title in rows[0]], rows[1:], gap=1)


def as_data() -> dict[str, Any]:
    """Return everything about the methods as JSON data."""
    from msb.registry import METHODS

    return {
        "schema": "msb.methods/1",
        "methods": {
            name: {
                "title": method.title,
                "paper_name": method.paper_name,
                "native": method.native and asdict(method.native),
                "retained": {tier: asdict(retained) for tier, retained in method.retained.items()},
                "unsupported": dict(method.unsupported),
                "settings": {
                    key: {"default": s.default, "kind": s.kind, "choices": list(s.choices)}
                    for key, s in method.settings.items()
                },
            }
            for name, method in METHODS.items()
        },
    }


def tables() -> Iterator[tuple[str, TextRows]]:
    """Yield the title and the rows of each table."""
    from msb.registry import METHODS
    from msb.report.tables.features import TIER_TITLES, deployment_features, native_features

    yield "Features of the representations", _table_rows(native_features())
    for tier, heading in TIER_TITLES.items():
        retained = [method.retained[tier] for method in METHODS.values() if tier in method.retained]
        notes = {note for features in retained for note in features.notes.values()}
        starred = f" (*: {'; '.join(sorted(notes))})" if notes else ""
        yield f"Features kept by the {tier} tier{starred}", _table_rows(deployment_features(), heading)
    rows: TextRows = [("method", "tier", "why")]
    rows += [
        (method.title, tier, why) for method in METHODS.values() for tier, why in method.unsupported.items()
    ]
    yield "Unsupported tiers", rows
    rows = [("method", "setting", "default", "values")]
    for name, method in METHODS.items():
        rows += [
            (
                name,
                key,
                _format_value(s.default),
                ", ".join(s.choices) or s.kind + (" or none" if s.optional else ""),
            )
            for key, s in method.settings.items()
        ]
    yield "Settings", rows


def _table_rows(table: Table, group: str | None = None) -> TextRows:
    """Return the texts of all table columns. If `group` is given, return only the columns below this heading.

    A star marks a text with a note.
    """
    places = [n for n, column in enumerate(table.columns) if group is None or group in column.groups]
    rows: TextRows = [("method", *(table.columns[place].title for place in places))]
    for row in table.rows:
        cells = (row.cells[place] for place in places)
        rows.append((row.labels[0], *(cell.text + "*" * len(cell.notes) for cell in cells)))
    return rows


def _format_value(value: object) -> str:
    return "none" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


def _markdown(rows: TextRows) -> list[str]:
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return [lines[0], "|" + "---|" * len(rows[0]), *lines[1:]]
