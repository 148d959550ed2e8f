"""The report as data: sections with tables, charts and pictures, the findings, and a verdict per asset."""

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

from msb.base.version import __version__
from msb.report.figures import Figure
from msb.report.findings import Finding
from msb.report.numbers import Numbers
from msb.report.pictures import View
from msb.report.results import Place, ResultSet
from msb.report.table import Table
from msb.report.verdict import Verdict, judge

SCHEMA = "msb.report/1"


@dataclass(frozen=True)
class Section:
    """One section of the report. `name` is its anchor."""

    name: str
    title: str
    intro: str
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
    views: tuple[View, ...] = ()


@dataclass(frozen=True)
class Report:
    """The report as data, with the numbers and records it is made of.

    `notes` is what to know before reading: mixed results, failed cells. `results` is None for the paper's own
    tables, `with_paper` says whether its numbers stand beside ours.
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
    """The template of its first page."""

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """The verdict on each asset; made when it is asked for, because renderings are compared for it."""
        if self.results is None:
            return ()
        held = self.results.places
        return tuple(
            judge(place, held[place], self.numbers) for place in places_of(self.results, self.numbers)
        )

    @property
    def tables(self) -> dict[str, Table]:
        """Label -> table, in the order of the sections."""
        return {table.label: table for section in self.sections for table in section.tables}

    @property
    def mixes(self) -> bool:
        """Whether some table holds rows of the paper among ours."""
        return any(row.paper for table in self.tables.values() for row in table.rows)

    def to_dict(self) -> dict[str, Any]:
        """Return the report as JSON data (schema msb.report/1), numbers as full doubles."""
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
                    "statements": [one.to_dict() for one in verdict.statements],
                    "tried": [one.to_dict() for one in verdict.tried],
                }
                for verdict in self.verdicts
            ],
            "tables": [table.to_dict() for table in self.tables.values()],
        }


def places_of(results: ResultSet, numbers: Numbers) -> list[Place]:
    """Return the assets and scenes there are, by dataset, method and scene in the order of the numbers."""
    return [
        place
        for dataset in numbers.datasets()
        for method in numbers.methods(dataset)
        for scene in numbers.scenes(dataset)
        if (place := Place(dataset, scene, method)) in results.places
    ]
