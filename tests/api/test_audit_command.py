"""`msb audit`: exit status, streams, files and JSON. Its text is in tests/snapshots."""

import csv
import io
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import msb as library
from msb.api.gates import PROFILES, parse_gate
from msb.asset import build_asset
from tests.cli.conftest import Here, here, mesh_file
from tests.conftest import BOOK, ROOT, TETRAHEDRON
from tests.topology.test_verdict import ball

__all__ = ["here"]

RING = ROOT / "tests" / "golden" / "two_dts" / "ring_solid" / "checkpoint"
COUNT_KEYS = {
    "vertices", "referenced_vertices", "unreferenced_vertices", "faces", "repeated_index_faces",
    "zero_area_faces", "nonfinite_faces", "duplicate_faces", "edges", "boundary_edges", "manifold_edges",
    "nonmanifold_edges", "nonmanifold_vertices", "multifan_vertices", "nonmanifold_edge_endpoints",
    "components", "components_manifold_edges", "largest_component_faces",
}  # fmt: skip
METRIC_KEYS = {
    "vf_ratio", "mean_valence", "boundary_edge_ratio", "nonmanifold_edge_ratio", "nonmanifold_vertex_ratio",
    "lcc_face_ratio", "lcc_area_ratio", "components", "euler_characteristic",
}  # fmt: skip


@pytest.fixture
def book(tmp_path: Path) -> Path:
    return mesh_file(tmp_path / "book.ply", *BOOK)


@pytest.fixture
def closed(tmp_path: Path) -> Path:
    return mesh_file(tmp_path / "closed.ply", *TETRAHEDRON)


def codes(err: str) -> list[str]:
    """Return the code of each line on standard error."""
    return [line.partition(":")[0] for line in err.splitlines()]


# --- printed and written results -----------------------------------------------------------------------


def test_json_has_the_documented_keys(here: Here, demo_asset: Path) -> None:
    result = here("audit", "--json", "-", "-v", demo_asset)
    data = result.json
    assert result.status == 0
    assert (data["schema"], data["path"]) == ("msb.audit/1", str(demo_asset))
    assert (data["method"], data["topology"]) == ("mesh_splatting", "indexed_mesh")
    assert set(data["counts"]) >= COUNT_KEYS
    assert set(data["metrics"]) >= METRIC_KEYS
    assert data["welded"] is data["cross_check"] is None
    assert all(isinstance(ms, float) for ms in data["timings_ms"].values())
    assert all(stage in result.err for stage in data["timings_ms"])  # -v prints the times on standard error


def test_the_text_begins_and_ends_with_the_verdict(here: Here, demo_asset: Path) -> None:
    result = here("audit", demo_asset)
    lines = result.out.strip().splitlines()
    assert (result.err, lines[0]) == ("", lines[-2])  # the last line is the next command
    assert lines[0].startswith(f"{demo_asset}: BAD: ")
    assert "\x1b" not in result.out
    (vertex,) = (line for line in lines if "non-manifold vertices" in line)
    (bow_tie,) = (line for line in lines if "(bow-ties)" in line)
    assert "vertex 0 at" in vertex
    assert "vertex 0 at" not in bow_tie
    assert here("audit", "-q", demo_asset).out == f"{lines[0]}\n"


# A ball of 8 faces, wound outwards.
BALL = (
    np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float64),
    np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]),
)
FOUR = np.concatenate([BALL[0] + [4 * step, 0, 0] for step in range(4)])
FOUR_FACES = np.concatenate([BALL[1] + 6 * step for step in range(4)])
# The lower half of a ball has its own vertices, and one face is missing.
# A flat sheet of eight triangles; a bent one whose winding is inconsistent.
SHEET = (
    np.array([[x, y, 0] for x in range(3) for y in range(3)], np.float64),
    np.array([[q, q + 3, q + 4, q, q + 4, q + 1] for q in (0, 1, 3, 4)]).reshape(-1, 3),
)
BENT = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1.0]]), np.array([[0, 1, 2], [1, 2, 3]])
# A ball with a single triangle beside it; one with 200 faces and a vertex that is not a number; one whose
# lower half has its own vertices, which differ by rounding.
STRAY = np.concatenate([BALL[0], BALL[0][:3] + 5]), np.concatenate([BALL[1], [[6, 7, 8]]])
LOST = ball(24)
LOST[0][30] = np.nan
ROUNDED = (
    np.concatenate([BALL[0] + 0, BALL[0] * (1 + 1e-7)]),
    np.concatenate([BALL[1][:4], BALL[1][4:] + 6]),
)
PATCHED = np.concatenate([BALL[0]] * 2), np.concatenate([BALL[1][1:4], BALL[1][4:] + 6])


