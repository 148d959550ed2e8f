"""Print an audit for people: verdict, the paper's eight columns, defects, verdict; of several one table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msb.base.paths import shell_word
from msb.cli.output import plain_table
from msb.errors import MsbError, one_line
from msb.topology.shown import structure_text
from msb.topology.verdict import judge, percent

if TYPE_CHECKING:
    from rich.console import Console

    from msb.topology.audit import Audit, Sample
    from msb.topology.verdict import Level

_COLUMNS = (
    ("V/F", "vf_ratio"),
    ("Valence", "mean_valence"),
    ("Bound.\nedge", "boundary_edge_ratio"),
    ("Non-man.\nedge ↓", "nonmanifold_edge_ratio"),
    ("Non-man.\nvertex ↓", "nonmanifold_vertex_ratio"),
    ("LCC\nface ↑", "lcc_face_ratio"),
    ("LCC\narea ↑", "lcc_area_ratio"),
    ("Compo-\nnents ↓", "components"),
)
"""The columns of the paper's table of mesh diagnostics, in its order."""

_DEFECTS = (
    ("nonmanifold_edges", "edge", "edges", "edges"),
    ("nonmanifold_vertices", "vertex", "vertices", "vertices"),
    ("multifan_vertices", "vertex", "vertices", "  in several fans (bow-ties)"),
    ("boundary_edges", "edge", "edges", "boundary edges"),
    ("inconsistent_winding_edges", "edge", "edges", "edges where winding flips"),
    ("duplicate_faces", "face", "faces", "duplicate faces"),
    ("repeated_index_faces", "face", "faces", "faces naming a vertex twice"),
    ("zero_area_faces", "face", "faces", "zero-area faces"),
    ("nonfinite_faces", "face", "faces", "faces without a finite area"),
    ("unreferenced_vertices", "vertex", "vertices", "vertices no face uses"),
)
_STYLES: dict[Level, str] = {"ok": "green", "limited": "yellow", "bad": "red"}
"""Verdict level -> colour. The word on the terminal says the same without the colour."""
_VERDICTS = {"agrees": "agrees", "differs_by_definition": "by definition", "disagrees": "DISAGREES"}
_LABELS = {
    "nonmanifold_edges": "non-manifold edges",
    "nonmanifold_vertices": "non-manifold vertices",
}


def print_audit(
    audit: Audit, console: Console, *, paper: bool = False, verbose: bool = False, hint: bool = True
) -> None:
    """Print the report of one audit.

    Parameters
    ----------
    paper : bool
        Whether the paper's mean row of MeshSplatting is printed under ours.
    verbose : bool
        Whether every quantity that the peers were asked for is shown, not only those on which they differ.
    hint : bool
        Whether `msb trial` is pointed to, which tries what the verdict can only say of the structure, and
        what helps a soup.
    """
    counts = audit.counts
    kind = "triangle soup" if audit.topology == "triangle_soup" else "indexed mesh"
    method = f", {audit.method}" if audit.method else ""
    print_verdict(audit, console)
    _print_line(f"{kind}, {counts.vertices:,} vertices, {counts.faces:,} faces{method}", console)
    console.print()
    rows: list[tuple[str, dict[str, Any]]] = [("this mesh", audit.to_dict()["metrics"])]
    if audit.welded:
        weld = audit.welded.weld
        label = "welded" if weld == "exact" else f"welded {weld:g}"
        rows.append((label, {**rows[0][1], **vars(audit.welded.metrics)}))
    if paper:
        from msb.report import paper_row

        rows.append(("paper mean", paper_row("mesh_connectivity", scene="mean")))
    _print_columns(rows, console)
    console.print()
    _print_defects(audit, console)
    if audit.cross_check is not None:
        _print_cross_check(audit.cross_check, console, every=verbose)
    console.print()
    if hint and audit.path is not None and str(audit.path).isprintable():  # else a terminal would act on it
        path = _escape(shell_word(audit.path))
        if helps := advice(audit, "-o merged.glb", path):
            _print_line(f"[dim]{helps}[/dim]", console)
        _print_line(f"[dim]What tools make of it: msb trial {path}[/dim]", console)
    print_verdict(audit, console)


def _print_line(markup: str, console: Console) -> None:
    """Print one line: broken between words on a terminal, whole in a pipe, where programs read lines."""
    console.print(markup, soft_wrap=not console.is_terminal)


def print_verdict(audit: Audit, console: Console) -> None:
    """Print the verdict on one line, after the name of the mesh."""
    verdict = judge(audit)
    style = _STYLES[verdict.level]
    path = _escape(one_line(audit.path or "mesh"))
    joins = audit.corners_coincide and audit.welded is None and not audit.closed_once_merged
    hint = " (--weld exact shows what merging coincident vertices would give)" if joins else ""
    _print_line(f"[bold]{path}[/bold]: [{style}]{verdict.word}[/{style}]: {verdict.sentence}{hint}.", console)


