"""One sentence for a technical artist: what the mesh can be used for, and why not for the rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from msb.topology.audit import Audit

Level = Literal["ok", "limited", "bad"]

# Uses that refuse or crack what is no manifold surface. UV unwrapping and collision, which the paper names
# too ("Mesh Structural Results": Local structure), cut and join by themselves: docs/trial.md has trials.
SOLID_TOOLS = "subdivision, booleans or printing"
# Share of non-manifold edges up to which tools that cut a mesh there get away with it.
MANY = 0.01
# Pieces of fewer faces, where there are more than a few, are no surface to unwrap or subdivide.
SMALL_PIECE, FEW_PIECES = 10, 10

# What is said of a mesh that is open only where vertices are doubled, but for no UV or colour.
MERGED = "closed once coincident vertices are merged"


@dataclass(frozen=True)
class Verdict:
    """`level` grades it, `sentence` says it; meaning is never carried by the level's colour alone.

    `reason` is the first thing that stands in the way, in a few words, or "" where nothing does. Of what does
    not even render (`renders`) nothing else is said.
    """

    level: Level
    sentence: str
    reason: str = ""
    renders: bool = True

    @property
    def word(self) -> str:
        """The level as a person reads it: OK, LIMITED or BAD."""
        return self.level.upper()

    def __str__(self) -> str:
        return f"{self.word}: {self.sentence}."


def judge(audit: Audit) -> Verdict:
    """Return the verdict on an audited mesh: all that stands in the way, the gravest first.

    Any mesh with a face that has an area renders on the standard tier, if all areas are finite: of others
    nothing is said but that. The gravest reason decides what else a mesh is good for.
    Seams stand in nobody's way: what is judged is the mesh without them.
    """
    counts = audit.counts
    if audit.without_seams is not None:
        verdict = judge(audit.without_seams)
        doubled = "vertex is" if counts.seam_vertices == 1 else "vertices are"
        kind = "texture" if audit.seams == "texture" else "colour"
        text = f"{verdict.sentence}; {counts.seam_vertices:,} {doubled} doubled at {kind} seams"
        return replace(verdict, sentence=text)
    if reason := _invisible(audit):
        return Verdict("bad", f"does not render: {reason}", reason.removeprefix("it has "), renders=False)
    merged = f"; {MERGED}" if audit.closed_once_merged else ""
    if counts.all_apart:
        return Verdict("bad", f"renders; {_soup(audit)}", f"triangle soup{merged}")
    reasons_why = [(reason, text) for reason in _REASONS if (text := reason.found(audit))]
    if not reasons_why:
        return Verdict("ok", f"structurally usable throughout: {_sound(audit)}")
    gravest, first = reasons_why[0]
    *most, last = [text for _, text in reasons_why]
    reasons = f"{', '.join(most)}, and {last}" if most else last
    sentence = f"renders; {gravest.uses(audit)}, because {reasons}{merged}"
    return Verdict(gravest.level, sentence, first.removeprefix("it is ").removeprefix("its ") + merged)


def _invisible(audit: Audit) -> str:
    """Say why nothing draws the mesh, "" if something does; some faces without area are in nobody's way."""
    counts = audit.counts
    if counts.faces == counts.repeated_index_faces:
        return "it has no proper face"
    if counts.nonfinite_faces:
        share = percent(counts.nonfinite_faces, counts.faces)
        return f"{share} of its faces have no finite area, for coordinates are NaN, infinite or too large"
    if counts.faces == counts.repeated_index_faces + counts.zero_area_faces:
        return "none of its faces has an area"
    return ""


def _soup(audit: Audit) -> str:
    why = "because it is a triangle soup: no two faces share a vertex"
    if audit.corners_coincide is False and (audit.welded is None or audit.welded.weld == "exact"):
        alone = "and no two corners coincide, so it is no surface and repair cannot make it one"
        return f"not usable for subdivision, booleans, printing, collision or UV unwrapping, {why}, {alone}"
    joined = "for collision or UV unwrapping only where corners coincide"
    return f"not usable for {SOLID_TOOLS}, and {joined}, {why}{_welded(audit)}"


def _nonmanifold(audit: Audit) -> str:
    counts = audit.counts
    if not counts.nonmanifold_vertices:
        return ""
    edges = f"{percent(counts.nonmanifold_edges, counts.edges)} of its edges and "
    vertices = f"{percent(counts.nonmanifold_vertices, counts.vertices)} of its vertices are non-manifold"
    return f"{edges if counts.nonmanifold_edges else ''}{vertices}"