@pytest.mark.parametrize(
    ("mesh", "plan", "after"),
    [
        ((BALL[0], BALL[1][:, ::-1]), "outward", "ok"),
        ((BALL[0], np.concatenate([BALL[1][:1, ::-1], BALL[1][1:]])), "orient", "ok"),
        ((BALL[0], np.tile(BALL[1], (2, 1))), "dedupe,orient,pair,debris:2", "ok"),
        ((BALL[0], BALL[1][1:]), "close:3:99,outward", "ok"),
        (BENT, "orient,close:4:99,outward", "ok"),
        (SHEET, "close:8:99,outward", "limited"),
        (STRAY, "close:3:99,debris:2,outward", "ok"),
        (LOST, "orient,pair,close", "ok"),
        (ROUNDED, "weld:4.8e-07,orient,pair", "ok"),
        (PATCHED, "weld,orient,pair", "limited"),
        (
            (np.tile(BALL[0], (2, 1)), np.concatenate([BALL[1][:4], BALL[1][4:] + 6])),
            "weld,orient,pair",
            "ok",
        ),
        (
            (np.concatenate([FOUR, [[9, 9, 9]]]), np.concatenate([FOUR_FACES, [[0, 2, 24]]])),
            "orient,pair",
            None,
        ),
    ],
)
def test_the_last_line_is_a_command_that_improves_the_mesh(
    here: Here, tmp_path: Path, mesh: tuple[np.ndarray, np.ndarray], plan: str, after: str | None
) -> None:
    path, repaired = tmp_path / "in.off", tmp_path / "repaired.glb"
    rows = [f"{x!r} {y!r} {z!r}" for x, y, z in np.asarray(mesh[0], float).tolist()]
    rows += [f"3 {a} {b} {c}" for a, b, c in mesh[1].tolist()]
    path.write_text("\n".join(["OFF", f"{len(mesh[0])} {len(mesh[1])} 0", *rows, ""]))
    last = here("audit", path).out.splitlines()[-1]
    words = last.removeprefix("Next: msb ").split()
    assert words[0] == "repair"
    assert words[-2:] == ["--plan", plan]
    words[words.index("repaired.glb")] = str(repaired)
    assert here(*words).status == 0
    before, result = (here("audit", "--json", "-", file).json for file in (path, repaired))
    levels = ["ok", "limited", "bad"]
    assert levels.index(result["verdict"]["level"]) <= levels.index(before["verdict"]["level"])
    assert after in (None, result["verdict"]["level"])
    faults = ("nonmanifold_vertices", "boundary_edges", "duplicate_faces", "nonfinite_faces")
    faults += ("inconsistent_winding_edges",)
    sums = [sum(data["counts"][key] for key in faults) for data in (before, result)]
    assert plan == "outward" or sums[1] < sums[0]
    assert before["verdict"]["plan"] == plan
    if result["verdict"]["level"] == "ok":
        assert result["verdict"]["plan"] is None
        assert "Next: " not in here("audit", repaired).out


def test_a_sound_stl_passes_print(here: Here, tmp_path: Path) -> None:
    path, hole = mesh_file(tmp_path / "a.stl", *BALL), mesh_file(tmp_path / "b.stl", BALL[0], BALL[1][1:])
    for words in ((), ("--weld", "exact")):
        assert here("audit", "--profile", "print", *words, path).status == 0
        assert here("audit", "--profile", "print", *words, hole).status == 1
    data = here("audit", "--json", "-", path).json
    assert (data["verdict"]["level"], data["without_seams"]["kind"]) == ("ok", "format")
    assert (data["counts"]["boundary_edges"], data["counts"]["seam_vertices"]) == (24, 18)
    assert (
        here("audit", "--profile", "game", mesh_file(tmp_path / "pieces.off", FOUR, FOUR_FACES)).status == 0
    )


