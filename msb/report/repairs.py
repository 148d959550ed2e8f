"""What would make an asset's mesh usable, and what that costs, as its page shows it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from msb.errors import shorten
from msb.report.metric_format import text
from msb.report.table import NOT_THERE, Cell, Column, Row, Table
from msb.report.trials import png_uri

if TYPE_CHECKING:
    from msb.report.results import Loaded

FOLDER = "repairs"
"""The folder beside a record with the pictures of repairs."""
STORED = "as stored"
"""The strategy of the mesh itself, which comes first."""
TIERS = {"standard": "Standard", "dedicated": "Dedicated"}
_LEVELS = {"ok": 0, "limited": 1, "bad": 2}
_NUMBERS = ("faces_kept", "faces_added", "edges_cut", "components", "bytes", "seconds")
_PASSED = ("trials_passed_before", "trials_passed_after")


@dataclass(frozen=True)
class Repairs:
    """The ways to repair a mesh.

    Attributes
    ----------
    table : Table
    says : tuple of str
        What follows for the owner of the mesh, in sentences.
    plan : str or None
        The plan to name to `msb repair`: that of the first sentence.
    pictures : tuple of (str, str)
        Strategy and picture, of strategies that cut, removed or added something.
    """

    table: Table
    says: tuple[str, ...]
    plan: str | None
    pictures: tuple[tuple[str, str], ...]


def problem(document: Any) -> str | None:
    """Return where a record's repairs are not what `msb repair --compare` writes, None if they are."""
    rows = document.get("strategies") if isinstance(document, dict) else None
    if not isinstance(rows, list) or not rows or not isinstance(document.get("views"), str):
        return "/repairs/strategies"
    for number, row in enumerate(rows):
        if (wrong := _wrong(row)) is not None:
            return f"/repairs/strategies/{number}/{wrong}"
    first = rows[0]
    return None if first["strategy"] == STORED and first["why"] is None else "/repairs/strategies/0/strategy"


def _wrong(row: Any) -> str | None:
    """Return the key of a strategy that is wrong."""
    if not isinstance(row, dict) or not isinstance(row.get("strategy"), str):
        return "strategy"
    if not isinstance(row.get("why", 0), str | None):
        return "why"
    plan = row.get("plan")
    if not isinstance(plan, list) or not all(isinstance(step, str) for step in plan):
        return "plan"
    if not isinstance(row.get("peer", 0), str | None):
        return "peer"
    if row["why"] is not None:
        return None
    if not isinstance(row.get("picture", 0), str | None):
        return "picture"
    for key in (*_NUMBERS, *_PASSED):
        if not isinstance(row.get(key), int | float) or isinstance(row[key], bool):
            return key
    for key in ("verdict_before", "verdict_after"):
        if str(row.get(key)) not in _LEVELS:
            return key
    trials, looks = row.get("trials"), row.get("looks")
    if not isinstance(trials, dict) or not all(isinstance(one, str) for one in trials.values()):
        return "trials"
    if not isinstance(looks, dict) or not all(_is_look(looks.get(tier)) for tier in TIERS):
        return "looks"
    return None


def _is_look(look: Any) -> bool:
    return (
        isinstance(look, dict)
        and isinstance(look.get("psnr", ""), int | float | None)
        and isinstance(look.get("same"), bool)
        and isinstance(look.get("why", 0), str | None)
    )


def repairs(loaded: Loaded | None) -> Repairs | None:
    """Return the ways to repair a mesh that are on record; None where none are.

    Parameters
    ----------
    loaded : Loaded, optional
        The record of the exported mesh, whose repairs `problem` found nothing wrong with.
    """
    if loaded is None or loaded.result.repairs is None:
        return None
    document = loaded.result.repairs
    rows = document["strategies"]
    stored = rows[0]
    says, plan = _says(stored, [row for row in rows[1:] if row["why"] is None])
    pictures = [
        (row["strategy"], png_uri(loaded, FOLDER, row["picture"]))
        for row in rows
        if row["why"] is None and _changes(row, stored)
    ]
    return Repairs(
        _table(rows, document["views"]),
        tuple(says),
        plan,
        tuple((name, uri) for name, uri in pictures if uri is not None),
    )


