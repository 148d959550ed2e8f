"""On every mesh, peers agree or differ by definition. A wrong audit, a crash and a hang are detected."""

import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from importlib.util import find_spec
from multiprocessing import get_context
from typing import Any

import numpy as np
import pytest

import msb.topology.crosscheck as package
from data_stubs.splat_like import splat_like
from msb.base import extras
from msb.errors import MeshError, UsageError
from msb.meshes import read_mesh
from msb.topology import audit_arrays
from msb.topology.crosscheck import PEERS, Comparison, CrossCheck, compare, cross_check
from msb.topology.crosscheck.expected import Facts
from msb.topology.crosscheck.peers import Answers, ask, ask_peers
from msb.topology.explain import explain
from tests.conftest import BOOK, TETRAHEDRON
from tests.topology.meshes import CASE, CASES, GOLDEN, random_mesh

WITH_FACES = [c for c in CASES if c.valid and len(c.faces)]
Forked = Callable[..., dict[str, Answers | str]]
# Two peers are excluded: PyMeshLab is correct in a fresh process only, and manifold3d may crash.
IN_PROCESS = ("libigl", "trimesh", "NetworkX", "NVIDIA")


def need(*names: str) -> None:
    for name in names:
        if find_spec(PEERS[name].module) is None:
            pytest.skip(f"{name} is not installed (extra crosscheck)")


def check_in_process(peer: str, points: np.ndarray, faces: np.ndarray) -> list[Comparison]:
    report, analysis = audit_arrays(points, faces)
    with np.errstate(all="ignore"):  # trimesh calculates with infinite coordinates
        answers = PEERS[peer].ask(np.asarray(points, np.float64), faces.astype(np.int64))
    return compare(peer, answers, Facts(report, analysis))[0]


def check(points: Any, faces: Any, **options: Any) -> CrossCheck:
    return cross_check(points, faces, *audit_arrays(points, faces), **options)


def row_of(result: CrossCheck | list[Comparison], peer: str, quantity: str) -> Comparison:
    rows = result.rows if isinstance(result, CrossCheck) else result
    return next(r for r in rows if (r.peer, r.quantity) == (peer, quantity))


def assert_explained(rows: Any) -> None:
    """Assert that no row disagrees and every difference has a reason."""
    assert [r for r in rows if r.verdict == "disagrees"] == []
    for row in rows:
        assert (row.verdict == "agrees") == (row.why == "")


@pytest.fixture(scope="module")
def forked() -> Iterator[Forked]:
    """Return a faster `ask_peers`.

    Its processes are forked from a server that has already imported the peers.
    """
    context = get_context("forkserver")
    modules = [peer.module for peer in PEERS.values() if find_spec(peer.module)]
    context.set_forkserver_preload(["msb.topology.crosscheck", *modules])
    with ProcessPoolExecutor(1, context, max_tasks_per_child=1) as pool:

        def ask_forked(
            names: Sequence[str], vertices: Any, faces: Any, timeout: float = 60
        ) -> dict[str, Answers | str]:
            mesh = {"vertices": np.asarray(vertices, np.float64), "faces": faces.astype(np.int64)}
            return {name: pool.submit(ask, name, mesh).result(timeout)[0] for name in names}

        yield ask_forked


# --- the peers themselves


@pytest.mark.slow
@pytest.mark.oracle
@pytest.mark.parametrize("peer", IN_PROCESS)
def test_peer_is_explained_on_hand_made_and_random_meshes(peer: str) -> None:
    need(peer)
    random = np.random.default_rng(31)
    verdicts = set()
    for points, faces in [
        *((c.vertices, c.faces) for c in WITH_FACES),
        *(random_mesh(random) for _ in range(150)),
    ]:
        if len(faces):
            rows = check_in_process(peer, points, faces)
            assert_explained(rows)
            verdicts |= {r.verdict for r in rows}
    assert verdicts == ({"agrees"} if peer == "NetworkX" else {"agrees", "differs_by_definition"})


