"""Inputs that `audit` accepts and rejects, and the format of its report."""

import json
import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from msb import Audit, audit
from msb.asset import build_asset
from msb.errors import MeshError
from msb.meshes import Mesh, write_mesh
from msb.topology.audit import Metrics
from msb.topology.findings import Counts
from tests.conftest import BOOK, TETRAHEDRON
from tests.topology.meshes import CASE, CASES, random_mesh

POINTS, FACES = TETRAHEDRON
BOTH = audit(POINTS, FACES)


def same(first: Audit, second: Audit) -> bool:
    return (
        first.counts == second.counts and first.metrics == second.metrics and first.samples == second.samples
    )


# --- accepted


@pytest.mark.parametrize("integers", ["i1", "u1", "<i2", ">i4", "i4", "u4", "i8", "u8"])
@pytest.mark.parametrize("reals", ["f2", "<f4", ">f4", "f8", ">f8", "longdouble", "i2", "u8"])
def test_arrays_of_any_number_type_give_the_same_audit(reals: str, integers: str) -> None:
    assert same(audit(POINTS.astype(reals), FACES.astype(integers)), BOTH)


def test_lists_tuples_views_and_fortran_order_give_the_same_audit() -> None:
    wide = np.zeros((8, 6))
    wide[::2, ::2] = POINTS
    for points, faces in [
        (POINTS.tolist(), FACES.tolist()),
        (tuple(map(tuple, POINTS.tolist())), tuple(map(tuple, FACES.tolist()))),
        (wide[::2, ::2], np.repeat(FACES, 2, axis=0)[::2]),
        (np.asfortranarray(POINTS), np.asfortranarray(FACES)),
        (np.ma.array(POINTS), np.ma.array(FACES)),  # no element is masked
    ]:
        assert same(audit(points, faces), BOTH)


class Triangles:
    """A mesh of another library, with the attributes that it shares with a trimesh."""

    def __init__(self, vertices: object, faces: object) -> None:
        self.vertices, self.faces = vertices, faces


def test_pairs_and_meshes_give_the_audit_of_their_arrays() -> None:
    mesh = Mesh(POINTS.astype(np.float64), FACES.astype(np.int64))
    for given in ((POINTS, FACES), [POINTS.tolist(), FACES.tolist()], mesh, Triangles(POINTS, FACES)):
        assert same(audit(given), BOTH)
    assert audit(mesh, weld="exact").welded is not None
    for wrong in (Triangles, (POINTS,), (POINTS, FACES, FACES), POINTS, (1, 2)):
        with pytest.raises(MeshError, match="MESH_ARRAY"):
            audit(wrong)  # type: ignore[arg-type]


def test_a_mesh_is_audited_with_its_seams_like_its_file(tmp_path: Path) -> None:
    # A sheet of two faces, cut along its diagonal because the colours differ there.
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
    colors = np.repeat(np.array([[255, 0, 0], [0, 0, 255]], np.uint8), 3, axis=0)
    mesh = Mesh(points, np.arange(6).reshape(2, 3), vertex_colors=colors)
    write_mesh(mesh, tmp_path / "sheet.ply", suffix=".ply")
    assert audit(mesh).counts == audit(tmp_path / "sheet.ply").counts
    assert audit(mesh).counts.seam_vertices == 2


@pytest.mark.oracle
@pytest.mark.parametrize("shape", ["Cube", "Sphere", "Plane"])
def test_pyvista_and_trimesh_meshes_are_audited(shape: str) -> None:
    pyvista, trimesh = pytest.importorskip("pyvista"), pytest.importorskip("trimesh")
    made = getattr(pyvista, shape)()
    triangles = made.triangulate()
    faces = triangles.faces.reshape(-1, 4)[:, 1:]
    expected = audit(triangles.points, faces)
    assert same(audit(made), expected)
    assert same(audit(trimesh.Trimesh(triangles.points, faces, process=False)), expected)


def test_read_only_arrays_are_accepted() -> None:
    points, faces = POINTS.copy(), FACES.astype(np.int32)
    points.flags.writeable = faces.flags.writeable = False
    assert same(audit(points, faces, weld="exact"), BOTH)


@pytest.mark.parametrize("none", [[], [[]], np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3), "u1")])
def test_empty_input_is_a_mesh_without_elements(none: object) -> None:
    report = audit(none, none, weld="exact")
    assert set(vars(report.counts).values()) == {0}
    assert report.metrics.vf_ratio is None
    assert report.metrics.mean_valence is None
    assert not report.is_soup
    assert report.valence_histogram == {}


def test_printed_audit_has_its_verdict_and_escapes_names() -> None:
    report = replace(audit(*BOOK), path="<script>\n.ply", method="two_dts")
    assert report.sentence in str(report)
    assert "<script>\\n.ply" in str(report).splitlines()[0]
    page = report._repr_html_()
    assert "<script>" not in page
    assert "&lt;script&gt;" in page


def test_asset_is_audited_with_its_path_and_method() -> None:
    built = build_asset({"positions": np.float32(POINTS), "indices": FACES.astype(np.uint32)}, {})
    asset = replace(built, path=Path("a/b.triasset"))
    report = audit(asset)
    assert (report.path, report.method) == ("a/b.triasset", "mesh")
    assert report.counts == BOTH.counts


