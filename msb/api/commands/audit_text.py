"""Print an audit as text: the verdict, the paper's eight columns, the defects, and the verdict again.

After several audits, print a table with a row for each mesh.
"""

from collections.abc import Iterable, Sequence
from typing import Any

from msb.api.auditing import native_advice, next_command
from msb.base.paths import shell_word
from msb.cli.output import Cell, Output
from msb.errors import one_line
from msb.topology.audit import Audit, Sample
from msb.topology.metric_text import format_metric
from msb.topology.verdict import Level, judge, percent

# The columns of the paper's table of mesh diagnostics, in the order of this table.
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

_DEFECTS = (
    ("nonmanifold_edges", "edge", "edges", "non-manifold edges"),
    ("nonmanifold_vertices", "vertex", "vertices", "non-manifold vertices"),
    ("multifan_vertices", "vertex", "vertices", "  with several fans (bow-ties)"),
    ("boundary_edges", "edge", "edges", "boundary edges"),
    ("seam_vertices", "vertex", "vertices", "vertices duplicated at seams"),
    ("inconsistent_winding_edges", "edge", "edges", "edges with inconsistent winding"),
    ("inside_out", "body", "components", "bodies that are inside out"),
    ("flat", "body", "components", "bodies without a volume"),
    ("crossing_faces", "face", "faces", "faces that cross others"),
    ("touching_vertices", "vertex", "vertices", "vertices where bodies touch"),
    ("duplicate_faces", "face", "faces", "duplicate faces"),
    ("repeated_index_faces", "face", "faces", "faces listing a vertex twice"),
    ("zero_area_faces", "face", "faces", "zero-area faces"),
    ("nonfinite_faces", "face", "faces", "faces without a finite area"),
    ("unreferenced_vertices", "vertex", "vertices", "unused vertices"),
)
# The colour of the printed word for each verdict level. The word itself is readable without colours.
_STYLES: dict[Level, str] = {"ok": "green", "limited": "yellow", "bad": "red"}
_VERDICTS = {"agrees": "agrees", "differs_by_definition": "by definition", "disagrees": "DISAGREES"}


def print_audit(audit: Audit, output: Output, *, paper: bool = False, hint: bool = True) -> None:
    """Print the report of an audit. With --quiet, print only the verdict.

    The argument `paper` adds the row with the paper's average of MeshSplatting. The argument `hint` adds
    commands that the user can run next.
    """
    _print_verdict(audit, output)
    if output.quiet:
        return
    # Line 2 gives the kind of mesh and its size.
    counts = audit.counts
    kind = "triangle soup (triangles that share no vertices)" if counts.all_apart else "indexed mesh"
    kind = "triangle list (its file format shares no vertices)" if audit.seams == "format" else kind
    method = f", {audit.method}" if audit.method else ""
    output.line(f"{kind}, {counts.vertices:,} vertices, {counts.faces:,} faces{method}")
    output.line("")
    # The rows of the metrics table are this mesh, the welded mesh, and the paper's average.
    stored = vars(audit.metrics)
    rows: list[tuple[str, dict[str, Any]]] = [("as stored" if audit.without_seams else "this mesh", stored)]
    if audit.without_seams:
        rows.append(("seams merged", vars(audit.without_seams.metrics)))
    if audit.welded:
        weld = audit.welded.weld
        label = "welded" if weld == "exact" else f"welded {weld:g}"
        rows.append((label, vars(audit.welded.metrics)))
    if paper:
        from msb.report import paper_row

        rows.append(("paper mean", paper_row("mesh_connectivity", scene="mean")))
    cells = [
        (label, *("-" if metrics[key] is None else format_metric(key, metrics[key]) for _, key in _COLUMNS))
        for label, metrics in rows
    ]
    arrows = output.console().encoding.lower().startswith("utf")
    titles = [title if arrows else title.rstrip(" ↓↑") for title, _ in _COLUMNS]
    output.table(("", *titles), cells, right=range(1, len(_COLUMNS) + 1))
    output.line("")
    _print_defects(audit, output)
    if audit.cross_check is not None:
        _print_cross_check(audit.cross_check, output)
    output.line("")
    # A terminal could interpret other characters as commands.
    if hint and audit.path is not None and str(audit.path).isprintable():
        path = shell_word(audit.path)
        if commands := native_advice(audit, path):
            output.line((commands, "dim"))
        if judge(audit).renders:
            output.line((f"To try common tasks on it: msb trial {path}", "dim"))
    _print_verdict(audit, output)
    printable = audit.path is not None and str(audit.path).isprintable()
    if printable and (command := next_command(audit, shell_word(str(audit.path)))):
        output.line(f"Next: {command}")


