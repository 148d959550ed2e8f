"""One sentence for a technical artist: what the mesh can be used for, and why not for the rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from msb.topology.audit import Audit

Level = Literal["ok", "limited", "bad"]

SOLID_TOOLS = "subdivision, booleans or printing"
"""Uses that refuse or crack what is no manifold surface. UV unwrapping and collision, which the paper names
too ("Mesh Structural Results": Local structure), cut and join by themselves: docs/trial.md has trials."""
MANY = 0.01
"""Share of non-manifold edges up to which tools that cut a mesh there get away with it."""
SMALL_PIECE, FEW_PIECES = 10, 10
"""Pieces of fewer faces, where there are more than a few, are no surface to unwrap or subdivide."""

MERGED = "closed once coincident vertices are merged"
"""What is said of a mesh that is open only at seams of UVs or normals (`msb.topology.seams`)."""


@dataclass(frozen=True)
class Verdict:
    """`level` grades it, `sentence` says it; meaning is never carried by the level's colour alone.

    `reason` is the first thing that stands in the way, in a few words, or "" where nothing does.
    """

    level: Level
    sentence: str
    reason: str = ""

    @property
    def word(self) -> str:
        """The level as a person reads it: OK, LIMITED or BAD."""
        return self.level.upper()

    def __str__(self) -> str:
        return f"{self.word}: {self.sentence}."


def judge(audit: Audit) -> Verdict:
    """Return the verdict on an audited mesh.

    Any mesh with a face renders on the standard tier. What else it can be used for is decided in this order:
    empty, soup, non-manifold, inconsistent winding, doubled faces, open, closed.
    """
    counts, metrics = audit.counts, audit.metrics
    if counts.faces == counts.repeated_index_faces:
        return Verdict("bad", "does not render: it has no proper face", "no proper face")
    merged = f"; {MERGED}" if audit.closed_once_merged else ""
    if audit.is_soup or (audit.topology == "triangle_soup" and counts.faces > 1):
        return Verdict(
            "bad",
            f"renders; not usable for {SOLID_TOOLS}, and for collision or UV unwrapping only where corners "
            f"coincide, because it is a triangle soup: no two faces share a vertex{_welded(audit)}",
            f"triangle soup{merged}",
        )
    if counts.nonmanifold_vertices:
        vertices = f"{percent(counts.nonmanifold_vertices, counts.vertices)} of its vertices are non-manifold"
        edges = f"{percent(counts.nonmanifold_edges, counts.edges)} of its edges and "
        many = counts.nonmanifold_edges > MANY * counts.edges
        uses = (
            f"not usable for {SOLID_TOOLS}, unreliable for"
            if many
            else "unreliable for subdivision, booleans, printing,"
        )
        return Verdict(
            "bad",
            f"renders; {uses} collision or UV unwrapping, because "
            f"{edges if counts.nonmanifold_edges else ''}{vertices}{_pieces(audit)}{merged}",
            vertices + merged,
        )
    if flips := counts.inconsistent_winding_edges:
        where = f"across {flips:,} edge{'' if flips == 1 else 's'}"
        return Verdict(
            "limited",
            "renders and is manifold; make the winding consistent before computing normals, booleans or "
            f"printing: it flips {where}",
            f"winding flips {where}",
        )
    if counts.duplicate_faces:
        share = percent(counts.duplicate_faces, counts.faces)
        return Verdict(
            "limited",
            f"renders and is manifold, but only because faces are stored twice: {share} of them repeat "
            "another; they flicker where both are drawn, and the surface is open without them",
            f"{share} of its faces repeat another",
        )
    if counts.boundary_edges:
        edges = f"{counts.boundary_edges:,} boundary edges"
        holes = "1 loop" if counts.boundary_loops == 1 else f"{counts.boundary_loops:,} loops"
        return Verdict(
            "limited",
            f"renders; {_uses_of_open(audit)} because it is open: {edges} in {holes}{_pieces(audit)}{merged}",
            f"open: {edges}{merged}",
        )
    what = "closed, manifold and consistently wound"
    bodies = f", in {metrics.components:,} separate bodies" if metrics.components > 1 else ""
    unused = counts.unreferenced_vertices
    apart = f"; {unused:,} {'vertex is' if unused == 1 else 'vertices are'} in no face" if unused else ""
    return Verdict("ok", f"structurally usable throughout: {what}{bodies}{apart}")


def _uses_of_open(audit: Audit) -> str:
    """Return what an open manifold mesh can be used for, up to "because it is open"."""
    if audit.closed_once_merged:
        return f"usable for UV unwrapping; merge coincident vertices before {SOLID_TOOLS}"
    faces, pieces = audit.counts.faces, audit.metrics.components
    if pieces > FEW_PIECES and faces < SMALL_PIECE * pieces:
        small = (
            f"its pieces, of {faces / pieces:.1f} faces in the mean, are too small for subdivision and UV "
        )
        return f"{small}unwrapping; not usable as a solid for collision or printing"
    return "usable for subdivision and UV unwrapping; not usable as a solid for collision or printing"


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


def _pieces(audit: Audit) -> str:
    count, share = audit.metrics.components, audit.metrics.lcc_face_ratio
    if count < 2 or share is None:
        return ""
    largest = percent(audit.counts.largest_component_faces, audit.counts.faces)
    return f", and it is in {count:,} pieces (the largest holds {largest} of the faces)"


def _welded(audit: Audit) -> str:
    if audit.welded is None:
        return f"; {MERGED}" if audit.closed_once_merged else ""
    counts = audit.welded.counts
    if counts.vertices == audit.counts.vertices:
        return ", and welding merges nothing"
    pieces = "one piece" if counts.components == 1 else f"{counts.components:,} pieces"
    if counts.nonmanifold_vertices == 0:
        return f"; welded, it is manifold, in {pieces}"
    share = percent(counts.nonmanifold_vertices, counts.vertices)
    return f"; welded, {share} of its vertices are non-manifold and it is in {pieces}"
