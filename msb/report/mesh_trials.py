"""Prepare the outcomes of trial tasks and repair strategies for the page of an asset."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from msb.base.files import read_file
from msb.bench.documents import RepairDocument, Strategy, TierSimilarity
from msb.bench.folder import REPAIRS_FOLDER, TRIAL_FOLDER
from msb.errors import shorten
from msb.report.compared_views import data_uri
from msb.report.metric_format import format_value
from msb.report.results import LoadedResult
from msb.report.table import NOT_AVAILABLE, Table, TableCell, TableColumn, TableRow

Mark = Literal["YES", "WITH CARE", "NO", "UNKNOWN"]
_MARKS: dict[str, Mark] = {"works": "YES", "care": "WITH CARE", "fails": "NO", "not_run": "UNKNOWN"}
# Audit verdicts from the best to the worst.
_LEVELS = {"ok": 0, "limited": 1, "bad": 2}
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# Maximum size of a PNG in bytes (4 MiB). Larger images are not embedded in a page.
_MAX_BYTES = 4 << 20


@dataclass(frozen=True)
class TaskOutcome:
    """The outcome of one trial task: its mark, its result as text, its problems, and an image."""

    mark: Mark
    task: str
    title: str
    why: str
    picture: str | None = None

    def to_dict(self) -> dict[str, str]:
        """Return the outcome as JSON data, without the image."""
        return {"mark": self.mark, "task": self.task, "why": self.why}


def read_task_outcomes(loaded: LoadedResult | None, *, pictures: bool = True) -> list[TaskOutcome]:
    """Return the outcomes of the trial tasks on an exported mesh.

    Images are included if `pictures` is true.
    """
    if loaded is None or loaded.result.trial is None:
        return []
    outcomes = []
    for trial in loaded.result.trial.trials:
        spent = "" if trial.outcome == "not_run" else f" ({trial.seconds:.1f} s)"
        summary = "; ".join(filter(None, (trial.says, trial.why)))
        why = f"{shorten(summary[:1].upper() + summary[1:], 500)}{spent}."
        picture = _read_png(loaded, TRIAL_FOLDER, trial.picture) if pictures else None
        outcomes.append(TaskOutcome(_MARKS[trial.outcome], trial.task, trial.title, why, picture))
    return outcomes


def _read_png(loaded: LoadedResult, folder: str, name: str | None) -> str | None:
    """Return a PNG file as a data URI. If the file is missing or was changed, return None."""
    path = None if name is None else loaded.file(f"{folder}/{name}")
    if path is None:
        return None
    data = read_file(path, _MAX_BYTES)
    if not data.startswith(_PNG_SIGNATURE) or len(data) > _MAX_BYTES:
        return None
    return data_uri("image/png", data)


@dataclass(frozen=True)
class RepairComparison:
    """The repair strategies for one mesh.

    Attributes
    ----------
    table : Table
    advice : tuple of str
        Recommended repairs as sentences.
    plan : str or None
        The plan for `msb repair --plan` that the first sentence recommends.
    pictures : tuple of (str, str)
        Name and image of each strategy that cut edges, removed faces or added faces.
    """

    table: Table
    advice: tuple[str, ...]
    plan: str | None
    pictures: tuple[tuple[str, str], ...]


def read_repairs(loaded: LoadedResult | None) -> RepairComparison | None:
    """Return the repair strategies in the record of an exported mesh.

    If the record has no strategies, return None.
    """
    if loaded is None or loaded.result.repairs is None:
        return None
    stored, *others = loaded.result.repairs.succeeded
    advice, plan = _advise(stored, others)
    pictures = [
        (strategy.strategy, uri)
        for strategy in others
        if (strategy.edges_cut or strategy.faces_added or strategy.faces_kept < stored.faces_kept)
        and (uri := _read_png(loaded, REPAIRS_FOLDER, strategy.picture)) is not None
    ]
    return RepairComparison(_make_table(loaded.result.repairs), tuple(advice), plan, tuple(pictures))


def _advise(stored: Strategy, others: Sequence[Strategy]) -> tuple[list[str], str | None]:
    """Return recommended repairs as sentences, and the plan that the first sentence recommends.

    Parameters
    ----------
    stored : Strategy
        The unrepaired mesh.
    others : sequence of Strategy
        All strategies that ran.
    """
    better = [strategy for strategy in others if _grade(strategy) < _grade(stored)]
    # Recommend the best strategy that changes no pixel. Also recommend the best strategy that changes the
    # image.
    invisible = min(
        (strategy for strategy in better if strategy.peer is None and strategy.looks.standard.same),
        key=_rank,
        default=None,
    )
    visible = min(
        (strategy for strategy in better if not strategy.looks.standard.same), key=_rank, default=None
    )
    # The second strategy is recommended only if its result is better than the result of the first strategy.
    sentences, plan = [], None
    if invisible is not None:
        plan = ",".join(invisible.plan)
        sentences.append(f"With {plan} no pixel changes, {_describe_result(invisible, stored)}.")
    if visible is not None and (invisible is None or _grade(visible) < _grade(invisible)):
        if plan is None and visible.peer is None:
            plan = ",".join(visible.plan)
        kept = 100 * visible.faces_kept / max(stored.faces_kept, 1)
        psnr = visible.looks.standard.psnr
        similarity = "" if psnr is None else f" and renders with {psnr:.1f} dB PSNR against the original"
        change = f"the mesh keeps {kept:.0f} % of its faces{similarity}"
        sentences.append(f"With {visible.strategy} {change}, {_describe_result(visible, stored)}.")
    if not sentences:
        sentences.append("No repair strategy improves the verdict or makes more tasks work.")
    return sentences, plan


def _grade(strategy: Strategy) -> tuple[int, int]:
    """Return a sort key: first the number of working tasks, then the audit verdict.

    The best mesh comes first.
    """
    return -strategy.trials_passed_after, _LEVELS[strategy.verdict_after]


def _rank(strategy: Strategy) -> tuple[tuple[int, int], int]:
    """Return a sort key: first the verdict's grade, then the number of components."""
    return _grade(strategy), strategy.components


