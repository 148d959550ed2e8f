"""What six peer libraries say of the same mesh, and whether each agrees or differs by definition.

Only this package uses libigl, PyMeshLab, manifold3d, trimesh (as a judge), NetworkX and NVIDIA's validator of
USD. `peers.py` asks these peers, each in a process of its own; `expected.py` computes from their definitions
what they should say; this module compares the two.
"""

from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, Literal

from numpy.typing import ArrayLike

from msb.base.extras import install, is_installed, need_extra
from msb.topology.analysis import Analysis
from msb.topology.arrays import mesh_arrays
from msb.topology.audit import Audit
from msb.topology.crosscheck.expected import EXPECTED, Expected, Facts
from msb.topology.crosscheck.peers import PEERS, Answer, Answers, ask_peers

__all__ = ["PEERS", "CrossCheck", "Row", "compare", "cross_check"]

Verdict = Literal["agrees", "differs_by_definition", "disagrees"]
# Seconds that a peer is given, and as many again for each million faces; libigl needs 12 seconds for a
# million.
PATIENCE = 60.0
# Peers that are installed without the extra: a dependency of scikit-image (extra bench).
ANYWAY = {"NetworkX"}


@dataclass(frozen=True)
class Row:
    """One number of ours beside a peer's.

    `why` says how the definitions differ on this mesh and by how much, or what was expected instead; it is
    empty where the two agree. `call` is how the peer's number was obtained. A disagreement, which no
    difference of definition explains, is a bug in the peer or in our audit.
    """

    peer: str
    version: str
    quantity: str
    ours: Answer
    theirs: Answer
    verdict: Verdict
    why: str
    call: str


@dataclass(frozen=True)
class CrossCheck:
    """All comparisons; `skipped` says why a peer, or "PEER QUANTITY", was not asked or did not answer."""

    rows: tuple[Row, ...]
    skipped: dict[str, str]

    def to_rows(self) -> list[dict[str, Any]]:
        """Return the rows as JSON data (audit: `cross_check`)."""
        return [dict(vars(row)) for row in self.rows]


def cross_check(
    vertices: ArrayLike, faces: ArrayLike, report: Audit, analysis: Analysis, *, timeout: float | None = None
) -> CrossCheck:
    """Ask every installed peer about a mesh and compare with our audit of it.

    `report` and `analysis` are what `audit_arrays` made of the same arrays. Each peer is given `timeout`
    seconds; by default a minute, and one more for each million faces.
    """
    points, triangles = mesh_arrays(vertices, faces)
    here = [peer for peer in PEERS if is_installed(PEERS[peer].module)]
    if not set(here) - ANYWAY:
        wanted = (PEERS[peer].module for peer in PEERS if peer not in ANYWAY)
        need_extra("crosscheck", *wanted, what="a cross-check")
    skipped = {peer: f"it is not installed; {install('crosscheck')}" for peer in PEERS if peer not in here}
    to_ask = []
    for peer in here:
        most = PEERS[peer].max_faces
        if len(triangles) == 0:
            skipped[peer] = "there are no faces to count, and some peers abort on none"
        elif most is not None and len(triangles) > most:
            skipped[peer] = f"it is asked about meshes of at most {most:,} faces; this has {len(triangles):,}"
        else:
            to_ask.append(peer)
    if timeout is None:
        timeout = PATIENCE * (1 + len(triangles) / 1e6)
    replies = ask_peers(to_ask, points, triangles, timeout)
    facts = Facts(report, analysis) if replies else None
    rows: list[Row] = []
    for peer in to_ask:
        answers = replies[peer]
        if isinstance(answers, str) or facts is None:
            skipped[peer] = str(answers)
            continue
        compared, left_out = compare(peer, answers, facts)
        rows += compared
        skipped |= left_out
    return CrossCheck(tuple(rows), skipped)


def compare(peer: str, answers: Answers, facts: Facts) -> tuple[list[Row], dict[str, str]]:
    """Return the rows of one peer, and what it left out."""
    rows, left_out = [], {}
    release = version(PEERS[peer].distribution)
    for expected in EXPECTED[peer](facts):
        if expected.unfit:
            left_out[f"{peer} {expected.quantity}"] = f"{expected.call}: {expected.unfit}"
            continue
        theirs = answers.get(expected.answer)
        if theirs is not None and expected.plus:
            theirs += expected.plus
        verdict, why = _judge(expected, theirs)
        rows.append(Row(peer, release, expected.quantity, expected.ours, theirs, verdict, why, expected.call))
    return rows, left_out


def _judge(expected: Expected, theirs: Answer) -> tuple[Verdict, str]:
    """Return the verdict on a peer's number and the reason."""
    if _near(theirs, expected.ours, 0 if expected.why else expected.slack):
        return "agrees", ""
    if expected.why and _near(theirs, expected.theirs, expected.slack):
        return "differs_by_definition", expected.why
    reason = f" ({expected.why})" if expected.why else ""
    return "disagrees", f"{expected.call} should give {expected.theirs}{reason}, and gives {theirs}"


def _near(one: Answer, other: Answer, slack: float) -> bool:
    if one is None or other is None:
        return one is other
    return abs(one - other) <= slack
