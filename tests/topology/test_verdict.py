"""The verdict for a technical artist, and the explanation of every number."""

from dataclasses import fields

import numpy as np
import pytest

from msb import audit
from msb.errors import UsageError
from msb.topology import dispatch, solids
from msb.topology.audit import Metrics
from msb.topology.explain import EXPLANATIONS, explain
from msb.topology.findings import Counts
from msb.topology.verdict import judge, percent
from tests.conftest import BOOK, TETRAHEDRON
from tests.topology.meshes import COUNT_OF, METRIC_OF, sheet
from tests.topology.seamed import CUBE

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1]], float)
TWO_TETRAHEDRA = (
    np.concatenate([TETRAHEDRON[0], TETRAHEDRON[0] + 5]),
    np.concatenate([TETRAHEDRON[1], TETRAHEDRON[1] + 4]),
)
# The vertices of the tetrahedron with one NaN vertex. Three of the four faces then have no finite area.
LOST = np.where(np.arange(4)[:, None] == 2, np.nan, TETRAHEDRON[0])
# The tetrahedron with an edge that is split on one side only. A zero-area face closes the gap.
FLAT_FACE = (
    np.vstack([TETRAHEDRON[0], [0.5, 0, 0]]),
    np.array([[0, 2, 4], [4, 2, 1], [0, 4, 1], *TETRAHEDRON[1][1:]]),
)


