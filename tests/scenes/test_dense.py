"""The dense part of Gaussian splats, which generated views frame."""

import numpy as np
import pytest

from msb.scenes.dense import find_dense


def ball(count: int, center: float, radius: float, seed: int) -> np.ndarray:
    """Return `count` random points in a ball around (center, 0, 0)."""
    random = np.random.default_rng(seed)
    points = random.normal(size=(count, 3))
    points *= (radius * random.random(count) ** (1 / 3) / np.linalg.norm(points, axis=1))[:, None]
    return points + np.array([center, 0, 0])


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_floaters_around_an_object_are_left_out(scale: float) -> None:
    floaters = ball(300, 0, 12, 1)
    far = np.array([[500.0, 0, 0], [0, -1e6, 0]])
    points = scale * np.concatenate([ball(4000, 0, 1, 0), floaters, far])
    weight = np.concatenate([np.full(4000, 0.8), np.full(300, 0.05), np.ones(2)])
    dense = find_dense(points, weight)
    assert dense[:4000].mean() > 0.99
    assert dense[4000:4300].sum() < 30
    assert not dense[4300:].any()


def test_two_objects_are_dense_and_a_speck_is_not() -> None:
    points = np.concatenate([ball(3000, 0, 1, 0), ball(800, 4, 0.6, 1), ball(20, -3, 0.1, 2)])
    dense = find_dense(points, np.ones(len(points)))
    assert dense[:3800].mean() > 0.99
    assert not dense[3800:].any()


@pytest.mark.parametrize("case", ["one place", "no opacity", "one point", "no point"])
def test_everything_is_dense_if_nothing_can_be_told_apart(case: str) -> None:
    points = {"one place": np.ones((5, 3)), "no opacity": ball(9, 0, 1, 0), "one point": np.zeros((1, 3))}
    chosen = points.get(case, np.zeros((0, 3)))
    assert find_dense(chosen, np.full(len(chosen), float(case != "no opacity"))).all()