def test_suggestions_depend_on_the_mesh(here: Here, tmp_path: Path) -> None:
    corners = np.random.default_rng(0).uniform(-1, 1, (12, 3)), np.arange(12).reshape(-1, 3)
    alone = here("audit", mesh_file(tmp_path / "alone.ply", *corners)).out
    trained = here("audit", "data_stubs/models/pebble/triangle_splatting").out
    flat = here("audit", mesh_file(tmp_path / "flat.ply", np.zeros((4, 3), np.float32), TETRAHEDRON[1])).out
    apart = mesh_file(tmp_path / "apart.ply", TETRAHEDRON[0][TETRAHEDRON[1][:2].ravel()], corners[1][:2])
    for text, wanted in ((alone, {"msb bake"}), (trained, {"msb web", "msb bake", "msb why"})):
        assert {word for word in ("msb repair", "msb web", "msb bake", "msb why") if word in text} == wanted
        assert "--weld exact" not in text
    assert "msb trial" in trained
    assert "msb trial" not in flat  # it has no visible faces
    assert "--weld exact" in here("audit", apart).out


def test_a_soup_with_a_degenerate_row_is_a_soup(here: Here, tmp_path: Path) -> None:
    corners = np.random.default_rng(0).uniform(-1, 1, (600, 3))
    rows = [*np.arange(600).reshape(-1, 3).tolist(), [0, 0, 1]]
    soup = mesh_file(tmp_path / "soup.off", corners, np.array(rows))
    assert here("audit", soup).out.splitlines()[1].startswith("triangle soup")
    here("audit", "-q", "--json", "-", "--fail-on-verdict", "bad", soup)
    assert here("audit", "-q", "--fail-on-verdict", "bad", soup).status == 1


def test_the_papers_row_stands_beside_ours(here: Here, demo_asset: Path) -> None:
    pytest.importorskip("msb.report")
    from msb.report import paper_row

    rows = [line.split() for line in here("audit", "--paper", demo_asset).out.splitlines()]
    (row,) = (row[2:] for row in rows if row[:2] == ["paper", "mean"])
    assert f"{paper_row('mesh_connectivity', scene='mean')['vf_ratio']:.2f}" == row[0]


def test_a_weld_adds_a_row(here: Here, tmp_path: Path) -> None:
    path = mesh_file(tmp_path / "tetra.stl", *TETRAHEDRON)
    data = here("audit", "--weld", "exact", "--json", "-", path).json
    assert (data["topology"], data["is_soup"], data["counts"]["components"]) == ("triangle_soup", True, 4)
    assert (data["welded"]["weld"], data["welded"]["counts"]["vertices"]) == ("exact", 4)
    assert data["welded"]["metrics"]["euler_characteristic"] == 2
    assert any(
        line.startswith("welded 1e-06") for line in here("audit", "--weld", "1e-6", path).out.splitlines()
    )


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".glb", ".stl"])
def test_every_mesh_format_is_audited(here: Here, tmp_path: Path, suffix: str) -> None:
    counts = here("audit", "--json", "-", mesh_file(tmp_path / f"tetra{suffix}", *TETRAHEDRON)).json["counts"]
    vertices, edges = (12, 12) if suffix == ".stl" else (4, 6)
    assert (counts["faces"], counts["vertices"], counts["edges"]) == (4, vertices, edges)


