"""A mesh that is open at seams alone is said to be closed once merged, and no other mesh is."""

from __future__ import annotations

import numpy as np
import pytest

from data_stubs.splat_like import splat_like
from msb import audit
from msb.topology import seams
from tests.conftest import BOOK, TETRAHEDRON

MERGED = "closed once coincident vertices are merged"
POINTS, FACES = TETRAHEDRON
# The first face has vertices of its own, as where normals or UVs change: open along its three edges.
HARD = np.concatenate([POINTS, POINTS[FACES[0]]]), np.concatenate([[[4, 5, 6]], FACES[1:]])
# A slit: only one end of it is stored twice.
SLIT = np.concatenate([POINTS, POINTS[FACES[0, :1]]]), np.concatenate([[[4, *FACES[0, 1:]]], FACES[1:]])


@pytest.mark.parametrize("weld", [None, "exact", 1e-9])
@pytest.mark.parametrize("mesh", [HARD, SLIT])
def test_seams_are_told_from_holes(mesh: tuple[np.ndarray, np.ndarray], weld: float | None) -> None:
    found = audit(*mesh, weld=weld)
    assert found.closed_once_merged
    assert found.verdict in ("limited", "bad")
    assert MERGED in found.sentence
    assert not audit(mesh[0], mesh[1][:-1], weld=weld).closed_once_merged  # a hole beside the seam
    moved = mesh[0] + np.where(np.arange(len(mesh[0])) < 4, 0, 1e-3)[:, None]
    assert MERGED not in audit(moved, mesh[1]).sentence


@pytest.mark.parametrize(
    "mesh",
    [
        TETRAHEDRON,
        (POINTS, FACES[:3]),
        BOOK,
        (np.tile(POINTS, (2, 1)), np.concatenate([FACES, FACES[:, ::-1] + 4])[:-1]),  # welded, faces repeat
        (np.full((6, 3), np.nan), np.arange(6).reshape(2, 3)),
    ],
)
def test_what_a_weld_does_not_close_is_not_said_to_be(mesh: tuple[np.ndarray, np.ndarray]) -> None:
    for weld in (None, "exact"):
        assert not audit(*mesh, weld=weld).closed_once_merged


def test_larger_meshes_are_welded_only_if_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(seams, "MOST_FACES", 3)
    assert not audit(*HARD).closed_once_merged
    assert audit(*HARD, weld="exact").closed_once_merged


def test_a_mesh_with_true_holes_is_not_welded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(seams, "weld_vertices", lambda *_: pytest.fail("it was"))
    points, faces = splat_like(14)
    audit(points, faces)
    audit(POINTS, FACES[:3])