def _print_verdict(audit: Audit, output: Output) -> None:
    """Print the name of the mesh and its verdict on one line."""
    verdict = judge(audit)
    coincide = audit.judged.corners_coincide
    joins = coincide and audit.welded is None and not audit.judged.closed_once_merged
    hint = " Run again with --weld exact to see the result of merging." if joins else ""
    word = (verdict.word, _STYLES[verdict.level])
    output.line((one_line(audit.path or "mesh"), "bold"), ": ", word, f": {verdict.sentence}.{hint}")


def print_summary(audits: Iterable[tuple[str, Audit | dict[str, Any]]], output: Output) -> None:
    """Print a row for each mesh.

    The row of a failed mesh contains the error code. In a pipe, no row is wrapped.
    """
    rows: list[tuple[Cell, ...]] = []
    for path, audit in audits:
        if isinstance(audit, dict):
            rows.append((one_line(path), "-", "-", audit["error"]["code"]))
        else:
            verdict = judge(audit)
            word = (verdict.word, _STYLES[verdict.level])
            rows.append((one_line(path), word, f"{audit.counts.faces:,}", verdict.reason or "-"))
    output.table(("File", "Verdict", "Faces", "Main reason"), rows, right=[2], whole=True)


def totals(audits: Sequence[Audit | dict[str, Any]], failed_gates: int | None = None) -> str:
    """Return the number of meshes with each verdict.

    If there are gates (conditions), also return the number of meshes that failed a gate.
    """
    # A failed input is a document (dict) with an error.
    levels = [audit.verdict for audit in audits if not isinstance(audit, dict)]
    parts = [f"{levels.count(level)} {level}" for level in _STYLES]
    unread = len(audits) - len(levels)
    more = [] if failed_gates is None else [f"{failed_gates} failed a gate"]
    more += [f"{unread} not read"] if unread else []
    return "; ".join([f"{len(audits)} meshes: {', '.join(parts)}", *more])


def _print_defects(audit: Audit, output: Output) -> None:
    judged = audit.judged
    counts = {**vars(judged.counts), "seam_vertices": audit.counts.seam_vertices}
    counts |= {} if judged.bodies is None else vars(judged.bodies)
    soup = judged.counts.all_apart
    if audit.without_seams is not None:
        stored = audit.counts.boundary_edges
        output.line(
            f"The verdict merges seams for these counts. The stored file has {stored:,} boundary edges "
            f"and {audit.counts.components:,} components."
        )
    if soup and counts["boundary_edges"]:
        output.line("Every edge is a boundary edge, because the triangles share no vertices.")
    rows: list[tuple[str, ...]] = []
    above: list[str] = []
    for key, noun, whole, label in _DEFECTS:
        count = counts.get(key)
        if not count or (key == "boundary_edges" and soup):
            continue
        places = [_where(noun, sample) for sample in judged.samples.get(key, ())]
        # Do not repeat positions of the row above.
        if key == "multifan_vertices":
            places = [place for place in places if place not in above] or ["as above"]
        above = places
        of = vars(audit.counts) if key == "seam_vertices" else counts
        rows.append((label, f"{count:,}", percent(count, of[whole]), "\n".join(places)))
    if rows:
        output.table(("Defect", "Count", "Share", "First three and their positions"), rows, right=[1, 2])
    elif not soup:
        output.line("No defects: no boundary edges, non-manifold elements or degenerate faces.")


def _where(noun: str, sample: Sample) -> str:
    """Return the name and the position of an element: "edge 3-7 at 0.1 0.2 0.3"."""
    place = " ".join(f"{x:.3g}" for x in sample.coordinates[0])
    # An edge is identified by its two vertices, because the edge index exists only in msb.
    name = "-".join(map(str, sample.vertices)) if noun == "edge" else str(sample.element)
    return f"{noun} {name} at {place}"


def _print_cross_check(rows: Sequence[dict[str, Any]], output: Output) -> None:
    """For each library, print the number of confirmed quantities. Then print all quantities that differ.

    If -v is given, print all quantities.
    """
    peers: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        peers.setdefault(f"{row['peer']} {row['version']}", []).append(row)
    output.line("")
    output.table(
        ("Library", "Agrees", "Differs by definition", "Disagrees"),
        [
            (peer, *(str(sum(row["verdict"] == verdict for row in of_peer)) for verdict in _VERDICTS))
            for peer, of_peer in peers.items()
        ],
        right=[1, 2, 3],
    )
    details = [row for row in rows if output.verbose or row["verdict"] != "agrees"]
    if not details:
        return
    output.line("")
    cells = [
        (row["peer"], row["quantity"], *map(_value, (row["ours"], row["theirs"])), _VERDICTS[row["verdict"]])
        for row in details
    ]
    output.table(("Library", "Quantity", "msb", "Library's", ""), cells, right=[2, 3])
    reasons = {row["why"]: row["peer"] for row in details if row["verdict"] != "agrees" and row["why"]}
    for why, peer in reasons.items():
        output.line((f"{peer}: {why}", "dim"))


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return f"{value:,}" if isinstance(value, int) and not isinstance(value, bool) else str(value)
