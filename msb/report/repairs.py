"""What would make an asset's mesh usable, and what that costs, as its page shows it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from msb.bench.documents import Look, RepairDocument, Strategy
from msb.errors import shorten
from msb.report.metric_format import text
from msb.report.table import NOT_THERE, Cell, Column, Row, Table
from msb.report.trials import png_uri

if TYPE_CHECKING:
    from msb.report.results import Loaded

FOLDER = "repairs"
"""The folder beside a record with the pictures of repairs."""
_LEVELS = {"ok": 0, "limited": 1, "bad": 2}


@dataclass(frozen=True)
class Repairs:
    """The ways to repair a mesh."""

    table: Table
    says: tuple[str, ...]
    """What follows for the owner of the mesh, in sentences."""
    plan: str | None
    """The plan to name to `msb repair`: that of the first sentence."""
    pictures: tuple[tuple[str, str], ...]
    """Strategy and picture, of strategies that cut, removed or added something."""


def repairs(loaded: Loaded | None) -> Repairs | None:
    """Return the ways to repair in the record of an exported mesh; None where there are none."""
    if loaded is None or loaded.result.repairs is None:
        return None
    stored, *others = loaded.result.repairs.made
    says, plan = _says(stored, others)
    pictures = [
        (row.strategy, uri)
        for row in others
        if _changes(row, stored) and (uri := png_uri(loaded, FOLDER, row.picture)) is not None
    ]
    return Repairs(_table(loaded.result.repairs), tuple(says), plan, tuple(pictures))


def _says(stored: Strategy, others: Sequence[Strategy]) -> tuple[list[str], str | None]:
    """Return what follows for the owner of the mesh, and the plan of the way that comes first."""
    better = [row for row in others if _grade(row) < _grade(stored)]
    free = min((row for row in better if row.peer is None and _is_free(row)), key=_rank, default=None)
    costly = min((row for row in better if not _is_free(row)), key=_rank, default=None)
    sentences, plan = [], None
    if free is not None:
        plan = ",".join(free.plan)
        sentences.append(f"With {plan} nothing visible changes, {_result(free, stored)}.")
    if costly is not None and (free is None or _grade(costly) < _grade(free)):
        if plan is None and costly.peer is None:
            plan = ",".join(costly.plan)
        kept = 100 * costly.faces_kept / max(stored.faces_kept, 1)
        psnr = costly.looks.standard.psnr
        seen = "" if psnr is None else f", looks {psnr:.1f} dB like the original"
        what = f"the mesh keeps {kept:.0f} % of its faces{seen}"
        sentences.append(f"With {costly.strategy} {what}, {_result(costly, stored)}.")
    if not sentences:
        sentences.append("None of the ways that were tried gives a better verdict, or lets more tasks work.")
    return sentences, plan


def _is_free(row: Strategy) -> bool:
    return row.looks.standard.same


def _grade(row: Strategy) -> tuple[int, int]:
    """Return what decides whether a mesh is better than another; less is better."""
    return -row.trials_passed_after, _LEVELS[row.verdict_after]


def _rank(row: Strategy) -> tuple[tuple[int, int], int]:
    return _grade(row), row.components


def _result(row: Strategy, stored: Strategy) -> str:
    was, now = stored.verdict_after.upper(), row.verdict_after.upper()
    verdict = f"and the verdict stays {now}" if was == now else f"and the verdict is {now} instead of {was}"
    if not row.trials:
        return verdict
    before, after = row.trials_passed_before, row.trials_passed_after
    tasks = f"{after} of {len(row.trials)} tasks work"
    return f"{verdict}; {tasks}, {'as before' if before == after else f'{before} before'}"


def _changes(row: Strategy, stored: Strategy) -> bool:
    return bool(row.edges_cut or row.faces_added or row.faces_kept < stored.faces_kept)


def _table(document: RepairDocument) -> Table:
    titles = (
        *("Faces kept", "Added", "Edges cut", "Pieces", "Verdict", "Tasks"),
        *("Standard, dB", "Dedicated, dB", "MiB", "Seconds"),
    )
    stored = document.made[0]
    rows = []
    for row in document.strategies:
        if isinstance(row, Strategy):
            cells = _cells(row, max(stored.faces_kept, 1))
        else:
            cells = (Cell(NOT_THERE, reason=shorten(row.why, 300)),) * len(titles)
        rows.append(Row((row.strategy,), cells))
    what = f"Decibels are the mean PSNR to the mesh as stored over {document.views}"
    notes = [f'{what}; "same" means every pixel.']
    if stored.trials:
        notes.append(f"Tasks, that work with care or without: {', '.join(stored.trials)}.")
    caption = "What each way to repair the mesh keeps and costs."
    columns = tuple(Column(title) for title in titles)
    return Table("repairs", caption, ("Strategy",), columns, tuple(rows), tuple(notes))


def _cells(row: Strategy, whole: int) -> tuple[Cell, ...]:
    passed, tried = row.trials_passed_after, len(row.trials)
    tasks = Cell(f"{passed} of {tried}", float(passed), "tasks")
    return (
        Cell(f"{100 * row.faces_kept / whole:.1f} %", float(row.faces_kept), "faces"),
        Cell(f"{row.faces_added:,}", float(row.faces_added), "faces"),
        Cell(f"{row.edges_cut:,}", float(row.edges_cut), "edges"),
        Cell(f"{row.components:,}", float(row.components), "components"),
        Cell(row.verdict_after.upper(), row.verdict_after),
        tasks if tried else Cell(NOT_THERE, reason="no task was tried"),
        _look(row.looks.standard),
        _look(row.looks.dedicated),
        Cell(text("asset_size", row.bytes), row.bytes / float(1 << 20), "asset_size", "MiB"),
        Cell(f"{row.seconds:.1f}", float(row.seconds), "seconds", "s"),
    )


def _look(look: Look) -> Cell:
    if look.same:
        return Cell("same", "same")
    if look.psnr is None:
        return Cell(NOT_THERE, reason=shorten(look.why or "not drawn", 200))
    return Cell(f"{look.psnr:.1f}", look.psnr, "psnr", "dB")