def _says(stored: dict[str, Any], rows: Sequence[dict[str, Any]]) -> tuple[list[str], str | None]:
    """Return what follows for the owner of the mesh, and the plan of the way that comes first."""
    free = [row for row in rows if row["peer"] is None and row["looks"]["standard"]["same"]]
    free = [row for row in free if _is_better(row, stored)]
    found = []
    plan = None
    if free:
        best = min(free, key=_rank)
        plan = ",".join(best["plan"])
        found.append(f"With {plan} nothing visible changes, {_result(best, stored)}.")
    costly = [row for row in rows if not row["looks"]["standard"]["same"] and _is_better(row, stored)]
    more = [row for row in costly if not free or _rank(row)[:2] < _rank(min(free, key=_rank))[:2]]
    if more:
        best = min(more, key=_rank)
        plan = plan or (",".join(best["plan"]) if best["peer"] is None else None)
        kept = 100 * best["faces_kept"] / max(stored["faces_kept"], 1)
        look = best["looks"]["standard"]["psnr"]
        seen = "" if look is None else f", looks {look:.1f} dB like the original"
        what = f"the mesh keeps {kept:.0f} % of its faces{seen}"
        found.append(f"With {best['strategy']} {what}, {_result(best, stored)}.")
    if not found:
        found.append("None of the ways that were tried gives a better verdict, or lets more tasks work.")
    return found, plan


def _rank(row: dict[str, Any]) -> tuple[int, int, int]:
    return -row["trials_passed_after"], _LEVELS[row["verdict_after"]], row["components"]


def _is_better(row: dict[str, Any], stored: dict[str, Any]) -> bool:
    return _rank(row)[:2] < _rank(stored)[:2]


def _result(row: dict[str, Any], stored: dict[str, Any]) -> str:
    was, now = (one["verdict_after"].upper() for one in (stored, row))
    verdict = f"and the verdict stays {now}" if was == now else f"and the verdict is {now} instead of {was}"
    if not row["trials"]:
        return verdict
    before, after = row["trials_passed_before"], row["trials_passed_after"]
    tasks = f"{after} of {len(row['trials'])} tasks work"
    return f"{verdict}; {tasks}, {'as before' if before == after else f'{before} before'}"


def _changes(row: dict[str, Any], stored: dict[str, Any]) -> bool:
    return bool(row["edges_cut"] or row["faces_added"] or row["faces_kept"] < stored["faces_kept"])


def _table(rows: Sequence[dict[str, Any]], views: str) -> Table:
    titles = ("Faces kept", "Added", "Edges cut", "Pieces", "Verdict", "Tasks")
    columns = [
        Column(title) for title in (*titles, *(f"{title}, dB" for title in TIERS.values()), "MiB", "Seconds")
    ]
    whole = max(rows[0]["faces_kept"], 1)
    made = tuple(Row((row["strategy"],), _cells(row, whole, len(columns))) for row in rows)
    tasks = next((", ".join(row["trials"]) for row in rows if row["why"] is None), "")
    notes = [f'Decibels are the mean PSNR to the mesh as stored over {views}; "same" means every pixel.']
    if tasks:
        notes.append(f"Tasks, that work with care or without: {tasks}.")
    caption = "What each way to repair the mesh keeps and costs."
    return Table("repairs", caption, ("Strategy",), tuple(columns), made, tuple(notes))


def _cells(row: dict[str, Any], whole: int, count: int) -> tuple[Cell, ...]:
    if row["why"] is not None:
        why = shorten(row["why"], 300)
        return tuple(Cell(NOT_THERE, reason=why) for _ in range(count))
    passed, tried = row["trials_passed_after"], len(row["trials"])
    tasks = Cell(f"{passed} of {tried}", float(passed), "tasks")
    return (
        Cell(f"{100 * row['faces_kept'] / whole:.1f} %", float(row["faces_kept"]), "faces"),
        Cell(f"{row['faces_added']:,}", float(row["faces_added"]), "faces"),
        Cell(f"{row['edges_cut']:,}", float(row["edges_cut"]), "edges"),
        Cell(f"{row['components']:,}", float(row["components"]), "components"),
        Cell(row["verdict_after"].upper(), row["verdict_after"]),
        tasks if tried else Cell(NOT_THERE, reason="no task was tried"),
        *(_look(row["looks"][tier]) for tier in TIERS),
        Cell(text("asset_size", row["bytes"]), row["bytes"] / float(1 << 20), "asset_size", "MiB"),
        Cell(f"{row['seconds']:.1f}", float(row["seconds"]), "seconds", "s"),
    )  # fmt: skip


def _look(look: dict[str, Any]) -> Cell:
    if look["same"]:
        return Cell("same", "same")
    if look["psnr"] is None:
        return Cell(NOT_THERE, reason=shorten(look["why"] or "not drawn", 200))
    return Cell(f"{look['psnr']:.1f}", float(look["psnr"]), "psnr", "dB")
