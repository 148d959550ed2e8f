"""Culling by masks compared with the reference script, and rejected inputs."""

from typing import Any

import numpy as np
import pytest

from msb import metrics
from msb.errors import MetricError
from tests.metrics.conftest import GOLDEN, golden

DATA = np.load(GOLDEN / "dtu_cull" / "cull.npz")
WORLD = [DATA[f"world_mat_{i}"] for i in range(4)]
SCALE = [DATA[f"scale_mat_{i}"] for i in range(4)]


def test_golden() -> None:
    about = golden("dtu_cull/cull.json")
    result = metrics.cull_dtu(DATA["vertices"], DATA["faces"], WORLD, SCALE, DATA["masks"])
    wrong = np.count_nonzero(result.kept != DATA["vertex_keep"])
    assert wrong <= about["tolerance"]["vertex_keep_mismatches_max"]
    assert wrong == 0
    assert np.abs(result.vertices - DATA["out_vertices"]).max() < about["tolerance"]["out_vertices_abs"]
    assert np.array_equal(result.faces, DATA["out_faces"])


def camera(sign: float = 1.0) -> np.ndarray[Any, Any]:
    """Return a camera at the origin that looks along z; (0, 0, 1) is at pixel (20, 15) of 41 x 31."""
    matrix = np.eye(4)
    matrix[:3, :3] = [[10, 0, 20], [0, 10, 15], [0, 0, 1]]
    return matrix * sign


POINTS = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [9, 0, 1], [0, 0, -1]], float)
FACES = np.array([[0, 1, 2], [0, 3, 4], [0, 3, 0]])


@pytest.mark.parametrize("factor", [1.0, -1.0, 7.0])
def test_views_keep_vertices_inside_the_dilated_mask(factor: float) -> None:
    mask = np.zeros((31, 41, 3), np.uint8)
    mask[15, 20, 0] = 1
    scale = np.diag([2.0, 2, 2, 1])
    scale[:3, 3] = 1, 2, 3
    for radius, kept in ((0, [1, 0, 0, 1, 1]), (10, [1, 1, 1, 1, 1]), (9.9, [1, 0, 0, 1, 1])):
        # The scale has no effect on the projection: the matrix undoes it.
        world = camera(factor) @ np.linalg.inv(scale)  # noqa: TID251
        result = metrics.cull_dtu(POINTS, FACES, [world], [scale], [mask], dilation=radius)
        assert result.kept.tolist() == [bool(value) for value in kept]
        assert np.allclose(result.vertices, POINTS[result.kept] * 2 + (1, 2, 3))
    assert result.faces.tolist() == [[0, 1, 2], [0, 1, 0]]


def test_empty_mask_keeps_only_vertices_outside_the_image() -> None:
    result = metrics.cull_dtu(POINTS, FACES, [camera()], [np.eye(4)], [np.zeros((31, 41))])
    assert result.kept.tolist() == [False, False, False, True, False]
    assert result.faces.shape == (0, 3)


@pytest.mark.parametrize(
    ("world", "scale", "masks"),
    [
        ([], [], []),
        ([np.eye(4)], [np.eye(4)], [np.ones((4, 4))] * 2),
        ([np.eye(3)], [np.eye(4)], [np.ones((4, 4))]),
        ([np.zeros((4, 4))], [np.eye(4)], [np.ones((4, 4))]),
        ([np.eye(4)], [np.eye(4)], [np.ones(4)]),
        ([np.eye(4)], [np.eye(4)], [np.ones((1, 4))]),
    ],
)
def test_invalid_views_are_rejected(world: Any, scale: Any, masks: Any) -> None:
    with pytest.raises(MetricError, match="METRIC_DTU"):
        metrics.cull_dtu(POINTS, FACES, world, scale, masks)
