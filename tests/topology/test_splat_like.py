"""The generator of MeshSplatting-like meshes: deterministic, valid, and with the structure it should have."""

from __future__ import annotations

import numpy as np
import pytest

from data_stubs.splat_like import Shape, splat_like
from msb import audit


def test_same_seed_gives_the_same_mesh_and_another_seed_another() -> None:
    (a, f), (b, g), (c, _) = splat_like(12), splat_like(12), splat_like(12, seed=1)
    np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(f, g)
    assert a.shape != c.shape or not np.array_equal(a, c)


def test_default_has_the_structure_it_was_made_for() -> None:
    report = audit(*splat_like(36))
    c, m = report.counts, report.metrics
    assert c.repeated_index_faces == c.duplicate_faces == c.zero_area_faces == 0
    # Seeds differ by about 1 % in F and 0.005 in the ratios.
    assert c.faces == pytest.approx(35_231, rel=0.02)
    assert c.components == pytest.approx(5_767, rel=0.04)
    expected = {
        "vf_ratio": 0.513,
        "boundary_edge_ratio": 0.470,
        "nonmanifold_edge_ratio": 0.179,
        "nonmanifold_vertex_ratio": 0.734,
        "lcc_face_ratio": 0.726,
    }
    for key, value in expected.items():
        assert getattr(m, key) == pytest.approx(value, abs=0.015), key
    assert m.mean_valence == pytest.approx(6.46, abs=0.06)
    assert c.multifan_vertices / c.vertices == pytest.approx(0.511, abs=0.02)


def test_without_noise_drops_and_strays_it_is_a_closed_manifold_sphere() -> None:
    report = audit(*splat_like(20, shape=Shape(noise=0.0, drop=0.0, stray=0.0)))
    c = report.counts
    assert (c.boundary_edges, c.components, report.metrics.euler_characteristic) == (0, 1, 2)
    assert c.nonmanifold_vertices == 0
