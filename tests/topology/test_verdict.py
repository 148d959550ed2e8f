"""The one sentence for a technical artist: each kind of mesh gets the grade and the reason it deserves."""

from __future__ import annotations

import numpy as np
import pytest

from msb import audit
from msb.topology import dispatch
from msb.topology.verdict import judge, percent
from tests.conftest import BOOK, TETRAHEDRON
from tests.topology.meshes import sheet

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1]], float)
TWO_TETRAHEDRA = (
    np.concatenate([TETRAHEDRON[0], TETRAHEDRON[0] + 5]),
    np.concatenate([TETRAHEDRON[1], TETRAHEDRON[1] + 4]),
)
LOST = np.where(np.arange(4)[:, None] == 2, np.nan, TETRAHEDRON[0])
"""Corners of the tetrahedron, one of them NaN: in three of the four faces."""
FLAT_FACE = (
    np.vstack([TETRAHEDRON[0], [0.5, 0, 0]]),
    np.array([[0, 2, 4], [4, 2, 1], [0, 4, 1], *TETRAHEDRON[1][1:]]),
)
"""The tetrahedron, an edge of it divided on one side only: a face without area closes the slit."""


def exploded(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return points[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)


@pytest.mark.parametrize(
    ("mesh", "level", "reason"),
    [
        ((POINTS, []), "bad", "no proper face"),
        ((POINTS, [[0, 1, 1]]), "bad", "no proper face"),
        ((LOST, TETRAHEDRON[1]), "bad", "75 %"),
        ((np.full((3, 3), np.inf), [[0, 1, 2]]), "bad", "100 %"),
        ((np.zeros((4, 3)), TETRAHEDRON[1]), "bad", "none of its faces"),
        ((np.zeros((3, 3)), [[0, 1, 2], [0, 1, 1]]), "bad", "none of its faces"),
        (FLAT_FACE, "ok", "structurally usable throughout"),
        ((POINTS[:3], [[0, 1, 2]]), "bad", "triangle soup"),
        ((np.tile(POINTS[:3], (2, 1)), [[0, 1, 2], [3, 4, 5]]), "bad", "triangle soup"),
        ((np.tile(POINTS[:3], (2, 1)), [[0, 1, 2], [3, 4, 5], [0, 0, 3]]), "bad", "triangle soup"),
        (BOOK, "bad", "40 % of its vertices"),
        ((POINTS, [[0, 1, 2], [2, 3, 4]]), "bad", "20 % of its vertices"),
        ((POINTS, [[0, 1, 2], [1, 2, 3]]), "limited", "flips across 1 edge"),
        ((POINTS, [[0, 1, 2], [1, 3, 2]]), "limited", "4 boundary edges"),
        ((POINTS, [[0, 1, 2], [2, 1, 0]]), "limited", "50 % of its faces"),
        (TETRAHEDRON, "ok", "closed, manifold"),
        (TWO_TETRAHEDRA, "ok", "in 2 separate bodies"),
        ((np.vstack([TETRAHEDRON[0], POINTS]), TETRAHEDRON[1]), "ok", "5 vertices"),
    ],
)
def test_verdict(mesh: tuple[np.ndarray, np.ndarray], level: str, reason: str) -> None:
    verdict = judge(audit(*mesh))
    assert verdict.level == level
    assert reason in verdict.sentence
    assert bool(verdict.reason) is (level != "ok")


def test_a_welded_soup_says_what_it_would_be() -> None:
    points, faces = TETRAHEDRON
    soup = exploded(points, faces)
    assert audit(*soup).closed_once_merged
    assert not audit(*exploded(points, faces[1:])).closed_once_merged
    assert "manifold, in one piece" in judge(audit(*soup, weld="exact")).sentence
    apart = soup[0] + np.repeat(np.arange(4), 3)[:, None] * 10, soup[1]
    alone = judge(audit(*apart)).sentence
    assert audit(*apart).corners_coincide is False
    assert judge(audit(*apart, weld="exact")).sentence == alone
    assert "nothing is left" in judge(audit(*apart, weld=30.0)).sentence


@pytest.mark.parametrize("fewest", [1, dispatch.FEWEST_FACES], ids=["OpenCL", "NumPy"])
def test_a_degenerate_row_makes_no_surface_of_a_soup(monkeypatch: pytest.MonkeyPatch, fewest: int) -> None:
    monkeypatch.setattr(dispatch, "FEWEST_FACES", fewest)
    points, faces = exploded(*sheet(3))
    apart = points + np.repeat(np.arange(len(faces)), 3)[:, None] * 10
    rows = np.vstack([faces, [[0, 0, 1], [3, 4, 3]]])
    for corners, coincide in ((apart, False), (points, True)):
        clean, with_rows = audit(corners, faces), audit(corners, rows)
        assert with_rows.computed_by.startswith("OpenCL" if fewest == 1 else "NumPy")
        assert with_rows.topology == "indexed_mesh"  # the definition of the key
        assert with_rows.corners_coincide is clean.corners_coincide is coincide
        assert judge(with_rows) == judge(clean)


@pytest.mark.parametrize(
    ("part", "whole", "text"),
    [
        (0, 0, "-"),
        (0, 5, "0 %"),
        (1, 10_000, "under 0.1 %"),
        (9_999, 10_000, "over 99.9 %"),
        (1, 30, "3.3 %"),
        (5, 5, "100 %"),
    ],
)
def test_a_share_never_rounds_to_nothing_or_all(part: int, whole: int, text: str) -> None:
    assert percent(part, whole) == text