def exploded(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return points[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)


@pytest.mark.parametrize(
    ("mesh", "level", "number"),
    [
        ((POINTS, []), "invisible", ""),
        ((POINTS, [[0, 1, 1]]), "invisible", ""),
        ((LOST, TETRAHEDRON[1]), "invisible", "75 %"),
        ((np.full((3, 3), np.inf), [[0, 1, 2]]), "invisible", "100 %"),
        ((np.zeros((4, 3)), TETRAHEDRON[1]), "invisible", ""),
        ((np.zeros((3, 3)), [[0, 1, 2], [0, 1, 1]]), "invisible", ""),
        (FLAT_FACE, "ok", ""),
        ((POINTS[:3], [[0, 1, 2]]), "bad", "soup"),
        ((np.tile(POINTS[:3], (2, 1)), [[0, 1, 2], [3, 4, 5]]), "bad", "soup"),
        ((np.tile(POINTS[:3], (2, 1)), [[0, 1, 2], [3, 4, 5], [0, 0, 3]]), "bad", "soup"),
        (BOOK, "bad", "40 %"),
        ((POINTS, [[0, 1, 2], [2, 3, 4]]), "bad", "20 %"),
        ((POINTS, [[0, 1, 2], [1, 2, 3]]), "limited", " 1 edge"),
        ((POINTS, [[0, 1, 2], [1, 3, 2]]), "limited", "4 boundary"),
        ((POINTS, [[0, 1, 2], [2, 1, 0]]), "limited", "50 %"),
        (TETRAHEDRON, "ok", ""),
        (TWO_TETRAHEDRA, "ok", " 2 "),
        ((np.vstack([TETRAHEDRON[0], POINTS]), TETRAHEDRON[1]), "ok", " 5 "),
    ],
)
def test_verdict(mesh: tuple[np.ndarray, np.ndarray], level: str, number: str) -> None:
    verdict = judge(audit(*mesh))
    assert verdict.level == ("bad" if level == "invisible" else level)
    assert verdict.renders is (level != "invisible")
    assert number in verdict.sentence
    assert bool(verdict.reason) is (level != "ok")


def ball(count: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """Return a closed ball of 2 x count x (count - 1) faces, wound outwards."""
    rows, columns = (axis.reshape(-1) for axis in np.mgrid[1:count, :count])
    down, round_ = np.pi * rows / count, 2 * np.pi * columns / count
    points = np.stack([np.sin(down) * np.cos(round_), np.sin(down) * np.sin(round_), np.cos(down)], axis=1)
    points = np.concatenate([points, [[0, 0, 1], [0, 0, -1]]])
    number = np.arange((count - 1) * count).reshape(count - 1, count)
    a, b = number[:-1], number[1:]
    c, d = np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)
    top = np.stack([np.full(count, len(points) - 2), number[0], np.roll(number[0], -1)], axis=-1)
    low = np.stack([np.full(count, len(points) - 1), np.roll(number[-1], -1), number[-1]], axis=-1)
    sides = [np.stack(three, axis=-1).reshape(-1, 3) for three in ((a, b, c), (a, c, d))]
    return points, np.concatenate([top, *sides, low])


def test_ok_means_that_bodies_are_outwards_and_neither_touch_nor_cross() -> None:
    points, faces = ball()
    turned = faces[:, ::-1]
    both = np.concatenate([faces, faces + len(points)])
    hollow = np.concatenate([points, points / 2]), np.concatenate([faces, turned + len(points)])
    assert [audit(*mesh).verdict for mesh in ((points, faces), hollow)] == ["ok", "ok"]
    inside_out = audit(points, turned)
    crossing = audit(np.concatenate([points, points + 0.7]), both)
    cubes = np.concatenate([CUBE[0], CUBE[0] + [1, 0, 0]]), np.concatenate([CUBE[1], CUBE[1] + 8])
    touching = audit(*cubes)
    for result in (inside_out, crossing, touching):
        assert result.verdict == "limited"
        assert result.bodies is not None
    assert inside_out.bodies.inside_out == 1
    assert crossing.bodies.crossing_faces > 0
    assert touching.bodies.touching_vertices == 8
    assert audit(points, faces[1:]).bodies is None


def test_a_sheet_with_two_sides_encloses_no_volume() -> None:
    thick = audit(*TETRAHEDRON)
    thin = audit(TETRAHEDRON[0] * [1, 1, 0], TETRAHEDRON[1])
    assert (thick.bodies.flat, thin.bodies.flat, thin.verdict) == (0, 1, "limited")
    assert judge(thin).plan == "bake"


def test_one_face_that_is_not_finite_is_limited_and_located() -> None:
    points, faces = ball(40)
    points[500] = np.nan
    result = audit(points, faces)
    assert (result.counts.nonfinite_faces, result.verdict) == (6, "limited")
    assert "500" in result.sentence
    assert judge(result).renders
    assert judge(result).plan == "orient,pair,close"
    points[500:800] = np.nan
    assert audit(points, faces).verdict == "bad"


def test_vertices_that_differ_by_rounding_are_named() -> None:
    points, faces = ball(12)
    low = faces.mean(axis=1) > len(points) / 2
    apart = np.concatenate([points, points * (1 + 1e-7)])
    torn = np.where(low[:, None], faces + len(points), faces)
    result = audit(apart, torn)
    assert result.closed_once_merged
    assert (result.verdict, result.merged.weld) == ("limited", 4.8e-07)
    assert judge(result).plan == "weld:4.8e-07,orient,pair"
    assert not audit(np.concatenate([points, points * 1.001]), torn).closed_once_merged


def test_crossings_of_too_many_pairs_are_not_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solids, "MOST_PAIRS", 10)
    result = audit(*ball(12))
    assert (result.verdict, result.bodies.crossing_faces) == ("ok", None)
    assert "not checked" in result.sentence


def test_one_bad_vertex_is_limited_and_located() -> None:
    points, faces = ball()
    joined = faces + len(points)
    joined[joined == joined.max()] = 0  # a second ball shares one vertex
    result = audit(np.concatenate([points, points * [1, 1, 1] + 3]), np.concatenate([faces, joined]))
    assert (result.counts.nonmanifold_vertices, result.verdict) == (1, "limited")
    assert "vertex 0 at" in result.sentence


def test_duplicates_come_first_where_they_are_the_cause() -> None:
    points, faces = ball()
    result = audit(points, np.tile(faces, (2, 1)))
    assert result.without_duplicates is not None
    assert result.without_duplicates.nonmanifold_vertices == 0
    assert "duplicates" in judge(result).reason
    assert judge(result).plan.startswith("dedupe")


