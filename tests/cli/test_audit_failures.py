"""What ends `msb audit` otherwise than its counts do: an asset that is broken, a peer that disagrees."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import msb as library
from msb.asset import build_asset
from msb.repair.run import what_is_left
from msb.topology import audit_arrays
from tests.cli.conftest import Here, Msb, mesh_file
from tests.conftest import ROOT, TETRAHEDRON


def test_value_errors_name_the_asset(msb: Msb, tmp_path: Path) -> None:
    points, faces = TETRAHEDRON
    asset = build_asset({"positions": points, "indices": faces.astype(np.uint32)}, {})
    library.save(asset, tmp_path / "bad.triasset", form="folder")
    indices = np.array([[0, 1, 2], [0, 1, 9], [1, 2, 3], [0, 3, 2]], "<u4")
    (tmp_path / "bad.triasset" / "buffers" / "indices.bin").write_bytes(indices.tobytes())
    msb("audit", tmp_path / "bad.triasset").ends(
        3, f"MESH_INDEX_OUT_OF_RANGE: {tmp_path / 'bad.triasset'}: face 1 is (0, 1, 9)"
    )


def test_a_peer_that_disagrees_fails_the_audit(here: Here, monkeypatch: pytest.MonkeyPatch) -> None:
    row = {"peer": "igl", "quantity": "components", "theirs": 2, "ours": 1, "verdict": "disagrees"}
    made = SimpleNamespace(skipped={}, to_rows=lambda: ({**row, "version": "1", "why": "?"},))
    monkeypatch.setattr("msb.topology.crosscheck.cross_check", lambda *_: made)
    asset = ROOT / "data_stubs" / "splat_like.triasset"
    done = here("audit", "-q", "--cross-check", asset)
    assert done.status == 1
    assert f"CROSS_CHECK_DISAGREES: {asset}: igl says components is 2, we say 1" in done.err


def test_a_soup_with_a_degenerate_row_is_called_a_soup_throughout(here: Here, tmp_path: Path) -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 5], [1, 0, 5], [0, 1, 5]], np.float64)
    mesh = mesh_file(tmp_path / "a.ply", points, np.array([[0, 1, 2], [3, 4, 5], [0, 0, 1]]))
    said = here("audit", mesh).out
    assert "\ntriangle soup, 6 vertices, 3 faces" in said
    assert "Every edge is a boundary edge: that is what a triangle soup means." in said
    left = what_is_left(audit_arrays(points, [[0, 1, 2], [3, 4, 5], [0, 0, 1]])[0])
    assert left[0] == "6 boundary edges: a soup stays one, because no two of its corners coincide"
