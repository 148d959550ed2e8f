"""What trainings start from."""

from __future__ import annotations

import numpy as np

import msb
from data_stubs.training.mesh import surface_like
from data_stubs.training.start import spread_out


def sphere(count: int) -> np.ndarray:
    """Points of a Fibonacci sphere, each in an area of the same size."""
    turn = np.pi * (1 + 5**0.5) * np.arange(count)
    height = 1 - (2 * np.arange(count) + 1) / count
    flat = np.sqrt(1 - height**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)


def test_points_of_a_sphere_are_joined_to_a_closed_surface() -> None:
    points = sphere(400)
    faces = surface_like(points, 100_000)
    audit = msb.audit(points, faces)
    assert audit.counts.components == 1
    assert audit.counts.boundary_edges == 0
    assert len(faces) <= 2 * len(points)  # Euler: 796 if nothing is doubled


def test_the_shortest_faces_are_taken_first() -> None:
    points = sphere(400)
    edges = [np.linalg.norm(points[f] - points[np.roll(f, 1, axis=1)], axis=2).max() for f in
             (surface_like(points, 300), surface_like(points, 100_000))]  # fmt: skip
    assert edges[0] < edges[1]
    assert len(surface_like(points, 300)) == 300


def test_points_are_spread_out_in_units_of_their_spacing() -> None:
    random = np.random.default_rng(0)
    points = np.concatenate([random.uniform(0, 1, (900, 3)), random.uniform(2, 3, (100, 3))])
    spacing = np.r_[np.full(900, 1.0), np.full(100, 0.1)].astype(np.float32)
    chosen = spread_out(points, spacing, 60, np.random.default_rng(1))
    assert len(set(chosen.tolist())) == 60
    assert (chosen >= 900).sum() > 40  # a tenth of the spacing: finer there, though there are fewer
    all_ = spread_out(points, spacing, 5000, np.random.default_rng(1))
    np.testing.assert_array_equal(all_, np.arange(1000))
