"""The verdict on a mesh tells a technical artist for which tasks the mesh is usable, and why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from msb.topology.audit import Audit, Sample
    from msb.topology.findings import Counts

Level = Literal["ok", "limited", "bad"]

# Tasks that need a manifold surface. Tools reject other meshes or tear them open. According to the paper, UV
# unwrapping and collision also need a manifold surface ("Mesh Structural Results": Local structure). However,
# tools for these two tasks cut and join the mesh themselves, see docs/trial.md.
SOLID_TOOLS = "subdivision, booleans or printing"
# Limits for non-manifold edges or vertices: a share and a number. A tool or a person can repair a mesh within
# both limits. Within both limits, the level of the verdict is LIMITED. Beyond one of the limits, the level is
# BAD. The repair profile `game` uses the same share.
MANY, MOST = 0.01, 1000
# The verdict advises merging vertices if a weld removes more than this share of the boundary edges.
_WORTH_MERGING = 0.5
# The repair plan for a mesh with non-finite faces. Every repair drops these faces, and `close` fills the
# holes.
_DROPPING = "orient,pair,close"
# `_NO_STRAYS` removes single triangles, which cannot be parts of a solid. `_ANY_CAP` allows caps of any size.
_NO_STRAYS, _ANY_CAP = "debris:2", 99
# Pieces are called too small if there are more than FEW_PIECES pieces with fewer than SMALL_PIECE faces on
# average. The level of the verdict does not depend on this limit.
SMALL_PIECE, FEW_PIECES = 10, 10


@dataclass(frozen=True)
class Verdict:
    """The level of a verdict, with an explanation in words.

    Attributes
    ----------
    level : {"ok", "limited", "bad"}
    sentence : str
        The tasks for which the mesh is usable, and all faults. The text has no final full stop.
    reason : str
        The gravest fault in a few words. The text is empty for the level "ok".
    renders : bool
        Whether the mesh can be displayed. If not, the sentence mentions only this fault.
    plan : str
        The plan of `msb repair` that improves the mesh, or "bake" if only a new surface helps. The plan is
        empty for the level "ok", or if no plan is known to help.
    """

    level: Level
    sentence: str
    reason: str = ""
    renders: bool = True
    plan: str = ""

    @property
    def word(self) -> str:
        """The level of the verdict in capitals, as printed: OK, LIMITED or BAD."""
        return self.level.upper()

    def __str__(self) -> str:
        return f"{self.word}: {self.sentence}."


def judge(audit: Audit) -> Verdict:
    """Return the verdict on an audited mesh with all its faults, the gravest fault first.

    Any mesh can be displayed in the standard tier (opaque rendering) if all areas are finite and at least
    one area is positive. The gravest fault determines the tasks for which the mesh is usable. Seams are not
    faults: a mesh with seams is judged as if its seams were merged.
    """
    counts = audit.counts
    if audit.without_seams is not None:
        verdict = judge(audit.without_seams)
        text = f"{verdict.sentence}; {_describe_seams(audit)}"
        return replace(verdict, sentence=text)
    if reason := _describe_invisible(audit):
        plan = _DROPPING if 0 < counts.nonfinite_faces < counts.faces else ""
        return Verdict("bad", f"{reason}; nothing to display", reason, renders=False, plan=plan)
    merged = f"; closed once {_name_merged(audit)} are merged" if audit.closed_once_merged else ""
    if counts.all_apart:
        plan = "weld,orient,pair" if audit.corners_coincide else "bake"
        text = f"displays correctly, but {_describe_soup(audit)}"
        return Verdict("bad", text, f"triangle soup{merged}", plan=plan)
    faults = [(fault, text) for fault in _FAULTS if (text := fault.describe(audit))]
    if not faults:
        return Verdict("ok", f"usable for all tasks: {_describe_sound(audit)}")
    # If duplicate faces cause the gravest fault, the verdict names the duplicates first.
    gravest = faults[0][0]
    faults.sort(
        key=lambda pair: not (pair[0].describe is _describe_duplicates and _duplicates_are_cause(audit))
    )
    first = faults[0][1]
    *most, last = [text for _, text in faults]
    reasons = f"{', '.join(most)}, and {last}" if most else last
    # For an open mesh, the list of tasks already contains the advice to merge vertices.
    advice = "" if gravest.tasks is _list_tasks_if_open else merged
    sentence = f"displays correctly, but {reasons}; {gravest.tasks(audit)}{advice or _describe_merged(audit)}"
    mild = gravest.level == "bad" and (_is_nearly_manifold(audit) or _is_manifold_once_merged(audit))
    reason = first.removeprefix("it is ").removeprefix("it ") + merged
    return Verdict("limited" if mild else gravest.level, sentence, reason, plan=_choose_plan(audit))


def _describe_seams(audit: Audit) -> str:
    """Explain why the file stores more vertices than the judged mesh."""
    count = audit.counts.seam_vertices
    vertices = "vertex" if count == 1 else "vertices"
    if audit.seams == "format":
        return f"the file is a triangle list, judged with {count:,} coincident {vertices} merged"
    kind = {"texture": "texture seams", "color": "colour seams"}.get(
        audit.seams or "", "seams of normals or other attributes"
    )
    return f"{count:,} {vertices} {'is' if count == 1 else 'are'} duplicated at {kind}"


def _duplicates_are_cause(audit: Audit) -> bool:
    """Return whether a mesh without its duplicate faces is manifold, or nearly manifold."""
    single = audit.without_duplicates
    return single is not None and 2 * single.nonmanifold_vertices < audit.counts.nonmanifold_vertices


def _is_nearly_manifold(audit: Audit) -> bool:
    counts = audit.counts
    return _are_few(counts.nonmanifold_edges, counts.edges) and _are_few(
        counts.nonmanifold_vertices, counts.vertices
    )


def _are_few(bad: int, whole: int) -> bool:
    return bad <= min(MANY * whole, MOST)


def _is_manifold_once_merged(audit: Audit) -> bool:
    """Return whether the mesh is non-manifold only because vertices are not merged."""
    return (
        is_worth_merging(audit) and audit.merged is not None and not audit.merged.counts.nonmanifold_vertices
    )


def is_worth_merging(audit: Audit) -> bool:
    """Return whether a weld removes most boundary edges and adds no non-manifold edges."""
    return audit.merged is not None and helps(audit.merged.counts, audit.counts)


def helps(merged: Counts, counts: Counts) -> bool:
    """Return whether a weld from `counts` to `merged` removes most boundary edges and adds no faults."""
    return (
        merged.boundary_edges < _WORTH_MERGING * counts.boundary_edges
        and merged.nonmanifold_edges <= counts.nonmanifold_edges
        and merged.nonmanifold_vertices <= counts.nonmanifold_vertices
        and merged.duplicate_faces <= counts.duplicate_faces
    )


def _describe_merged(audit: Audit) -> str:
    """If merging coincident vertices helps but does not close the mesh, return a clause about merging."""
    if audit.closed_once_merged or not is_worth_merging(audit) or audit.merged is None:
        return ""
    edges, pieces = audit.merged.counts.boundary_edges, audit.merged.counts.components
    left = f"{edges:,} boundary edge{'' if edges == 1 else 's'}"
    return f"; merging {_name_merged(audit)} leaves {left}, in {pieces:,} piece{'' if pieces == 1 else 's'}"


def _name_merged(audit: Audit) -> str:
    """Return a name for the vertices merged by the weld of `audit.merged`, such as "coincident vertices"."""
    within = "exact" if audit.merged is None else audit.merged.weld
    return "coincident vertices" if within == "exact" else f"vertices within {within:g}"


def _choose_plan(audit: Audit) -> str:
    """Return the repair plan for a faulty mesh that is not a triangle soup."""
    counts, bodies = audit.counts, audit.bodies
    if is_worth_merging(audit) or audit.closed_once_merged:
        within = "exact" if audit.merged is None else audit.merged.weld
        return f"weld{'' if within == 'exact' else f':{within:g}'},orient,pair"
    if counts.nonfinite_faces and not counts.boundary_edges:
        return _DROPPING
    if counts.duplicate_faces:
        return f"dedupe,orient,pair,{_NO_STRAYS}"
    if counts.nonmanifold_vertices or counts.nonfinite_faces:
        return "orient,pair"
    turns = "orient" if counts.inconsistent_winding_edges else ""
    if counts.boundary_edges:
        strays = "" if counts.components == 1 else f",{_NO_STRAYS}"
        return f"{turns and 'orient,'}close:{counts.boundary_edges}:{_ANY_CAP}{strays},outward"
    if turns or bodies is None:
        return turns
    return "bake" if bodies.flat or bodies.crossing_faces or bodies.touching_vertices else "outward"


def _describe_invisible(audit: Audit) -> str:
    """Return the reason why the mesh cannot be displayed. Return "" if the mesh can be displayed.

    Zero-area faces prevent the display only if all faces have zero area.
    """
    counts = audit.counts
    if counts.faces == counts.repeated_index_faces:
        return "no valid triangles"
    if not _are_few(counts.nonfinite_faces, counts.faces):
        return _describe_nonfinite(audit)
    if counts.faces == counts.repeated_index_faces + counts.zero_area_faces:
        return "all faces have zero area"
    return ""


def _describe_nonfinite(audit: Audit) -> str:
    counts = audit.counts
    if not counts.nonfinite_faces:
        return ""
    share = percent(counts.nonfinite_faces, counts.faces)
    place = ""
    if _are_few(counts.nonfinite_faces, counts.faces):
        face = audit.samples["nonfinite_faces"][0]
        place = f" (face {face.element}, vertices {' '.join(map(str, face.vertices))})"
    return f"{share} of the faces have NaN, infinite or too large coordinates{place}"


def _describe_soup(audit: Audit) -> str:
    soup = "it is a triangle soup (no two triangles share a vertex)"
    if audit.corners_coincide is False and (audit.welded is None or audit.welded.weld == "exact"):
        alone = "no two corners coincide, so neither merging vertices nor a repair can make it a surface"
        tasks = "not usable for subdivision, booleans, printing, collision or UV unwrapping"
        return f"{soup}, and {alone}; {tasks}"
    joined = "collision and UV unwrapping work only where corners coincide"
    return f"{soup}; not usable for {SOLID_TOOLS}; {joined}{_describe_welded(audit)}"


def _describe_nonmanifold(audit: Audit) -> str:
    counts = audit.counts
    if not counts.nonmanifold_vertices:
        return ""
    edges = f"{percent(counts.nonmanifold_edges, counts.edges)} of the edges and "
    vertices = f"{percent(counts.nonmanifold_vertices, counts.vertices)} of the vertices are non-manifold"
    places = ""
    if counts.nonmanifold_vertices <= 3:  # the audit lists three samples of each kind
        names = " and ".join(_locate(sample) for sample in audit.samples.get("nonmanifold_vertices", ()))
        places = f" ({'vertex' if counts.nonmanifold_vertices == 1 else 'vertices'} {names})"
    return f"{edges if counts.nonmanifold_edges else ''}{vertices}{places}"


def _locate(sample: Sample) -> str:
    """Return the index and the position of a vertex, such as "31 at 0.1 0.2 0.3"."""
    place = " ".join(f"{x:.3g}" for x in sample.coordinates[0])
    return f"{sample.element} at {place}"


def _list_tasks_if_nonmanifold(audit: Audit) -> str:
    if audit.counts.nonmanifold_edges > MANY * audit.counts.edges:
        return f"not usable for {SOLID_TOOLS}; unreliable for collision and UV unwrapping"
    return "unreliable for subdivision, booleans, printing, collision and UV unwrapping"


def _describe_open(audit: Audit) -> str:
    counts = audit.counts
    if not counts.boundary_edges:
        return ""
    edges = f"{counts.boundary_edges:,} boundary edge{'' if counts.boundary_edges == 1 else 's'}"
    if counts.nonmanifold_vertices:  # if boundary loops cross, their number is ambiguous
        return f"it is open ({edges})"
    loops = "1 loop" if counts.boundary_loops == 1 else f"{counts.boundary_loops:,} loops"
    return f"it is open ({edges} in {loops})"


def _list_tasks_if_open(audit: Audit) -> str:
    if audit.closed_once_merged:
        merge = f"merge {_name_merged(audit)} before {SOLID_TOOLS}, which closes it"
        return f"usable for UV unwrapping; {merge}"
    faces, pieces = audit.counts.faces, audit.metrics.components
    solid = "not usable as a solid for collision or printing"
    if pieces > FEW_PIECES and faces < SMALL_PIECE * pieces:
        average = f"{faces / pieces:.1f} faces on average"
        return f"its pieces ({average}) are too small to subdivide or unwrap; {solid}"
    if pieces > FEW_PIECES:
        return f"usable for UV unwrapping; subdivision opens cracks between touching pieces; {solid}"
    return f"usable for subdivision and UV unwrapping; {solid}"


def _describe_pieces(audit: Audit) -> str:
    """Return a text about the number of pieces. Separate bodies of a closed mesh do not count as a fault."""
    counts = audit.counts
    if counts.components < 2 or not (counts.boundary_edges or counts.nonmanifold_vertices):
        return ""
    largest = percent(counts.largest_component_faces, counts.faces)
    return f"it consists of {counts.components:,} pieces (the largest holds {largest} of the faces)"


def _describe_duplicates(audit: Audit) -> str:
    counts = audit.counts
    if not counts.duplicate_faces:
        return ""
    text = f"{percent(counts.duplicate_faces, counts.faces)} of the faces are duplicates"
    single = audit.without_duplicates
    if single is None or not _duplicates_are_cause(audit):
        return text
    edges = f"{single.boundary_edges:,} boundary edge{'' if single.boundary_edges == 1 else 's'}"
    left = (
        f"{single.nonmanifold_vertices:,} non-manifold vertices and " if single.nonmanifold_vertices else ""
    )
    return f"{text} (without them, {left}{edges} are left)"


def _describe_flips(audit: Audit) -> str:
    flips = audit.counts.inconsistent_winding_edges
    return f"the winding is inconsistent across {flips:,} edge{'' if flips == 1 else 's'}" if flips else ""


@dataclass(frozen=True)
class _Fault:
    """A kind of fault in a mesh.

    The field `describe` is a function. The function `describe` returns a text about the extent of the fault,
    or "" for a mesh without the fault. The field `tasks` is a function. The function `tasks` returns a text
    about the tasks for which the mesh is usable if this fault is the gravest.
    """

    level: Level
    describe: Callable[[Audit], str]
    tasks: Callable[[Audit], str]


def _describe_inside_out(audit: Audit) -> str:
    bodies = audit.bodies
    if bodies is None or not bodies.inside_out:
        return ""
    if bodies.inside_out == audit.counts.components:
        return "it is wound inside out, like the walls of a room"
    return f"{bodies.inside_out:,} of its {audit.counts.components:,} bodies are wound inside out"


def _describe_flat(audit: Audit) -> str:
    bodies = audit.bodies
    if bodies is None or not bodies.flat:
        return ""
    if bodies.flat == audit.counts.components:
        return "it encloses no volume"
    return f"{bodies.flat:,} of its {audit.counts.components:,} bodies enclose no volume"


def _describe_touching(audit: Audit) -> str:
    bodies = audit.bodies
    if bodies is None or not bodies.touching_vertices:
        return ""
    return f"its {audit.counts.components:,} bodies touch in {bodies.touching_vertices:,} coincident vertices"


def _describe_crossing(audit: Audit) -> str:
    bodies = audit.bodies
    if bodies is None or not bodies.crossing_faces:
        return ""
    return f"{percent(bodies.crossing_faces, audit.counts.faces)} of the faces cross other faces"


def _list_tasks_if_crossing(_: Audit) -> str:
    return "usable for subdivision and UV unwrapping; unreliable for booleans, printing and collision"


# The gravest fault is first in this table.
_FAULTS = (
    _Fault("bad", _describe_nonmanifold, _list_tasks_if_nonmanifold),
    _Fault("limited", _describe_nonfinite, lambda _: "many tools reject it; delete these faces first"),
    _Fault("limited", _describe_open, _list_tasks_if_open),
    _Fault("limited", _describe_pieces, _list_tasks_if_open),
    _Fault(
        "limited", _describe_duplicates, lambda _: f"duplicates may flicker; not usable for {SOLID_TOOLS}"
    ),
    _Fault(
        "limited",
        _describe_flips,
        lambda _: "make the winding consistent before computing normals, booleans or printing",
    ),
    _Fault(
        "limited",
        _describe_inside_out,
        lambda _: "turn its faces before back-face culling, booleans or printing",
    ),
    _Fault("limited", _describe_flat, lambda _: "not usable as a solid for booleans, printing or collision"),
    _Fault("limited", _describe_crossing, _list_tasks_if_crossing),
    _Fault("limited", _describe_touching, _list_tasks_if_crossing),
)


def _describe_sound(audit: Audit) -> str:
    bodies = f", in {audit.counts.components:,} separate bodies" if audit.counts.components > 1 else ""
    unused = audit.counts.unreferenced_vertices
    apart = (
        f"; {unused:,} {'vertex is' if unused == 1 else 'vertices are'} not used by any face"
        if unused
        else ""
    )
    known = audit.bodies is not None and audit.bodies.crossing_faces is not None
    crossing = "" if known else "; self-intersections not checked"
    return f"closed, manifold and consistently wound{bodies}{apart}{crossing}"


def percent(part: int, whole: int) -> str:
    """Return a share as a percentage. The texts "0 %" and "100 %" are only printed for the values 0 and 1."""
    if whole == 0:
        return "-"
    if part == 0:
        return "0 %"
    share = 100.0 * part / whole
    if share < 0.1:
        return "under 0.1 %"
    if part < whole and share > 99.9:
        return "over 99.9 %"
    return f"{share:.1f} %" if share < 10 else f"{share:.0f} %"


def _describe_welded(audit: Audit) -> str:
    """Return the result of the requested weld.

    Without a request, return the exact weld if this weld closes the mesh.
    """
    if audit.welded is None:
        return "; closed once coincident vertices are merged" if audit.closed_once_merged else ""
    counts = audit.welded.counts
    if counts.vertices == audit.counts.vertices:
        return "; welding merges no vertices"
    if not counts.components:
        return "; after welding nothing is left"
    pieces = "one piece" if counts.components == 1 else f"{counts.components:,} pieces"
    if counts.nonmanifold_vertices == 0:
        return f"; after welding it is manifold, in {pieces}"
    share = percent(counts.nonmanifold_vertices, counts.vertices)
    return f"; after welding {share} of its vertices are non-manifold, in {pieces}"
