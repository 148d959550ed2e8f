"""What was tried on an asset's mesh, tasks and ways to repair it, as its page shows them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from msb.base.files import read_file
from msb.bench.documents import Look, RepairDocument, Strategy
from msb.bench.folder import REPAIRS_FOLDER, TRIAL_FOLDER
from msb.errors import shorten
from msb.report.metric_format import text
from msb.report.pictures import data_uri
from msb.report.results import Loaded
from msb.report.table import NOT_THERE, Cell, Column, Row, Table

Mark = Literal["YES", "WITH CARE", "NO", "UNKNOWN"]
_MARKS: dict[str, Mark] = {"works": "YES", "care": "WITH CARE", "fails": "NO", "not_run": "UNKNOWN"}
_LEVELS = {"ok": 0, "limited": 1, "bad": 2}
_PNG = b"\x89PNG\r\n\x1a\n"
_MOST_BYTES = 4 << 20


@dataclass(frozen=True)
class TriedTask:
    """One task: its mark, its name, what was made and what is wrong with it, and its picture."""

    mark: Mark
    task: str
    title: str
    why: str
    picture: str | None = None

    def to_dict(self) -> dict[str, str]:
        """Return it as JSON data, without the picture."""
        return {"mark": self.mark, "task": self.task, "why": self.why}


def tried_tasks(loaded: Loaded | None, *, pictures: bool = True) -> list[TriedTask]:
    """Return the tasks in the record of an exported mesh; `pictures` are for the page."""
    if loaded is None or loaded.result.trial is None:
        return []
    tasks = []
    for trial in loaded.result.trial.trials:
        spent = "" if trial.outcome == "not_run" else f" ({trial.seconds:.1f} s)"
        said = "; ".join(filter(None, (trial.says, trial.why)))
        why = f"{shorten(said[:1].upper() + said[1:], 500)}{spent}."
        picture = _png_uri(loaded, TRIAL_FOLDER, trial.picture) if pictures else None
        tasks.append(TriedTask(_MARKS[trial.outcome], trial.task, trial.title, why, picture))
    return tasks


def _png_uri(loaded: Loaded, folder: str, name: str | None) -> str | None:
    """Return the picture `name` in a folder beside a record as an address; None if it is none."""
    path = None if name is None else loaded.file(f"{folder}/{name}")
    if path is None:
        return None
    data = read_file(path, _MOST_BYTES)
    if not data.startswith(_PNG) or len(data) > _MOST_BYTES:
        return None
    return data_uri("image/png", data)


@dataclass(frozen=True)
class Repairs:
    """The ways to repair a mesh."""

    table: Table
    # What follows for the owner of the mesh, in sentences.
    says: tuple[str, ...]
    # The plan to name to `msb repair`: that of the first sentence.
    plan: str | None
    # Strategy and picture, of strategies that cut, removed or added something.
    pictures: tuple[tuple[str, str], ...]


def repairs(loaded: Loaded | None) -> Repairs | None:
    """Return the ways to repair in the record of an exported mesh; None where there are none."""
    if loaded is None or loaded.result.repairs is None:
        return None
    stored, *others = loaded.result.repairs.made
    says, plan = _says(stored, others)
    pictures = [
        (row.strategy, uri)
        for row in others
        if (row.edges_cut or row.faces_added or row.faces_kept < stored.faces_kept)
        and (uri := _png_uri(loaded, REPAIRS_FOLDER, row.picture)) is not None
    ]
    return Repairs(_table(loaded.result.repairs), tuple(says), plan, tuple(pictures))


def _says(stored: Strategy, others: Sequence[Strategy]) -> tuple[list[str], str | None]:
    """Return what follows for the owner of the mesh, and the plan of the way that comes first."""
    better = [row for row in others if _grade(row) < _grade(stored)]
    free = min(
        (row for row in better if row.peer is None and row.looks.standard.same), key=_rank, default=None
    )
    costly = min((row for row in better if not row.looks.standard.same), key=_rank, default=None)
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
