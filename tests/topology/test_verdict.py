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
        ((LOST, TETRAHEDRON[1]), "bad", "does not render: 75 % of its faces have no finite area"),
        ((np.full((3, 3), np.inf), [[0, 1, 2]]), "bad", "does not render: 100 % of its faces have no finite"),
        ((np.zeros((4, 3)), TETRAHEDRON[1]), "bad", "does not render: none of its faces has an area"),
        ((np.zeros((3, 3)), [[0, 1, 2], [0, 1, 1]]), "bad", "none of its faces has an area"),
        (FLAT_FACE, "ok", "structurally usable throughout"),
        ((POINTS[:3], [[0, 1, 2]]), "bad", "triangle soup"),
        ((np.tile(POINTS[:3], (2, 1)), [[0, 1, 2], [3, 4, 5]]), "bad", "triangle soup"),
        ((np.tile(POINTS[:3], (2, 1)), [[0, 1, 2], [3, 4, 5], [0, 0, 3]]), "bad", "triangle soup"),
        (BOOK, "bad", "because 14 % of its edges and 40 % of its vertices are non-manifold"),
        ((POINTS, [[0, 1, 2], [2, 3, 4]]), "bad", "because 20 % of its vertices are non-manifold"),
        ((POINTS, [[0, 1, 2], [1, 2, 3]]), "limited", "in 1 loop, and its winding flips across 1 edge"),
        ((POINTS, [[0, 1, 2], [1, 3, 2]]), "limited", "4 boundary edges in 1 loop"),
        ((POINTS, [[0, 1, 2], [2, 1, 0]]), "limited", "50 % of its faces repeat another"),
        (TETRAHEDRON, "ok", "closed, manifold and consistently wound"),
        (TWO_TETRAHEDRA, "ok", "in 2 separate bodies"),
        ((np.vstack([TETRAHEDRON[0], POINTS]), TETRAHEDRON[1]), "ok", "; 5 vertices are in no face"),
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
    assert judge(audit(*soup)).sentence.endswith("closed once coincident vertices are merged")
    assert judge(audit(*exploded(points, faces[1:]))).sentence.endswith("no two faces share a vertex")
    assert judge(audit(*soup, weld="exact")).sentence.endswith("welded, it is manifold, in one piece")
    apart = soup[0] + np.repeat(np.arange(4), 3)[:, None] * 10, soup[1]
    alone = judge(audit(*apart)).sentence
    assert "no two corners coincide, so it is no surface and repair cannot make it one" in alone
    assert judge(audit(*apart, weld="exact")).sentence == alone
    assert judge(audit(*apart, weld=30.0)).sentence.endswith("welded, nothing is left of it")


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


def test_what_decides_is_said_before_what_hardly_matters() -> None:
    points, faces = sheet(5)
    faces[7] = faces[7][::-1]  # one face of 50 is turned
    pieces = [(points + 9 * k, faces + 36 * k) for k in range(12)]
    many = judge(audit(*(np.concatenate(part) for part in zip(*pieces, strict=True))))
    assert many.reason == "open: 240 boundary edges in 12 loops"
    order = ("240 boundary edges", "in 12 pieces", "winding flips across 36 edges")
    places = [many.sentence.index(text) for text in order]
    assert places == sorted(places)
    assert "subdivision cracks where its pieces touch" in many.sentence
    turned = [TETRAHEDRON[1][0][::-1], *TETRAHEDRON[1][1:]]
    assert judge(audit(TETRAHEDRON[0], turned)).sentence == (
        "renders; make the winding consistent before computing normals, booleans or printing, because its "
        "winding flips across 3 edges"
    )


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


def test_what_tools_cut_by_themselves_is_unreliable_and_what_they_refuse_is_not_usable() -> None:
    points, faces = sheet(12)  # 288 faces, 456 edges
    fin = np.concatenate([points, [[0.5, 0.5, 1]]]), np.concatenate([faces, [[13, 1, len(points)]]])
    assert "unreliable for subdivision, booleans, printing, collision or" in judge(audit(*fin)).sentence
    assert "not usable for subdivision, booleans or printing, unreliable for collision or UV" in str(
        judge(audit(*BOOK))
    )


def test_an_open_mesh_in_small_pieces_is_not_said_to_unwrap() -> None:
    points, faces = sheet(1)
    many = [(points + 3 * k, faces + 4 * k) for k in range(11)]
    pieces = judge(audit(*(np.concatenate(part) for part in zip(*many, strict=True))))
    assert pieces.level == "limited"
    assert "its pieces, of 2.0 faces in the mean, are too small for subdivision and UV" in pieces.sentence
    assert "usable for subdivision and UV unwrapping;" in judge(audit(*sheet(1))).sentence


def test_seams_crack_under_subdivision_and_unwrap_all_the_same() -> None:
    points, faces = TETRAHEDRON
    halves = [(points, faces[:2]), (points, faces[2:] + 4)]
    apart = tuple(np.concatenate(part) for part in zip(*halves, strict=True))
    verdict = judge(audit(*apart))
    assert verdict.level == "limited"
    assert "usable for UV unwrapping; merge coincident vertices before subdivision" in verdict.sentence