@pytest.mark.slow
def test_both_forms_of_an_asset_and_its_checkpoint_give_the_same_counts(
    here: Here, demo_asset: Path, tmp_path: Path
) -> None:
    library.save(library.load(demo_asset), tmp_path / "demo.triasset", form="folder")
    packed, folder = (
        here("audit", "--json", "-", path).json for path in (demo_asset, tmp_path / "demo.triasset")
    )
    assert all(packed[key] == folder[key] for key in ("counts", "metrics", "samples"))
    model = here("audit", "--json", "-", RING).json
    assert (model["method"], model["counts"]["faces"]) == ("two_dts", 3984)
    assert here("audit", "--json", "-", RING / "ckpt" / "60000.ckpt").json["counts"] == model["counts"]
    # The official PLY omits the faces that a threshold hides.
    assert here("audit", "--json", "-", RING / "point_cloud" / "60000.ply").json["counts"]["faces"] < 3984


def test_explain_finds_a_quantity_by_both_names(here: Here) -> None:
    result = here("audit", "--explain", "nonmanifold_vertex_ratio")
    assert (result.status, here("audit", "--explain", "nm_vertex_ratio").out) == (0, result.out)
    assert all(peer in result.out for peer in ("libigl", "PyMeshLab", "trimesh"))
    wrong = here("audit", "--explain", "nonmanifold_vertx_ratio")
    assert (wrong.status, "nonmanifold_vertex_ratio" in wrong.err) == (2, True)
    for option in ("--jsonl", "--json"):
        document = json.loads(here("audit", "--explain", "components", option, "-").out)
        assert document["schema"] == "msb.definition/1"


# --- several inputs ------------------------------------------------------------------------------------


def test_several_inputs_give_a_list_a_table_and_the_worst_status(
    here: Here, book: Path, closed: Path, tmp_path: Path
) -> None:
    (tmp_path / "below").mkdir()
    (tmp_path / "notes.txt").write_text("no mesh")
    mesh_file(tmp_path / "below" / "seams.stl", *TETRAHEDRON)
    (tmp_path / "torn.ply").write_text("ply\n")
    result = here("audit", "--json", "-", "missing.ply", tmp_path, book)
    names = ["missing.ply", "below/seams.stl", "book.ply", "closed.ply", "torn.ply"]
    assert result.status == 3
    assert {item["path"].removeprefix(f"{tmp_path}/") for item in result.json} == {*names}
    errors = [item["error"]["code"] for item in result.json if "error" in item]
    assert errors == codes(result.err) == ["FILE_NOT_FOUND", "MESH_FILE_TRUNCATED"]
    lines = here("audit", "--fail-on-verdict", "limited", tmp_path).out.splitlines()
    rows = {row[0]: row[1:3] for row in (line.split() for line in lines[-6:-2])}
    assert rows[str(book)] == ["BAD", "3"]
    assert rows[str(closed)] == ["OK", "4"]
    assert rows[str(tmp_path / "torn.ply")] == ["-", "-"]
    numbers = [int(word) for word in lines[-1].split() if word.isdigit()]
    assert numbers == [4, 2, 0, 1, 1, 1]  # numbers of meshes: ok, limited, bad, failed a gate, not read
    assert len(here("audit", "-q", book, closed).out.splitlines()) == 3


def test_a_pattern_stands_for_its_matches_each_once(here: Here, book: Path, closed: Path) -> None:
    empty, pattern = book.parent / "empty", str(book.parent / "**")
    empty.mkdir()
    result = here("audit", "-q", "--jsonl", "-", pattern)
    rows = [json.loads(line) for line in result.out.splitlines()]
    assert (result.status, [row["path"] for row in rows]) == (3, [str(empty), str(book), str(closed)])
    assert rows[0]["error"]["code"] == "FILE_NOT_RECOGNISED"
    assert all(row["schema"] == "msb.audit/1" and row["tool_version"] for row in rows)
    empty.rmdir()
    closed.unlink()
    assert here("audit", "-q", "--json", "-", pattern, book).json["path"] == str(
        book
    )  # one mesh gives an object, not a list
    named = book.rename(book.with_name("a[1].ply"))  # this name looks like a pattern
    assert here("audit", "-q", named).status == 0


@pytest.mark.parametrize("content", [None, "OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n3 0 1 3\n"])
def test_an_input_that_fails_leaves_stdout_empty(here: Here, tmp_path: Path, content: str | None) -> None:
    if content is not None:
        (tmp_path / "bad.off").write_text(content)
    code = "FILE_NOT_RECOGNISED" if content is None else "MESH_INDEX_OUT_OF_RANGE"
    here("audit", "--json", "-", tmp_path).ends(3, f"{code}: {tmp_path}")