def print_summary(done: Sequence[tuple[Path, Audit | MsbError]], console: Console) -> None:
    """Print a row for each mesh, of a failed one with its error; in a pipe every row is one line."""
    table = plain_table("File", "Verdict", "Faces", "First reason", right=(2,))
    for path, one in done:
        file = _escape(one_line(str(path)))
        if isinstance(one, MsbError):
            table.add_row(file, "-", "-", one.code)
            continue
        verdict = judge(one)
        style = _STYLES[verdict.level]
        table.add_row(
            file, f"[{style}]{verdict.word}[/{style}]", f"{one.counts.faces:,}", verdict.reason or "-"
        )
    if not console.is_terminal:
        console.width = 10_000  # no table is as wide
    console.print(table)


def totals(found: Sequence[Audit | MsbError], failed_gates: int | None = None) -> str:
    """Return how many meshes have each verdict, and how many failed a gate if there were gates."""
    levels = [one.verdict for one in found if not isinstance(one, MsbError)]
    parts = [f"{levels.count(level)} {level}" for level in _STYLES]
    unread = len(found) - len(levels)
    more = [] if failed_gates is None else [f"{failed_gates} failed a gate"]
    more += [f"{unread} not read"] if unread else []
    return "; ".join([f"{len(found)} meshes: {', '.join(parts)}", *more])


def _print_columns(rows: list[tuple[str, dict[str, Any]]], console: Console) -> None:
    arrows = console.encoding.lower().startswith("utf")
    titles = [title if arrows else title.rstrip(" ↓↑") for title, _ in _COLUMNS]
    table = plain_table("", *titles, right=tuple(range(1, len(_COLUMNS) + 1)))
    for label, metrics in rows:
        table.add_row(label, *(_cell(key, metrics[key]) for _, key in _COLUMNS))
    console.print(table)


def _cell(key: str, value: float | None) -> str:
    return "-" if value is None else structure_text(key, value)


def _print_defects(audit: Audit, console: Console) -> None:
    counts = vars(audit.counts)
    table = plain_table("Found", "Count", "Share", "The first three, and where", right=(1, 2))
    shown = 0
    above: list[str] = []
    soup = audit.topology == "triangle_soup"
    if soup and counts["boundary_edges"]:
        console.print("Every edge is a boundary edge: that is what a triangle soup means.")
    for key, noun, whole, label in _DEFECTS:
        count = counts[key]
        if count == 0 or (key == "boundary_edges" and soup):
            continue
        shown += 1
        places = [_where(noun, sample) for sample in audit.samples.get(key, ())]
        if key == "multifan_vertices":  # these are non-manifold vertices, too: each place is named once
            places = [place for place in places if place not in above] or ["as above"]
        above = places
        table.add_row(_LABELS.get(key, label), f"{count:,}", percent(count, counts[whole]), "\n".join(places))
    if shown:
        console.print(table)
    elif not soup:
        console.print("Nothing found: no boundary, no non-manifold or degenerate element.")


def _where(noun: str, sample: Sample) -> str:
    place = " ".join(f"{x:.3g}" for x in sample.coordinates[0])
    # An edge is known by its two vertices; its number is an accident of our numbering.
    name = "-".join(map(str, sample.vertices)) if noun == "edge" else str(sample.element)
    return f"{noun} {name} at {place}"


def _print_cross_check(rows: list[dict[str, Any]], console: Console, *, every: bool) -> None:
    """Print how many quantities each peer confirms, then those it does not (all of them if `every`)."""
    console.print()
    summary = plain_table("Peer", "Agrees", "Differs by definition", "Disagrees", right=(1, 2, 3))
    for peer in dict.fromkeys(row["peer"] for row in rows):
        own = [row for row in rows if row["peer"] == peer]
        counts = [sum(row["verdict"] == verdict for row in own) for verdict in _VERDICTS]
        summary.add_row(f"{peer} {own[0]['version']}", *map(str, counts))
    console.print(summary)
    shown = [row for row in rows if every or row["verdict"] != "agrees"]
    if not shown:
        return
    console.print()
    table = plain_table("Peer", "Quantity", "Ours", "Theirs", "", right=(2, 3))
    for row in shown:
        values = (_value(row["ours"]), _value(row["theirs"]))
        table.add_row(row["peer"], row["quantity"], *values, _VERDICTS[row["verdict"]])
    console.print(table)
    reasons = {row["why"]: row["peer"] for row in shown if row["verdict"] != "agrees" and row["why"]}
    for why, peer in reasons.items():
        _print_line(f"[dim]{peer}: {_escape(why)}[/dim]", console)


def _value(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return str(value)
    return (
        f"{value:,}" if isinstance(value, int) else f"{value:.6g}" if isinstance(value, float) else str(value)
    )


def _escape(text: str) -> str:
    from rich.markup import escape

    return escape(text)


def advice(audit: Audit, output: str, source: str) -> str | None:
    """Return what helps where faces share no vertices; `output` is the option -o, `source` what to repair."""
    from msb.registry import lookup

    if audit.closed_once_merged or audit.corners_coincide:
        return f"Merge the vertices: msb repair --plan weld,orient,pair {output} {source}"
    if audit.corners_coincide is False and audit.method and "dedicated" in lookup(audit.method).passes:
        shown = f"msb web --tier dedicated -o page.html {source}"
        return (
            f"As trained it is seen on the dedicated tier alone: {shown}; what engines lose: msb why {source}"
        )
    return None
