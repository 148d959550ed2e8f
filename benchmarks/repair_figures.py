"""Tables of trials and repairs of single meshes, from benchmarks/results/repair-figures.json."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from msb.topology.metric_text import format_metric

TITLES = {
    "torus": "torus, closed",
    "pebble_mesh_splatting": "`pebble/mesh_splatting`",
    "walled_mesh_splatting": "`walled/mesh_splatting`",
    "pebble_two_dts": "`pebble/two_dts`, soup",
    "pebble_triangle_splatting": "`pebble/triangle_splatting`, soup",
    "splat_like": "`splat_like`",
    "vase": "a vase trained by a user of leonhardrobin/triangle-splatting2",
}
"""Titles of the meshes by name, in the order of the tables.

Each new model needs a line here. This includes models in data_stubs/models.
"""
MARKS = {"works": "+", "care": "~", "fails": "-", "not_run": "not run"}


def _decimation(numbers: dict[str, Any]) -> str:
    best = numbers.get(numbers.get("best", "").replace("-", "_"), {})
    return "" if best.get("psnr") is None else f"{best['psnr']:.0f} dB"


def _cracks(numbers: dict[str, Any]) -> str:
    if numbers["lone_share"] > 0.5:
        return f"{100 * numbers['lone_share']:.0f} % lone"
    return f"cracks {100 * numbers['gap_share']:.2g} %" if numbers["gap_share"] else ""


def _collision(numbers: dict[str, Any]) -> str:
    kind = "mesh" if numbers.get("best") == "pymeshlab" else "hull"
    shape = f"{kind} of {numbers['faces']:,}" if "instead" in numbers else f"{numbers['parts']} parts"
    return f"{shape}, {100 * (numbers['empty_share'] or 0):.0f} % in mid-air"


def _crossing(numbers: dict[str, Any]) -> str:
    return f"{100 * numbers['face_share']:.0f} % cross" if numbers["face_share"] else ""


SHORT: dict[str, Callable[[dict[str, Any]], str]] = {
    "uv": lambda numbers: f"{numbers['charts']:,}",
    **dict.fromkeys(("decimate_50", "decimate_25", "decimate_10"), _decimation),
    "subdivide": _cracks,
    "boolean": lambda _: "",
    "collision": _collision,
    "solid": lambda _: "",
    "self_intersections": _crossing,
}
"""For each task, a function that summarises its numbers in a few words."""


def trial_table(figures: dict[str, Any]) -> str:
    """Return a table with a row for each mesh and a column for each task."""
    heads = ("mesh", "faces", "verdict", *(name.replace("_", " ") for name in SHORT))
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for name, title in TITLES.items():
        if name in figures:
            own = figures[name]
            cells = [title, f"{own['faces']:,}", own["verdict"].upper(), *map(_trial_cell, own["trials"])]
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _trial_cell(one: dict[str, Any]) -> str:
    failed = one["numbers"].get("failed", {})
    if one["outcome"] == "fails" and len(one["numbers"]) == 1 and failed:
        ended = next(iter(failed.values()))
        return f"- not within {ended['seconds']:.0f} s" if ended["ended_by"] == "time" else "-"
    said = SHORT[one["task"]](one["numbers"]) if one["outcome"] != "not_run" else ""
    return f"{MARKS[one['outcome']]} {said}".strip()


def repair_tables(figures: dict[str, Any]) -> str:
    """Return a table for each mesh whose repairs are compared. A table has a row for each strategy."""
    heads = ("strategy", "faces kept", "added", "edges cut", "components", "boundary", "verdict", "tasks")
    heads += ("standard", "dedicated", "MB", "seconds")
    parts = []
    for name, title in TITLES.items():
        rows = figures.get(name, {}).get("repairs")
        if rows:
            lines = [f"**{title[:1].upper()}{title[1:]}**, {figures[name]['faces']:,} faces:", ""]
            lines += [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
            lines += [f"| {' | '.join(_repair_cells(row, rows[0]))} |" for row in rows]
            parts.append("\n".join(lines) + "\n")
    return "\n".join(parts)


def _repair_cells(row: dict[str, Any], stored: dict[str, Any]) -> list[str]:
    if row["why"] is not None:
        code = row["why"].partition(":")[0]
        return [row["strategy"], "nothing left" if code == "TRIASSET_EMPTY" else f"`{code}`", *[""] * 10]
    ratio = row["boundary_edge_ratio"]
    return [
        row["strategy"],
        f"{100 * row['faces_kept'] / stored['faces_kept']:.3g} %",
        f"{row['faces_added']:,}",
        f"{row['edges_cut']:,}",
        f"{row['components']:,}",
        "" if ratio is None else format_metric("boundary_edge_ratio", ratio),
        row["verdict_after"].upper(),
        f"{row['trials_passed_after']} of {len(row['trials'])}",
        *(_look(row["looks"][tier]) for tier in ("standard", "dedicated")),
        f"{row['bytes'] / 1e6:.2f}",
        f"{row['seconds']:.1f}",
    ]


def _look(look: dict[str, Any]) -> str:
    return "same" if look["same"] else "" if look["psnr"] is None else f"{look['psnr']:.1f}"
