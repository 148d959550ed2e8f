"""Compare the audit of a mesh with six other libraries (peers), and explain the differences.

Only this package uses libigl, PyMeshLab, manifold3d, trimesh (as a judge), NetworkX and NVIDIA's USD
validator. `peers.py` runs each peer in a separate process. `expected.py` predicts the answers of each peer
from the peer's definitions. This module compares the peers' answers with the audit and the predictions.
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

__all__ = ["PEERS", "Comparison", "CrossCheck", "compare", "cross_check"]

Verdict = Literal["agrees", "differs_by_definition", "disagrees"]
# Time limit of each peer in seconds. The limit grows by the same number of seconds for each million faces.
# libigl needs 12 s for a million faces.
PATIENCE = 60.0
# Peers that other extras also install. For example, NetworkX is a dependency of scikit-image (extra bench).
ANYWAY = {"NetworkX"}


@dataclass(frozen=True)
class Comparison:
    """A number from our audit, and the corresponding number from a peer library.

    The field `why` is empty if the numbers agree. If the numbers differ, `why` explains the difference
    between the definitions. If there is no such difference, `why` names the expected number. The field `call`
    names the function of the peer. A disagreement is a difference that the definitions cannot explain. A
    disagreement is a bug in the peer or in our audit.
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
    """All comparisons.

    The field `skipped` explains missing answers. The key is a peer, or "PEER QUANTITY".
    """

    rows: tuple[Comparison, ...]
    skipped: dict[str, str]

    def to_rows(self) -> list[dict[str, Any]]:
        """Return the rows as JSON data (audit: `cross_check`)."""
        return [dict(vars(row)) for row in self.rows]


def cross_check(
    vertices: ArrayLike, faces: ArrayLike, report: Audit, analysis: Analysis, *, timeout: float | None = None
) -> CrossCheck:
    """Measure a mesh with every installed peer, and compare the answers with our audit.

    The arguments `report` and `analysis` are the results of `audit_arrays` for the same arrays. Each peer may
    run for `timeout` seconds. The default time limit is 60 seconds, plus 60 seconds per million faces.
    """
    points, triangles = mesh_arrays(vertices, faces)
    installed = [peer for peer in PEERS if is_installed(PEERS[peer].module)]
    if not set(installed) - ANYWAY:
        modules = (PEERS[peer].module for peer in PEERS if peer not in ANYWAY)
        need_extra("crosscheck", *modules, what="a cross-check")
    skipped = {peer: f"not installed; {install('crosscheck')}" for peer in PEERS if peer not in installed}
    to_ask = []
    for peer in installed:
        limit = PEERS[peer].max_faces
        if len(triangles) == 0:
            skipped[peer] = "the mesh has no faces, and some peers abort on empty meshes"
        elif limit is not None and len(triangles) > limit:
            skipped[peer] = f"limited to meshes of {limit:,} faces; this one has {len(triangles):,}"
        else:
            to_ask.append(peer)
    if timeout is None:
        timeout = PATIENCE * (1 + len(triangles) / 1e6)
    replies = ask_peers(to_ask, points, triangles, timeout)
    facts = Facts(report, analysis) if replies else None
    rows: list[Comparison] = []
    for peer in to_ask:
        answers = replies[peer]
        if isinstance(answers, str) or facts is None:
            skipped[peer] = str(answers)
            continue
        compared, not_compared = compare(peer, answers, facts)
        rows += compared
        skipped |= not_compared
    return CrossCheck(tuple(rows), skipped)


def compare(peer: str, answers: Answers, facts: Facts) -> tuple[list[Comparison], dict[str, str]]:
    """Return the comparisons with a peer. Also return the reasons why other numbers were not compared."""
    rows, not_compared = [], {}
    release = version(PEERS[peer].distribution)
    for expected in EXPECTED[peer](facts):
        if expected.unfit:
            not_compared[f"{peer} {expected.quantity}"] = f"{expected.call}: {expected.unfit}"
            continue
        theirs = answers.get(expected.answer)
        if theirs is not None and expected.plus:
            theirs += expected.plus
        verdict, why = _judge(expected, theirs)
        numbers = expected.quantity, expected.ours, theirs
        rows.append(Comparison(peer, release, *numbers, verdict, why, expected.call))
    return rows, not_compared


def _judge(expected: Expected, theirs: Answer) -> tuple[Verdict, str]:
    """Return whether a peer's number agrees with our number. If not, return the reason."""
    if _are_close(theirs, expected.ours, 0 if expected.why else expected.slack):
        return "agrees", ""
    if expected.why and _are_close(theirs, expected.theirs, expected.slack):
        return "differs_by_definition", expected.why
    reason = f" ({expected.why})" if expected.why else ""
    return "disagrees", f"{expected.call} returned {theirs} instead of {expected.theirs}{reason}"


def _are_close(first: Answer, second: Answer, slack: float) -> bool:
    if first is None or second is None:
        return first is second
    return abs(first - second) <= slack