def test_verdict_of_a_soup_describes_the_welded_mesh() -> None:
    points, faces = TETRAHEDRON
    soup = exploded(points, faces)
    assert audit(*soup).closed_once_merged
    assert not audit(*exploded(points, faces[1:])).closed_once_merged
    assert "manifold, in one piece" in judge(audit(*soup, weld="exact")).sentence
    apart = soup[0] + np.repeat(np.arange(4), 3)[:, None] * 10, soup[1]
    alone = judge(audit(*apart)).sentence
    assert audit(*apart).corners_coincide is False
    assert judge(audit(*apart, weld="exact")).sentence == alone
    assert "nothing is left" in judge(audit(*apart, weld=30.0)).sentence


@pytest.mark.parametrize("fewest", [1, dispatch.FEWEST_FACES], ids=["OpenCL", "NumPy"])
def test_degenerate_rows_do_not_change_the_verdict_of_a_soup(
    monkeypatch: pytest.MonkeyPatch, fewest: int
) -> None:
    monkeypatch.setattr(dispatch, "FEWEST_FACES", fewest)
    points, faces = exploded(*sheet(3))
    apart = points + np.repeat(np.arange(len(faces)), 3)[:, None] * 10
    rows = np.vstack([faces, [[0, 0, 1], [3, 4, 3]]])
    for corners, coincide in ((apart, False), (points, True)):
        clean, with_rows = audit(corners, faces), audit(corners, rows)
        assert with_rows.computed_by.startswith("OpenCL" if fewest == 1 else "NumPy")
        assert with_rows.topology == "indexed_mesh"  # this is the definition of the key
        assert with_rows.corners_coincide is clean.corners_coincide is coincide
        assert judge(with_rows) == judge(clean)


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
def test_percent_never_rounds_to_0_or_100(part: int, whole: int, text: str) -> None:
    assert percent(part, whole) == text


KEYS = [f.name for kind in (Counts, Metrics) for f in fields(kind)]


@pytest.mark.parametrize("key", sorted(set(KEYS)))
def test_every_count_and_metric_is_explained(key: str) -> None:
    entry = explain(key)
    assert entry.name == key
    for text in (entry.title, entry.formula, entry.definition, entry.matters, entry.source):
        assert len(text) > 1
    assert "\n" not in entry.formula


@pytest.mark.parametrize(
    ("name", "key"),
    [
        *COUNT_OF.items(),
        *METRIC_OF.items(),
        ("E_max_faces", "max_edge_faces"),
        ("vf-ratio", "vf_ratio"),
        ("counts.edges", "edges"),
        ("welded.metrics.vf_ratio", "vf_ratio"),
        ("e_GT2", "nonmanifold_edges"),
        ("Lcc_Area", "lcc_area_ratio"),  # this is neither symbol, so it means the column of the paper
        ("variants.components.manifold_edges_only", "components_manifold_edges"),
        ("variants.nonmanifold_vertices.strict", "nonmanifold_vertices"),
    ],
)
def test_names_symbols_and_paths_find_their_key(name: str, key: str) -> None:
    assert explain(name).name == key


def test_every_variant_is_explained() -> None:
    for term, readings in audit(*BOOK).variants().items():
        for reading in readings:
            explain(f"variants.{term}.{reading}")


def test_explanation_names_are_unique() -> None:
    names = [n for e in EXPLANATIONS.values() for n in {e.name, e.symbol, *e.aliases} if n]
    assert len(names) == len(set(names))


def test_unknown_name_suggests_the_nearest() -> None:
    with pytest.raises(UsageError, match=r"NAME_UNKNOWN: .*edge_ratio"):
        explain("nonmanifold_edge_ration")
    for name in ("???", ""):
        with pytest.raises(UsageError, match="NAME_UNKNOWN"):
            explain(name)