# Cases in which the peers differ. Each runs in a separate process.
CHILD_CASES = [
    "single_triangle", "closed_tetrahedron", "two_triangles_sharing_vertex",
    "tetrahedra_sharing_vertex", "tetrahedra_sharing_edge", "tetrahedra_sharing_face",
    "three_page_book", "moebius_5", "projective_plane_6", "duplicate_face_same_winding",
    "duplicate_face_flipped", "triplicate_face", "repeated_index_only", "all_three_equal",
    "repeated_index_beside_triangle", "unreferenced_vertex", "cone_over_theta",
    "book_with_detached_triangle_at_spine", "nan_vertex",
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.oracle
@pytest.mark.parametrize("name", CHILD_CASES)
def test_pymeshlab_and_manifold3d_are_explained_in_child_processes(name: str, forked: Forked) -> None:
    need("PyMeshLab", "manifold3d")
    case = CASE[name]
    replies = forked(["PyMeshLab", "manifold3d"], case.vertices, case.faces)
    facts = Facts(*audit_arrays(case.vertices, case.faces))
    for peer, answers in replies.items():
        assert isinstance(answers, dict), (peer, answers)
        assert_explained(compare(peer, answers, facts)[0])


@pytest.mark.slow
@pytest.mark.oracle
@pytest.mark.parametrize("file", ["synthetic_splat_small.ply", "synthetic_splat_medium.ply"])
def test_all_peers_are_explained_on_a_synthetic_splat_mesh(
    file: str, forked: Forked, monkeypatch: pytest.MonkeyPatch
) -> None:
    need(*PEERS)
    if "small" in file:
        monkeypatch.setattr(package, "ask_peers", forked)
    mesh = read_mesh(GOLDEN / file)
    result = check(mesh.vertices, mesh.faces)
    assert_explained(result.rows)
    assert {r.peer for r in result.rows} | set(result.skipped) >= set(PEERS)
    assert {"libigl", "PyMeshLab", "trimesh", "NetworkX"} <= {r.peer for r in result.rows}
    strict = [r for r in result.rows if r.quantity == "nonmanifold_vertices" and r.verdict == "agrees"]
    assert {r.peer for r in strict} == {"libigl", "PyMeshLab", "NetworkX", "NVIDIA"}


@pytest.mark.oracle
def test_areas_agree_for_large_coordinates_slivers_and_offsets() -> None:
    need("libigl", "trimesh")
    points, faces = splat_like(10)
    for moved in (points * 1e6 + 1e9, points * [1, 1e-9, 1e-9], points.astype(float) * 1e-20):
        for peer in ("libigl", "trimesh"):
            assert row_of(check_in_process(peer, moved, faces), peer, "total_area").verdict == "agrees"


@pytest.mark.slow
@pytest.mark.oracle
def test_all_peers_agree_on_a_closed_mesh() -> None:
    need(*PEERS)
    result = check(*TETRAHEDRON)
    assert {r.peer for r in result.rows} == set(PEERS)
    assert {r.verdict for r in result.rows} == {"agrees"}
    assert result.skipped == {}
    for row in json.loads(json.dumps(result.to_rows(), allow_nan=False)):
        assert set(row) >= {"peer", "version", "quantity", "ours", "theirs", "verdict", "why"}
        assert row["version"][0].isdigit()
        explain(row["quantity"])


@pytest.mark.slow
@pytest.mark.oracle
def test_book_differs_only_in_the_edge_endpoints_of_pymeshlab(capfd: pytest.CaptureFixture[str]) -> None:
    need(*PEERS)
    result = check(*BOOK)
    assert capfd.readouterr() == ("", "")  # peers do not write to our streams
    differing = [r for r in result.rows if r.verdict != "agrees"]
    assert [(r.peer, r.quantity, r.ours, r.theirs) for r in differing] == [
        ("PyMeshLab", "nonmanifold_vertices", 2, 0)
    ]
    assert differing[0].why
    assert "libigl boundary_loops" in result.skipped


# --- a wrong audit


NOT_COMPARED = {
    # Numbers that follow from others by identities, or that no peer has for non-manifold meshes.
    "repeated_index_faces", "zero_area_faces", "nonfinite_faces", "duplicate_faces",
    "inconsistent_winding_edges", "boundary_loops", "open_boundary_chains",
    "seam_vertices",  # peers compare only positions
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("more", "off"),
    # With repeated-index rows, correct answers differ by a few, which could hide a mistake of the same size.
    [([], 1), ([], -1), ([[0, 1, 1], [5, 5, 5]], 100)],
    ids=["one too many", "one too few", "definitions differ too"],
)
def test_wrong_count_disagrees_with_some_peer(more: list[list[int]], off: int, forked: Forked) -> None:
    need(*PEERS)
    points, faces = splat_like(8)
    faces = np.concatenate([faces, np.array(more, np.int32).reshape(-1, 3)])
    report, analysis = audit_arrays(points, faces)
    replies = forked(["PyMeshLab"], points, faces)
    for peer in IN_PROCESS:
        replies[peer] = PEERS[peer].ask(points.astype(float), faces.astype(np.int64))
    for key, right in vars(report.counts).items():
        wrong = replace(report, counts=replace(report.counts, **{key: right + off}))
        rows: list[Comparison] = []
        for peer, answers in replies.items():
            rows += compare(peer, answers, Facts(wrong, analysis))[0]
        disagreeing = {r.quantity for r in rows if r.verdict == "disagrees"}
        assert (key in disagreeing) == (key not in NOT_COMPARED), key


@pytest.mark.oracle
def test_wrong_loops_winding_and_areas_disagree_on_a_manifold_mesh() -> None:
    need("libigl", "trimesh")
    case = CASE["two_triangles_sharing_edge"]
    report, analysis = audit_arrays(case.vertices, case.faces)
    wrong = replace(
        report,
        counts=replace(report.counts, boundary_loops=2, inconsistent_winding_edges=1),
        metrics=replace(report.metrics, total_area=report.metrics.total_area * (1 + 1e-6)),
    )
    disagreeing = set()
    for peer in ("libigl", "trimesh"):
        answers = PEERS[peer].ask(case.vertices, case.faces)
        rows, _ = compare(peer, answers, Facts(wrong, analysis))
        disagreeing |= {r.quantity for r in rows if r.verdict == "disagrees"}
    assert disagreeing == {"boundary_loops", "winding_consistent", "total_area"}


# --- choice of peers


@pytest.mark.slow
def test_missing_peer_is_skipped_with_an_installation_hint(monkeypatch: pytest.MonkeyPatch) -> None:
    present, here = find_spec, {"trimesh", "networkx", "manifold3d"}
    monkeypatch.setattr(extras, "find_spec", lambda name: present(name) if name in here else None)
    result = check(*TETRAHEDRON)
    assert {r.peer for r in result.rows} == {"trimesh", "NetworkX", "manifold3d"}
    assert set(result.skipped) == {"libigl", "PyMeshLab", "NVIDIA"}
    assert all("[crosscheck]" in why for why in result.skipped.values())


@pytest.mark.parametrize("here", [set(), {"networkx"}], ids=["none", "bench"])
def test_missing_extra_is_a_usage_error(monkeypatch: pytest.MonkeyPatch, here: set[str]) -> None:
    present = find_spec
    monkeypatch.setattr(extras, "find_spec", lambda name: present(name) if name in here else None)
    with pytest.raises(UsageError, match=r"EXTRA_MISSING: .*\[crosscheck\]"):
        check(*BOOK)


@pytest.mark.parametrize("name", ["empty", "points_only"])
def test_mesh_without_faces_is_given_to_no_peer(name: str) -> None:
    result = check(CASE[name].vertices, CASE[name].faces)
    assert result.rows == ()
    assert set(result.skipped) == set(PEERS)


@pytest.mark.slow
def test_failing_or_hanging_peer_is_skipped_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    need("trimesh", "NetworkX")
    monkeypatch.setattr(package, "PATIENCE", 0.001)
    skipped = check(*BOOK).skipped
    assert all("0.001 s" in why for peer, why in skipped.items() if find_spec(PEERS[peer].module))
    result = ask_peers(["trimesh", "NetworkX"], np.zeros((1, 3)), BOOK[1], timeout=60)
    assert "index" in str(result["trimesh"])
    assert isinstance(result["NetworkX"], dict)


def test_invalid_index_is_an_error_before_any_peer_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(package, "ask_peers", None)
    report, analysis = audit_arrays(*BOOK)
    with pytest.raises(MeshError, match="INDEX_OUT_OF_RANGE"):
        cross_check(BOOK[0], [[0, 1, 99]], report, analysis)