def _uses_of_nonmanifold(audit: Audit) -> str:
    if audit.counts.nonmanifold_edges > MANY * audit.counts.edges:
        return f"not usable for {SOLID_TOOLS}, unreliable for collision or UV unwrapping"
    return "unreliable for subdivision, booleans, printing, collision or UV unwrapping"


def _open(audit: Audit) -> str:
    counts = audit.counts
    if not counts.boundary_edges:
        return ""
    edges = f"it is open: {counts.boundary_edges:,} boundary edge{'' if counts.boundary_edges == 1 else 's'}"
    if counts.nonmanifold_vertices:  # where borders cross there are other ways to count loops
        return edges
    return f"{edges} in {'1 loop' if counts.boundary_loops == 1 else f'{counts.boundary_loops:,} loops'}"


def _uses_of_open(audit: Audit) -> str:
    if audit.closed_once_merged:
        return f"usable for UV unwrapping; merge coincident vertices before {SOLID_TOOLS}"
    faces, pieces = audit.counts.faces, audit.metrics.components
    if pieces > FEW_PIECES and faces < SMALL_PIECE * pieces:
        small = (
            f"its pieces, of {faces / pieces:.1f} faces in the mean, are too small for subdivision and UV "
        )
        return f"{small}unwrapping; not usable as a solid for collision or printing"
    if pieces > FEW_PIECES:
        cracks = "subdivision cracks where its pieces touch"
        return f"usable for UV unwrapping; {cracks}; not usable as a solid for collision or printing"
    return "usable for subdivision and UV unwrapping; not usable as a solid for collision or printing"


def _pieces(audit: Audit) -> str:
    """Say in how many pieces a mesh is; a closed one may well have several bodies."""
    counts = audit.counts
    if counts.components < 2 or not (counts.boundary_edges or counts.nonmanifold_vertices):
        return ""
    largest = percent(counts.largest_component_faces, counts.faces)
    return f"it is in {counts.components:,} pieces (the largest holds {largest} of the faces)"


def _doubled(audit: Audit) -> str:
    counts = audit.counts
    if not counts.duplicate_faces:
        return ""
    return f"{percent(counts.duplicate_faces, counts.faces)} of its faces repeat another"


def _flips(audit: Audit) -> str:
    flips = audit.counts.inconsistent_winding_edges
    return f"its winding flips across {flips:,} edge{'' if flips == 1 else 's'}" if flips else ""


@dataclass(frozen=True)
class _Reason:
    """What stands in the way.

    `found` says it with its number, or is "" where there is none of it; `uses` says what a mesh can be used
    for if nothing graver is found.
    """

    level: Level
    found: Callable[[Audit], str]
    uses: Callable[[Audit], str]


# In order of gravity.
_REASONS = (
    _Reason("bad", _nonmanifold, _uses_of_nonmanifold),
    _Reason("limited", _open, _uses_of_open),
    _Reason("limited", _pieces, _uses_of_open),
    _Reason(
        "limited", _doubled, lambda _: f"flickers where both of two are drawn; not usable for {SOLID_TOOLS}"
    ),
    _Reason(
        "limited",
        _flips,
        lambda _: "make the winding consistent before computing normals, booleans or printing",
    ),
)


def _sound(audit: Audit) -> str:
    bodies = f", in {audit.counts.components:,} separate bodies" if audit.counts.components > 1 else ""
    unused = audit.counts.unreferenced_vertices
    apart = f"; {unused:,} {'vertex is' if unused == 1 else 'vertices are'} in no face" if unused else ""
    return f"closed, manifold and consistently wound{bodies}{apart}"


def percent(part: int, whole: int) -> str:
    """Return a share as percent; a share that is not 0 or 1 is never shown as "0 %" or "100 %"."""
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


def _welded(audit: Audit) -> str:
    if audit.welded is None:
        return f"; {MERGED}" if audit.closed_once_merged else ""
    counts = audit.welded.counts
    if counts.vertices == audit.counts.vertices:
        return ", and welding merges nothing"
    if not counts.components:
        return "; welded, nothing is left of it"
    pieces = "one piece" if counts.components == 1 else f"{counts.components:,} pieces"
    if counts.nonmanifold_vertices == 0:
        return f"; welded, it is manifold, in {pieces}"
    share = percent(counts.nonmanifold_vertices, counts.vertices)
    return f"; welded, {share} of its vertices are non-manifold and it is in {pieces}"