def _describe_result(strategy: Strategy, stored: Strategy) -> str:
    """Return the verdict and the working tasks after a repair, compared with the unrepaired mesh."""
    before, after = stored.verdict_after.upper(), strategy.verdict_after.upper()
    same = before == after
    verdict = f"and the verdict stays {after}" if same else f"and the verdict is {after} instead of {before}"
    if not strategy.trials:
        return verdict
    passed_before, passed_after = strategy.trials_passed_before, strategy.trials_passed_after
    tasks = f"{passed_after} of {len(strategy.trials)} tasks work"
    return f"{verdict}; {tasks} ({'as' if passed_before == passed_after else passed_before} before)"


def _make_table(document: RepairDocument) -> Table:
    """Return one table row per strategy."""
    titles = (
        *("Faces kept", "Added", "Edges cut", "Pieces", "Verdict", "Tasks"),
        *("Standard, dB", "Dedicated, dB", "MiB", "Seconds"),
    )
    stored = document.succeeded[0]
    rows = []
    for strategy in document.strategies:
        if isinstance(strategy, Strategy):
            cells = _make_cells(strategy, max(stored.faces_kept, 1))
        else:
            cells = (TableCell(NOT_AVAILABLE, reason=shorten(strategy.why, 300)),) * len(titles)
        rows.append(TableRow((strategy.strategy,), cells))
    compared = f"dB: mean PSNR against the unrepaired mesh, over {document.views}"
    notes = [f'{compared}; "same" means that all pixels are equal.']
    if stored.trials:
        names = ", ".join(stored.trials)
        notes.append(f"Tasks: number of working tasks, possibly with limitations, out of these: {names}.")
    caption = "Repair strategies: faces kept, similarity and cost."
    columns = tuple(TableColumn(title) for title in titles)
    return Table("repairs", caption, ("Strategy",), columns, tuple(rows), tuple(notes))


def _make_cells(strategy: Strategy, stored_faces: int) -> tuple[TableCell, ...]:
    """Return the table cells of a strategy. `stored_faces` is the number of faces of the unrepaired mesh."""
    passed, total = strategy.trials_passed_after, len(strategy.trials)
    tasks = TableCell(f"{passed} of {total}", float(passed), "tasks")
    return (
        TableCell(f"{100 * strategy.faces_kept / stored_faces:.1f} %", float(strategy.faces_kept), "faces"),
        TableCell(f"{strategy.faces_added:,}", float(strategy.faces_added), "faces"),
        TableCell(f"{strategy.edges_cut:,}", float(strategy.edges_cut), "edges"),
        TableCell(f"{strategy.components:,}", float(strategy.components), "components"),
        TableCell(strategy.verdict_after.upper(), strategy.verdict_after),
        tasks if total else TableCell(NOT_AVAILABLE, reason="no trial task was run"),
        _similarity_cell(strategy.looks.standard),
        _similarity_cell(strategy.looks.dedicated),
        TableCell(
            format_value("asset_size", strategy.bytes), strategy.bytes / float(1 << 20), "asset_size", "MiB"
        ),
        TableCell(f"{strategy.seconds:.1f}", float(strategy.seconds), "seconds", "s"),
    )


def _similarity_cell(look: TierSimilarity) -> TableCell:
    """Return the PSNR between renderings of the repaired and the unrepaired mesh."""
    if look.same:
        return TableCell("same", "same")
    if look.psnr is None:
        return TableCell(NOT_AVAILABLE, reason=shorten(look.why or "not rendered", 200))
    return TableCell(f"{look.psnr:.1f}", look.psnr, "psnr", "dB")
