"""Which faces are kept of made-up ones."""

from __future__ import annotations

import numpy as np

from msb.bake.choice import chosen

PIXELS = np.array([40.0, 0, 30, 20, 10])
"""That a stack of faces owns: where one is dropped, the next one behind it owns its pixels."""


def behind(keep: np.ndarray) -> np.ndarray:
    """Return the pixels of faces that lie one behind the other, the last with nothing behind it."""
    owned, waiting = np.zeros(len(keep)), 0.0
    for face, pixels in enumerate(PIXELS):
        waiting += pixels
        if keep[face]:
            owned[face], waiting = waiting, 0.0
    return owned


def test_a_face_that_owns_more_than_it_adds_goes_and_what_it_hid_stays() -> None:
    weight = np.array([0.5, 15, 30, 20, 10])
    np.testing.assert_array_equal(chosen(behind, weight, 0.25), [False, True, True, True, True])


def test_the_worst_goes_first_and_what_owns_its_pixels_then_is_counted_anew() -> None:
    """Face 0 gives its 40 pixels to face 1, which adds 5: too little for 40, if they are counted again."""
    weight = np.array([0.0, 5, 60, 20, 10])
    np.testing.assert_array_equal(chosen(behind, weight, 0.25), [False, False, True, True, True])
    np.testing.assert_array_equal(chosen(behind, weight, 0.25, rounds=1), [False, True, True, True, True])


def test_a_face_that_hides_little_once_the_worst_is_gone_stays() -> None:
    """Face 1 is below the limit at first, and is not once face 0 is gone, which is worse."""

    def owned(keep: np.ndarray) -> np.ndarray:
        return np.where(keep, [80.0, 40 if keep[0] else 10], 0)

    np.testing.assert_array_equal(chosen(owned, np.array([1.0, 6]), 0.25), [False, True])
    np.testing.assert_array_equal(chosen(owned, np.array([1.0, 6]), 0.25, rounds=1), [False, False])


def test_a_face_that_no_view_sees_stays() -> None:
    np.testing.assert_array_equal(chosen(lambda keep: np.zeros(3), np.zeros(3), 0.25), [True] * 3)