def test_values_of_an_asset_are_checked(here: Here, tmp_path: Path) -> None:
    points, faces = TETRAHEDRON
    asset = build_asset({"positions": points, "indices": faces.astype(np.uint32)}, {})
    library.save(asset, tmp_path / "bad.triasset", form="folder")
    indices = np.array([[0, 1, 2], [0, 1, 9], [1, 2, 3], [0, 3, 2]], "<u4")
    (tmp_path / "bad.triasset" / "buffers" / "indices.bin").write_bytes(indices.tobytes())
    here("audit", tmp_path / "bad.triasset").ends(3, "MESH_INDEX_OUT_OF_RANGE: ")


def test_a_csv_has_a_row_for_each_mesh_and_no_formula(here: Here, book: Path, tmp_path: Path) -> None:
    names = ["=1+1.off", "+a.off", "-a.off", "@SUM(A1).off", "\t=1.off"]
    paths = [mesh_file(tmp_path / name, *BOOK) for name in names]
    assert here("audit", "-q", "--csv", tmp_path / "new" / "a.csv", book, *paths).status == 0
    text = (tmp_path / "new" / "a.csv").read_text()
    assert text == here("audit", "--csv", "-", book, *paths).out.replace("\r\n", "\n")
    rows = list(csv.DictReader(io.StringIO(text)))
    assert [row["faces"] for row in rows] == ["3"] * 6
    assert rows[0]["nonmanifold_vertices"] == "2"
    assert all(not row["path"].startswith(("=", "+", "-", "@", "\t")) for row in rows)


# --- gates ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("condition", "status"),
    [
        ("nonmanifold_edge_ratio>0", 1),
        ("metrics.nonmanifold_edge_ratio > 0.5", 0),
        ("counts.components==1", 1),
        ("components!=1", 0),
        ("faces>=3", 1),
        ("faces<3", 0),
        ("vf_ratio<=1e3", 1),
    ],
)
def test_gates(here: Here, book: Path, condition: str, status: int) -> None:
    result = here("audit", "-q", "--fail-on", condition, book)
    assert (result.status, codes(result.err)) == (status, ["GATE_FAILED"] * status)


@pytest.mark.parametrize(
    ("profile", "failing"),
    [
        ("game", {"nonmanifold_edge_ratio", "nonmanifold_vertex_ratio"}),
        ("print", {"boundary_edges", "nonmanifold_edges", "nonmanifold_vertices"}),
        ("research", {"boundary_edge_ratio"}),
    ],
)
def test_profiles_gate_for_a_purpose(
    here: Here, book: Path, closed: Path, profile: str, failing: set[str]
) -> None:
    result = here("audit", "-q", "--profile", profile, book, closed)
    lines = result.err.splitlines()
    assert all(line.startswith(f"GATE_FAILED: {book}: ") for line in lines)  # the closed mesh passes
    assert {line.removeprefix(f"GATE_FAILED: {book}: ").split()[0] for line in lines} == failing


def test_profiles_hold_the_papers_numbers() -> None:
    pytest.importorskip("msb.report")
    from msb.report import paper_row

    gates = {name: [parse_gate(text) for text in texts] for name, texts in PROFILES.items()}
    paper = paper_row("mesh_connectivity", scene="mean")
    research = {gate.key: gate.limit for gate in gates["research"] if gate.key != "nonfinite_faces"}
    assert research == {key: paper[key] for key in research}
    assert set(research) >= {"nonmanifold_edge_ratio", "nonmanifold_vertex_ratio", "lcc_face_ratio"}


def test_the_verdict_gates_at_a_level_and_worse(here: Here, book: Path, closed: Path, tmp_path: Path) -> None:
    holed = mesh_file(tmp_path / "holed.ply", TETRAHEDRON[0], TETRAHEDRON[1][:3])
    for level, failed in (("bad", [book]), ("limited", [book, holed])):
        result = here("audit", "-q", "--fail-on-verdict", level, book, holed, closed)
        begins = [f"GATE_FAILED: {path}: " for path in failed]
        assert result.status == 1
        assert all(map(str.startswith, result.err.splitlines(), begins))
        assert len(result.err.splitlines()) == len(failed)
    assert here("audit", "--fail-on-verdict", "ok", closed).status == 2


