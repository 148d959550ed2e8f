"""What vertices, faces and corners hold goes where they go."""

import numpy as np
import pytest

from msb.errors import Unsupported
from msb.repair.carry import carry, turned_lattice
from msb.topology.steps import Change, orient
from msb.topology.steps.change import Rims, unchanged

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], np.float32)
FACES = np.array([[0, 1, 2], [1, 2, 3]], np.uint32)  # both run along 1-2 in one direction
RNG = np.random.default_rng(0)
BASE = {"positions": POINTS, "indices": FACES}


def turned() -> Change:
    change = orient(FACES.astype(np.int32), 4)
    assert change.turned.tolist() == [False, True]
    return change


def with_cap() -> Change:
    """Return a change that adds a vertex in the middle of three, and a face with it beside the second."""
    faces = np.array([[0, 1, 2], [1, 2, 3], [1, 0, 4]])
    rims = Rims(np.array([0, 3]), np.array([0, 1, 2]))
    return Change(
        faces, np.array([0, 1, 2, 3, -1]), np.array([0, 1, -1]), np.zeros(3, bool), rims, np.array([1])
    )


def test_values_of_corners_turn_with_the_face() -> None:
    color = RNG.random((6, 3), np.float32)
    done = carry({**BASE, "color": color}, {"color": "corner"}, turned())
    assert np.array_equal(done["color"], color[[0, 1, 2, 3, 5, 4]])
    assert done["indices"].dtype == np.uint32
    assert np.array_equal(done["positions"][done["indices"][1]], POINTS[[1, 3, 2]])


@pytest.mark.parametrize("level", [0, 1, 3])
def test_a_lattice_turns_with_the_face(level: int) -> None:
    sides = 2**level
    s, y = np.tril_indices(sides + 1)
    weights = np.stack([s - y, y, sides - s], axis=1) / sides  # of the three corners
    value = np.float32([3.0, 5.0, 11.0])
    # A linear function of the place: after the turn, corners hold the values in their new order.
    before = np.stack([weights @ value, weights @ value]).astype(np.float32)
    done = carry({**BASE, "features.opacity": before}, {"features.opacity": "face"}, turned(), level)
    assert np.array_equal(done["features.opacity"][0], before[0])
    np.testing.assert_allclose(done["features.opacity"][1], weights @ value[[0, 2, 1]], rtol=1e-6)
    assert np.array_equal(turned_lattice(sides)[turned_lattice(sides)], np.arange(len(s)))


def test_a_new_vertex_has_the_mean_of_its_rim_and_a_new_face_the_values_beside_it() -> None:
    buffers = {
        **BASE,
        "color": np.array([[0, 0, 0], [10, 0, 0], [0, 100, 0], [9, 9, 9]], np.uint8),
        "opacity": np.array([1, 2, np.inf, 0], np.float32),
        "sigma": np.array([5, 7], np.float32),
    }
    done = carry(buffers, {"color": "vertex", "opacity": "vertex", "sigma": "face"}, with_cap())
    np.testing.assert_allclose(done["positions"][4], [1 / 3, 1 / 3, 0], rtol=1e-6)
    assert done["color"][4].tolist() == [3, 33, 0]
    assert done["opacity"].tolist() == [1, 2, np.inf, 0, 1]  # a mean with infinity says nothing
    assert done["sigma"].tolist() == [5, 7, 7]


@pytest.mark.parametrize(
    ("name", "domain", "values", "change"),
    [
        ("of_the_method", "face", np.zeros((2, 4), np.float32), turned()),
        ("features.lattice", "face", np.zeros((2, 4, 7), np.float32), turned()),  # no level has 4 samples
        ("of_the_method", "face", np.zeros((2, 4), np.float32), with_cap()),
        ("of_the_method", "corner", np.zeros((6, 3), np.float32), with_cap()),
        ("of_the_method", "vertex", np.zeros(4, np.uint32), with_cap()),
    ],
)
def test_what_cannot_be_carried_is_an_error_that_names_it(
    name: str, domain: str, values: np.ndarray, change: Change
) -> None:
    with pytest.raises(Unsupported, match=name) as found:
        carry({**BASE, name: values}, {name: domain}, change, 1)
    assert found.value.code == "UNSUPPORTED_REPAIR"


def test_what_does_not_turn_is_carried_whatever_it_means() -> None:
    strange = np.zeros((2, 4), np.float32)
    same = unchanged(FACES.astype(np.int32), 4)
    assert np.array_equal(carry({**BASE, "odd": strange}, {"odd": "face"}, same)["odd"], strange)
