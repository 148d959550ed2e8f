"""The report as data: sections with tables, charts and renderings, findings, and a verdict per asset."""

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

from msb.base.version import __version__
from msb.report.compared_views import ComparedView
from msb.report.figures import Figure
from msb.report.findings import Finding
from msb.report.numbers import Numbers
from msb.report.results import Place, ResultSet
from msb.report.table import Table
from msb.report.verdict import Verdict, judge

SCHEMA = "msb.report/1"


@dataclass(frozen=True)
class Section:
    """One section of a report; `name` is its anchor."""

    name: str
    title: str
    intro: str
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
    views: tuple[ComparedView, ...] = ()


@dataclass(frozen=True)
class Report:
    """A report with its numbers and records.

    Attributes
    ----------
    title, summary : str
    sections : tuple of Section
    findings : tuple of Finding
    notes : tuple of str
        Warnings for the reader: mixed results, failed cells.
    numbers : Numbers
    results : ResultSet or None
        The results; None for the paper's own tables.
    with_paper : bool
        Whether tables also show the paper's numbers.
    """

    title: str
    summary: str
    sections: tuple[Section, ...]
    findings: tuple[Finding, ...]
    notes: tuple[str, ...]
    numbers: Numbers
    results: ResultSet | None = None
    with_paper: bool = True

    page = "index.html"
    """The template file of the first page."""

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """The verdict on each asset.

        Verdicts are computed on first access, because the computation compares renderings.
        """
        if self.results is None:
            return ()
        places = self.results.places
        return tuple(
            judge(place, places[place], self.numbers) for place in list_places(self.results, self.numbers)
        )

    @property
    def tables(self) -> dict[str, Table]:
        """The tables by label, in the order of the sections."""
        return {table.label: table for section in self.sections for table in section.tables}

    @property
    def mixes(self) -> bool:
        """Whether a table of ours also has rows of the paper."""
        return any(row.paper for table in self.tables.values() for row in table.rows)

    def to_dict(self) -> dict[str, Any]:
        """Return the report as JSON data (schema msb.report/1) with unrounded numbers."""
        return {
            "schema": SCHEMA,
            "tool_version": __version__,
            "title": self.title,
            "summary": self.summary,
            "findings": [asdict(finding) for finding in self.findings],
            "notes": list(self.notes),
            "verdicts": [
                {
                    **verdict.place._asdict(),
                    "statements": [statement.to_dict() for statement in verdict.statements],
                    "tried": [outcome.to_dict() for outcome in verdict.outcomes],
                }
                for verdict in self.verdicts
            ],
            "tables": [table.to_dict() for table in self.tables.values()],
        }


def list_places(results: ResultSet, numbers: Numbers) -> list[Place]:
    """Return the assets in the order of the numbers: by dataset, method and scene."""
    return [
        place
        for dataset in numbers.datasets()
        for method in numbers.methods(dataset)
        for scene in numbers.scenes(dataset)
        if (place := Place(dataset, scene, method)) in results.places
    ]
