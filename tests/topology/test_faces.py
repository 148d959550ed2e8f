"""Faces one by one: areas, zero areas, non-finite ones, duplicates."""

from __future__ import annotations

import numpy as np
import pytest

from msb.topology.faces import extra_duplicates, face_areas

RIGHT = np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0], [6, 0, 0]])


def test_area_is_half_the_cross_product_in_double_precision() -> None:
    area, finite = face_areas(RIGHT.astype(np.float32), np.array([[0, 1, 2], [2, 1, 0]]))
    assert area.dtype == np.float64
    assert area.tolist() == [6.0, 6.0]
    assert finite.all()


def test_area_is_the_same_whichever_way_the_faces_are_cut_into_chunks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    random = np.random.default_rng(0)
    points, faces = random.random((50, 3)), random.integers(0, 50, (1000, 3))
    whole, _ = face_areas(points, faces)
    monkeypatch.setattr("msb.topology.faces._CHUNK", 7)
    pieces, _ = face_areas(points, faces)
    np.testing.assert_array_equal(whole, pieces)


def test_double_precision_matters_far_from_the_origin() -> None:
    points = (RIGHT + 1e6).astype(np.float32)  # whole numbers below 2^24: exact in float32
    area, _ = face_areas(points, np.array([[0, 1, 2]]))
    assert area.tolist() == [6.0]


def test_collinear_and_repeated_faces_have_area_exactly_zero() -> None:
    area, finite = face_areas(RIGHT, np.array([[0, 1, 3], [1, 2, 2], [2, 1, 2], [3, 3, 3]]))
    assert area.tolist() == [0.0] * 4
    assert finite.all()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200])
def test_face_whose_area_is_not_finite_counts_as_zero(value: float) -> None:
    points = RIGHT.copy()
    points[1] = value
    area, finite = face_areas(points, np.array([[0, 1, 2], [0, 2, 3]]))
    assert area.tolist() == [0.0, 12.0]
    assert finite.tolist() == [False, True]


def test_duplicates_are_the_rows_after_the_first_in_any_order_and_winding() -> None:
    faces = np.array([[0, 1, 2], [3, 1, 2], [2, 1, 0], [1, 2, 0], [2, 3, 1], [0, 1, 3]])
    assert extra_duplicates(faces).tolist() == [False, False, True, True, True, False]


def test_collapsed_rows_are_duplicates_when_all_three_indices_agree() -> None:
    faces = np.array([[0, 1, 1], [1, 0, 1], [0, 0, 1], [1, 1, 1], [1, 1, 1]])
    assert extra_duplicates(faces).tolist() == [False, True, False, False, True]


def test_duplicates_are_found_at_the_top_of_the_integer_range() -> None:
    top = 2**31 - 1  # the sum of a row wraps around
    faces = np.array([[top, top - 1, top - 2], [top - 2, top, top - 1], [top, top - 1, top - 3]], np.int32)
    assert extra_duplicates(faces).tolist() == [False, True, False]


def test_no_faces_have_no_areas_and_no_duplicates() -> None:
    none = np.zeros((0, 3), np.int32)
    assert face_areas(np.zeros((0, 3)), none)[0].shape == (0,)
    assert extra_duplicates(none).shape == (0,)