# --- rejected


class _NoArray:
    def __array__(self, *_: object, **__: object) -> None:
        raise ValueError("it lies on another device")


INVALID_FACES = [
    None,
    np.zeros((2, 4), int),
    "text",
    [[0, 1, 2.0]],
    [[True, False, True]],
    [[0, 1, 2**70]],
    [[0, 1, 2], [0, 1]],
    _NoArray(),
    np.zeros((1, 3), [("x", "i4")]),
    np.ma.array([[0, 1, 2]], mask=[[0, 0, 1]]),
]
INVALID_POINTS = [
    np.zeros((4, 2)),
    POINTS + 0j,
    np.zeros(4, [("x", "f4"), ("y", "f4"), ("z", "f4")]),
    np.ma.masked_greater(POINTS, 0.5),
    POINTS.astype(object),
    [[0, 0, 0], [1, 2]],
]


@pytest.mark.parametrize(
    ("points", "faces"),
    [*((POINTS, faces) for faces in INVALID_FACES), *((points, FACES) for points in INVALID_POINTS)],
)
def test_arrays_that_are_not_a_mesh_are_rejected(points: object, faces: object) -> None:
    with pytest.raises(MeshError, match="MESH_ARRAY"):
        audit(points, faces)


@pytest.mark.parametrize(
    ("bad", "dtype"),
    [
        (4, "i4"),
        (-1, "i4"),
        (2**63 - 1, "i8"),
        (2**64 - 1, "u8"),
        (2**32, "i8"),  # an overflow to 32 bits would give vertex 0
    ],
)
def test_index_out_of_range_names_the_first_face_and_is_never_wrapped(bad: int, dtype: str) -> None:
    faces = np.array([[0, 1, 2], [1, 2, 3], [2, 3, bad], [bad, 0, 1]], dtype)
    with pytest.raises(MeshError, match=f"INDEX_OUT_OF_RANGE: .*{bad}") as caught:
        audit(POINTS, faces)
    assert caught.value.pointer == "faces[2]"


def test_too_many_faces_or_vertices_are_rejected_before_allocation() -> None:
    row = np.zeros((1, 3), np.int32)
    with pytest.raises(MeshError, match=r"MESH_ARRAY: .*715827882"):
        audit(POINTS, np.broadcast_to(row, (715_827_883, 3)))
    with pytest.raises(MeshError, match=r"MESH_ARRAY: .*4294967295"):
        audit(np.broadcast_to(row.astype(np.float32), (2**32, 3)), FACES)


# --- the report


def test_json_has_every_field_in_its_place() -> None:
    data = audit(*BOOK, weld=0.5).to_dict()
    assert data["schema"] == "msb.audit/1"
    assert list(data["counts"]) == [f.name for f in fields(Counts)]
    assert list(data["metrics"]) == [f.name for f in fields(Metrics)]
    assert data["welded"]["weld"] == 0.5
    assert list(data["welded"]["counts"]) == list(data["counts"])
    assert list(data["welded"]["metrics"]) == list(data["metrics"])
    assert (data["path"], data["method"], data["cross_check"]) == (None, None, None)
    assert data["variants"]["nonmanifold_vertices"] == {
        "strict": 2, "multifan": 0, "edge_endpoints": 2, "off_nonmanifold_edges": 0,
    }  # fmt: skip
    assert data["variants"]["components"] == {"all_shared_edges": 1, "manifold_edges_only": 3}
    assert all(isinstance(ms, float) for ms in data["timings_ms"].values())


@pytest.mark.slow
def test_json_is_strict_for_every_mesh() -> None:
    random = np.random.default_rng(4)
    meshes = [(c.vertices, c.faces) for c in CASES if c.valid]
    meshes += [random_mesh(random) for _ in range(100)]
    meshes += [(np.full((3, 3), x), np.array([[0, 1, 2]])) for x in (np.nan, np.inf, 1e300, 1e-300)]
    for points, faces in meshes:
        text = json.dumps(audit(points, faces, weld="exact").to_dict(), allow_nan=False)
        assert json.loads(text)["counts"]["faces"] == len(faces)


def test_samples_name_elements_vertices_and_coordinates() -> None:
    samples = audit(*BOOK).samples
    (edge,) = samples["nonmanifold_edges"]
    assert edge.vertices == (0, 1)
    assert edge.coordinates == ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    assert [s.element for s in samples["nonmanifold_vertices"]] == [0, 1]
    assert len(samples["boundary_edges"]) == 3  # of six edges
    assert samples["zero_area_faces"] == ()


def test_samples_keep_the_stored_precision_and_turn_nan_into_null() -> None:
    case = CASE["nan_vertex"]
    report = audit(case.vertices, case.faces)
    (face,) = report.samples["nonfinite_faces"]
    assert math.isnan(face.coordinates[2][0])
    data = report.to_dict()["samples"]["nonfinite_faces"]
    assert data == [
        {"element": 1, "vertices": [0, 2, 3], "coordinates": [[0, 0, 0], [1, 1, 0], [None, 1, 0]]}
    ]
    tenth = np.array([[0.1, 0, 0]], np.float32)
    assert audit(tenth, []).samples["unreferenced_vertices"][0].coordinates[0][0] == float(np.float32(0.1))