def test_a_gate_on_an_undefined_ratio_fails(here: Here, tmp_path: Path) -> None:
    path = tmp_path / "points.off"
    path.write_text("OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n")
    result = here("audit", "--fail-on", "nonmanifold_edge_ratio>0", path)
    assert (result.status, codes(result.err)) == (1, ["GATE_FAILED"])


@pytest.mark.parametrize("gate", ["nm_edges", "foo>1", "components>", "components>x", "components>nan", ">1"])
def test_a_bad_gate_is_wrong_usage_before_anything_is_read(here: Here, gate: str) -> None:
    here("audit", "--fail-on", gate, "missing.ply").ends(2, "USAGE: --fail-on")


def test_a_peer_that_disagrees_fails_the_audit(
    here: Here, closed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = {"peer": "igl", "quantity": "components", "theirs": 2, "ours": 1, "verdict": "disagrees"}
    check = SimpleNamespace(skipped={}, to_rows=lambda: ({**row, "version": "1", "why": "?"},))
    monkeypatch.setattr("msb.topology.crosscheck.cross_check", lambda *_: check)
    result = here("audit", "-q", "--cross-check", closed)
    assert (result.status, codes(result.err)) == (1, ["CROSS_CHECK_DISAGREES"])


# --- elements ------------------------------------------------------------------------------------------


def test_elements_in_all_three_forms(here: Here, book: Path, tmp_path: Path) -> None:
    for suffix in ("npz", "csv", "vtp"):
        assert here("audit", "-q", "--elements", tmp_path / f"e.{suffix}", book).status == 0
    with np.load(tmp_path / "e.npz", allow_pickle=False) as data:
        assert data["nonmanifold_edges"].tolist() == [[0, 1]]
        assert data["nonmanifold_edge_endpoints"].tolist() == [0, 1]
        assert data["nonmanifold_vertices"].tolist() == [0, 1]
        assert len(data["boundary_edges"]) == 6
        assert data["face_component"].tolist() == [0, 0, 0]
    rows = list(csv.DictReader((tmp_path / "e.csv").read_text().splitlines()))
    (row,) = (row for row in rows if row["kind"] == "nonmanifold_edges")
    assert (row["element"], row["component"], row["vertices"]) == ("0", "", "0 1")
    head = (tmp_path / "e.vtp").read_bytes().partition(b"<CellData>")[0]
    assert all(part in head for part in (b'Verts="4"', b'Lines="7"', b'Polys="3"'))
    other = mesh_file(tmp_path / "other.ply", *TETRAHEDRON)
    here("audit", "--elements", tmp_path / "new.npz", book, other).ends(2, "USAGE: --elements")


@pytest.mark.slow
def test_elements_as_vtk_reads_them(here: Here, book: Path, tmp_path: Path) -> None:
    pyvista = pytest.importorskip("pyvista", reason="extra view is not installed")
    assert here("audit", "-q", "--elements", tmp_path / "e.vtp", book).status == 0
    mesh = pyvista.read(tmp_path / "e.vtp")
    assert (mesh.n_points, mesh.n_verts, mesh.n_lines, mesh.n_cells) == (5, 4, 7, 4 + 7 + 3)
    names = ["face", *mesh.field_data["kinds"]]
    assert [names[kind] for kind in mesh.cell_data["kind"]] == [
        *["nonmanifold_vertices"] * 2,
        *["nonmanifold_edge_endpoints"] * 2,
        "nonmanifold_edges",
        *["boundary_edges"] * 6,
        *["face"] * 3,
    ]
    assert mesh.cell_data["component"].tolist() == [-1] * 11 + [0] * 3
    assert np.array_equal(mesh.points, BOOK[0])
    assert mesh.faces.reshape(-1, 4)[:, 1:].tolist() == BOOK[1].tolist()
