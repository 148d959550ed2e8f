"""`msb audit` from outside: exit status, streams, files, JSON keys."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import msb as library
from msb.api.gates import PROFILES, parse_gate
from msb.report import paper_row
from msb.topology.verdict import MERGED
from tests.cli.conftest import Here, Msb, mesh_file
from tests.conftest import BOOK, TETRAHEDRON

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


@pytest.mark.slow
def test_json_holds_the_contract_and_nothing_else_is_on_stdout(msb: Msb, demo_asset: Path) -> None:
    result = msb("audit", "--json", "-", "-v", demo_asset)
    data = result.json
    assert result.status == 0
    assert data["schema"] == "msb.audit/1"
    assert data["path"] == str(demo_asset)
    assert data["method"] == "mesh_splatting"
    assert data["topology"] == "indexed_mesh"
    assert set(data["counts"]) >= COUNT_KEYS
    assert set(data["metrics"]) >= METRIC_KEYS
    assert data["welded"] is None
    assert data["cross_check"] is None
    assert all(isinstance(ms, float) for ms in data["timings_ms"].values())
    assert "half_edges" in result.err  # -v: timings, on the other stream


def test_a_mesh_that_is_closed_once_vertices_are_merged_is_pointed_to_what_merges_them(
    msb: Msb, tmp_path: Path
) -> None:
    points, faces = np.eye(4, 3, dtype=np.float32), np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    path = mesh_file(tmp_path / "tetrahedron.stl", points, faces)
    hint = f"msb repair --plan weld,orient,pair -o merged.glb {path}"
    assert f"\nMerge the vertices: {hint}\n" in msb("audit", path).out
    made = tmp_path / "merged.glb"
    msb(*hint.split()[1:-3], "-o", made, path, status=0)
    assert msb("audit", "-q", made).out.startswith(f"{made}: OK: ")
    assert "Merge the vertices" not in msb("audit", made).out


@pytest.mark.slow
def test_a_soup_without_coincident_corners_is_not_told_to_merge_them(msb: Msb, tmp_path: Path) -> None:
    corners = np.random.default_rng(0).uniform(-1, 1, (12, 3)), np.arange(12).reshape(-1, 3)
    alone = msb("audit", mesh_file(tmp_path / "alone.ply", *corners)).out
    assert "no two corners coincide, so it is no surface and repair cannot make it one." in alone
    trained = "data_stubs/models/pebble/triangle_splatting"
    shown = msb("audit", trained).out
    assert f"msb web --tier dedicated -o page.html {trained}; what engines lose: msb why {trained}" in shown
    assert f"a plain mesh that looks like it: msb bake -o plain.glb {trained}" in shown
    for text in (alone, shown, msb("repair", trained, "-o", tmp_path / "out.ply").out):
        assert "Merge the vertices" not in text
        assert "--weld exact" not in text
    compared = msb("repair", "--compare", "--task", "none", tmp_path / "alone.ply").out
    assert "No two corners coincide: it is no surface, and no repair makes it one." in compared
    apart = mesh_file(tmp_path / "coincide.ply", TETRAHEDRON[0][TETRAHEDRON[1][:2].ravel()], corners[1][:2])
    assert "(--weld exact shows what merging" in msb("audit", apart).out


def test_text_begins_and_ends_with_the_verdict(msb: Msb, demo_asset: Path) -> None:
    result = msb("audit", demo_asset)
    lines = result.out.strip().splitlines()
    assert lines[0] == lines[-1]
    verdict = "BAD: renders; not usable for subdivision, booleans or printing, unreliable for"
    assert lines[-1].startswith(f"{demo_asset}: {verdict}")
    assert "\x1b" not in result.out
    assert result.err == ""
    assert f"msb trial {demo_asset}" in lines[-2]
    bow_ties, others = (
        next(line for line in lines if name in line) for name in ("(bow-ties)", "non-manifold v")
    )
    assert "vertex 0 at" in others
    assert "vertex 0 at" not in bow_ties  # a place is named once


def test_of_what_does_not_render_no_trial_is_proposed(msb: Msb, tmp_path: Path) -> None:
    flat = mesh_file(tmp_path / "flat.ply", np.zeros((4, 3), np.float32), TETRAHEDRON[1])
    result = msb("audit", flat)
    assert "BAD: does not render" in result.out
    assert "msb trial" not in result.out


def test_paper_row_is_printed_beside_ours(msb: Msb, demo_asset: Path) -> None:
    rows = [line.split() for line in msb("audit", "--paper", demo_asset).out.splitlines()]
    assert ["paper", "mean", "0.52", "6.49", "0.45", "0.18", "0.65", "0.70", "0.69", "0.71", "M"] in rows


@pytest.mark.slow
def test_folder_and_packed_asset_give_the_same_audit(msb: Msb, demo_asset: Path, tmp_path: Path) -> None:
    asset = library.load(demo_asset)
    library.save(asset, tmp_path / "demo.triasset", form="folder")
    packed = msb("audit", "--json", "-", demo_asset).json
    folder = msb("audit", "--json", "-", tmp_path / "demo.triasset").json
    assert {k: packed[k] for k in ("counts", "metrics", "samples")} == {
        k: folder[k] for k in ("counts", "metrics", "samples")
    }


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".glb", ".stl"])
def test_every_mesh_format_is_audited(msb: Msb, tmp_path: Path, suffix: str) -> None:
    counts = msb("audit", "--json", "-", mesh_file(tmp_path / f"tetra{suffix}", *TETRAHEDRON)).json["counts"]
    soup = suffix == ".stl"
    assert counts["faces"] == 4
    assert counts["vertices"] == (12 if soup else 4)
    assert counts["edges"] == (12 if soup else 6)


@pytest.mark.slow
def test_soup_is_named_and_weld_shown_beside(msb: Msb, tmp_path: Path) -> None:
    path = mesh_file(tmp_path / "tetra.stl", *TETRAHEDRON)
    data = msb("audit", "--weld", "exact", "--json", "-", path).json
    assert data["topology"] == "triangle_soup"
    assert data["is_soup"]
    assert data["counts"]["components"] == 4
    assert data["welded"]["weld"] == "exact"
    assert data["welded"]["counts"]["vertices"] == 4
    assert data["welded"]["metrics"]["euler_characteristic"] == 2
    text = msb("audit", "--weld", "1e-6", path).out
    assert "triangle soup" in text
    assert "welded, it is manifold, in one piece" in text


def test_several_paths_give_a_list_and_the_worst_status(msb: Msb, book: Path, demo_asset: Path) -> None:
    result = msb("audit", "--json", "-", demo_asset, "missing.ply", book, status=3)
    assert [item["path"] for item in result.json] == ["missing.ply", str(demo_asset), str(book)]
    assert result.json[0]["error"]["code"] == "FILE_NOT_FOUND"
    assert result.err.splitlines() == ["FILE_NOT_FOUND: missing.ply: there is no such file or folder"]


@pytest.mark.slow
def test_several_meshes_end_with_one_table_and_totals(msb: Msb, book: Path, tmp_path: Path) -> None:
    mesh_file(tmp_path / "closed.ply", *TETRAHEDRON)
    mesh_file(tmp_path / "seams.stl", *TETRAHEDRON)
    (tmp_path / "torn.ply").write_text("ply\n")
    shown = msb("audit", "--fail-on-verdict", "limited", tmp_path)
    table = [line.rstrip().split(maxsplit=3) for line in shown.out.splitlines()[-7:-2]]
    assert table == [
        ["File", "Verdict", "Faces", "First reason"],
        [str(book), "BAD", "3", "14 % of its edges and 40 % of its vertices are non-manifold"],
        [str(tmp_path / "closed.ply"), "OK", "4", "-"],
        [str(tmp_path / "seams.stl"), "BAD", "4", f"triangle soup; {MERGED}"],
        [str(tmp_path / "torn.ply"), "-", "-", "MESH_FILE_TRUNCATED"],
    ]
    assert shown.out.splitlines()[-1] == "4 meshes: 1 ok, 0 limited, 2 bad; 2 failed a gate; 1 not read"
    quiet = msb("audit", "-q", book, tmp_path / "closed.ply").out.splitlines()
    assert (len(quiet), quiet[-1]) == (3, "2 meshes: 1 ok, 0 limited, 1 bad")
    assert "First reason" not in msb("audit", book).out


@pytest.mark.slow
def test_the_verdict_gates_at_a_level_and_worse(msb: Msb, book: Path, tmp_path: Path) -> None:
    holed = mesh_file(tmp_path / "holed.ply", TETRAHEDRON[0], TETRAHEDRON[1][:3])
    gate = "GATE_FAILED: {}: verdict is {}, gate: {}\n"
    bad = gate.format(book, "BAD (14 % of its edges and 40 % of its vertices are non-manifold)", "bad")
    assert msb("audit", "--fail-on-verdict", "bad", book, holed).err == bad
    limited = msb("audit", "--fail-on-verdict", "limited", holed, status=1)
    assert limited.err == gate.format(holed, "LIMITED (open: 3 boundary edges in 1 loop)", "limited or bad")
    closed = mesh_file(tmp_path / "closed.ply", *TETRAHEDRON)
    msb("audit", "--fail-on-verdict", "limited", closed, status=0)
    msb("audit", "--fail-on-verdict", "ok", closed, status=2)


def test_folders_are_searched(msb: Msb, tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    (tmp_path / "notes.txt").write_text("no mesh")
    mesh_file(tmp_path / "b.off", *BOOK)
    mesh_file(tmp_path / "below" / "a.ply", *TETRAHEDRON)
    found = msb("audit", "--json", "-", tmp_path).json
    assert [item["path"].rsplit("/", 1)[1] for item in found] == ["b.off", "a.ply"]


def test_folder_without_meshes_is_an_error(msb: Msb, tmp_path: Path) -> None:
    result = msb("audit", tmp_path, status=3)
    assert result.err.startswith(
        f"FILE_NOT_RECOGNISED: {tmp_path}: the folder holds no checkpoint and none of .triasset"
    )


def test_index_error_names_file_and_row_and_leaves_stdout_empty(msb: Msb, tmp_path: Path) -> None:
    path = tmp_path / "bad.off"
    path.write_text("OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n3 0 1 3\n")
    result = msb("audit", "--json", "-", path, status=3)
    assert result.out == ""
    assert result.err == (
        f"MESH_INDEX_OUT_OF_RANGE: {path}: line 7: the face names vertex 3; those of this file are 0 to 2\n"
    )


def test_debug_shows_the_traceback(msb: Msb) -> None:
    assert "Traceback" not in msb("info", "missing.triasset").err
    assert "Traceback" in msb("info", "--debug", "missing.triasset").err


@pytest.mark.slow
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
def test_gates(msb: Msb, book: Path, condition: str, status: int) -> None:
    result = msb("audit", "-q", "--fail-on", condition, book)
    assert result.status == status
    assert result.err.startswith(f"GATE_FAILED: {book}: ") is bool(status)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("profile", "failing"),
    [
        ("game", {"nonmanifold_edge_ratio", "nonmanifold_vertex_ratio"}),
        ("print", {"boundary_edges", "nonmanifold_edges", "nonmanifold_vertices"}),
        ("research", {"boundary_edge_ratio"}),
    ],
)
def test_profiles_gate_for_a_purpose(
    msb: Msb, book: Path, tmp_path: Path, profile: str, failing: set[str]
) -> None:
    closed = mesh_file(tmp_path / "tetra.ply", *TETRAHEDRON)
    result = msb("audit", "-q", "--profile", profile, book, closed, status=1)
    lines = result.err.splitlines()
    assert all(line.startswith(f"GATE_FAILED: {book}: ") for line in lines)  # the closed one passes
    assert {line.removeprefix(f"GATE_FAILED: {book}: ").split()[0] for line in lines} == failing
    assert all(f"gate of profile {profile}: " in line for line in lines)


def test_profiles_hold_known_keys_and_the_papers_numbers() -> None:
    gates = {name: [parse_gate(text) for text in texts] for name, texts in PROFILES.items()}
    paper = paper_row("mesh_connectivity", scene="mean")
    research = {gate.key: gate.limit for gate in gates["research"] if gate.key != "nonfinite_faces"}
    assert research == {key: paper[key] for key in research}
    assert set(research) >= {"nonmanifold_edge_ratio", "nonmanifold_vertex_ratio", "lcc_face_ratio"}


def test_gate_on_a_ratio_over_nothing_fails(msb: Msb, tmp_path: Path) -> None:
    path = tmp_path / "points.off"
    path.write_text("OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n")
    result = msb("audit", "--fail-on", "nonmanifold_edge_ratio>0", path, status=1)
    assert "does not exist for this mesh" in result.err


@pytest.mark.slow
@pytest.mark.parametrize("gate", ["nm_edges", "foo>1", "components>", "components>x", "components>nan", ">1"])
def test_bad_gate_is_a_usage_error_before_anything_is_read(msb: Msb, gate: str) -> None:
    msb("audit", "--fail-on", gate, "missing.ply").ends(2, "USAGE: --fail-on")


@pytest.mark.slow
def test_outputs_are_not_overwritten_without_force(msb: Msb, book: Path, tmp_path: Path) -> None:
    target = tmp_path / "out.json"
    target.write_text("mine")
    for option in ("--json", "--csv"):
        result = msb("audit", option, target, book, status=2)
        assert result.err == f"OUTPUT_EXISTS: {target}: it exists; --force replaces it\n"
        assert target.read_text() == "mine"
    msb("audit", "--json", target, "--force", book, status=0)
    assert json.loads(target.read_text())["counts"]["nonmanifold_edges"] == 1


@pytest.mark.slow
def test_lines_of_json_patterns_and_stopping_at_the_first_failure(
    msb: Msb, book: Path, tmp_path: Path
) -> None:
    mesh_file(tmp_path / "tetra.ply", *TETRAHEDRON)
    result = msb("audit", "--jsonl", "-", tmp_path / "*.ply", "missing.ply", status=3)
    rows = [json.loads(line) for line in result.out.splitlines()]
    assert [row["path"] for row in rows] == ["missing.ply", str(book), str(tmp_path / "tetra.ply")]
    assert rows[0]["error"]["code"] == "FILE_NOT_FOUND"
    assert all(row["schema"] == "msb.audit/1" and row["tool_version"] for row in rows)
    result = msb("audit", "-q", "--fail-fast", "--fail-on", "nonmanifold_edges>0", tmp_path / "*.ply")
    assert (result.status, len(result.out.splitlines())) == (1, 1)
    (tmp_path / "a[1].ply").write_bytes(book.read_bytes())  # a name, though it looks like a pattern
    msb("audit", "-q", tmp_path / "a[1].ply", status=0)


def test_what_matches_a_pattern_is_taken_each_by_itself_and_once(here: Here, book: Path) -> None:
    empty, pattern = book.parent / "empty", str(book.parent / "**")
    empty.mkdir()
    result = here("audit", "-q", "--jsonl", "-", pattern)
    rows = [json.loads(line) for line in result.out.splitlines()]
    assert (result.status, [row["path"] for row in rows]) == (3, [str(empty), str(book)])
    assert rows[0]["error"]["code"] == "FILE_NOT_RECOGNISED"
    empty.rmdir()
    assert here("audit", "-q", "--json", "-", pattern, book).status == 0  # one mesh
    assert here("convert", pattern, book.parent / "out").status == 0


def test_a_definition_goes_where_json_goes_and_no_other_output_is_ignored(here: Here, tmp_path: Path) -> None:
    for option in ("--jsonl", "--json"):
        assert here("audit", "--explain", "components", option, "-").out.startswith("{")
    for line, said in (
        ("--explain components --csv -", "USAGE: --csv does not go with --explain"),
        ("--explain components --elements e.csv", "USAGE: --elements does not go with --explain"),
        ("--version --json -", "USAGE: --json does not go with --version"),
    ):
        here("audit", *line.split()).ends(2, said)


def test_a_degenerate_row_lets_no_soup_pass_a_gate(here: Here, tmp_path: Path) -> None:
    corners = np.random.default_rng(0).uniform(-1, 1, (600, 3)).tolist()
    rows = [*np.arange(600).reshape(-1, 3).tolist(), [0, 0, 1]]
    lines = ["OFF", f"600 {len(rows)} 0", *(" ".join(map(str, point)) for point in corners)]
    lines += [" ".join(map(str, (3, *row))) for row in rows]
    (tmp_path / "soup.off").write_text("\n".join(lines))
    result = here("audit", "-q", "--fail-on-verdict", "bad", tmp_path / "soup.off")
    assert (result.status, "verdict is BAD (triangle soup)" in result.err) == (1, True), result


def test_csv_has_one_row_a_mesh(msb: Msb, book: Path, demo_asset: Path, tmp_path: Path) -> None:
    msb("audit", "-q", "--csv", tmp_path / "new" / "a.csv", book, demo_asset, status=0)
    text = (tmp_path / "new" / "a.csv").read_text()
    assert text == msb("audit --csv -", book, demo_asset).out.replace("\r\n", "\n")
    rows = list(csv.DictReader(text.splitlines()))
    assert [row["faces"] for row in rows] == ["3", "34761"]
    assert rows[0]["nonmanifold_vertices"] == "2"


@pytest.mark.slow
def test_elements_in_all_three_forms(msb: Msb, book: Path, tmp_path: Path) -> None:
    for suffix in ("npz", "csv", "vtp"):
        msb("audit", "-q", "--elements", tmp_path / f"e.{suffix}", book, status=0)
    with np.load(tmp_path / "e.npz", allow_pickle=False) as data:
        assert data["nonmanifold_edges"].tolist() == [[0, 1]]
        assert data["nonmanifold_edge_endpoints"].tolist() == [0, 1]
        assert data["nonmanifold_vertices"].tolist() == [0, 1]
        assert len(data["boundary_edges"]) == 6
        assert data["face_component"].tolist() == [0, 0, 0]
    with (tmp_path / "e.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {"kind": "nonmanifold_edges", "element": "0", "component": "", "vertices": "0 1"}.items() <= next(
        row for row in rows if row["kind"] == "nonmanifold_edges"
    ).items()
    head = (tmp_path / "e.vtp").read_bytes().partition(b"<CellData>")[0].decode("ascii")
    assert 'NumberOfVerts="4" NumberOfLines="7" NumberOfStrips="0" NumberOfPolys="3"' in head


@pytest.mark.slow
def test_elements_as_vtk_reads_them(msb: Msb, book: Path, tmp_path: Path) -> None:
    pyvista = pytest.importorskip("pyvista", reason="extra view is not installed")
    msb("audit", "-q", "--elements", tmp_path / "e.vtp", book, status=0)
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


def test_elements_need_one_mesh_and_a_known_suffix(
    msb: Msb, book: Path, demo_asset: Path, tmp_path: Path
) -> None:
    msb("audit", "--elements", tmp_path / "e.xyz", book, status=2)
    result = msb("audit", "--elements", tmp_path / "e.npz", book, demo_asset, status=2)
    assert "--elements takes one mesh" in result.err


@pytest.mark.slow
def test_explain_prints_formula_section_and_peers(msb: Msb) -> None:
    result = msb("audit", "--explain", "nonmanifold_vertex_ratio", status=0)
    for word in ("formula", "paper", "libigl", "PyMeshLab", "trimesh"):
        assert word.lower() in result.out.lower()
    assert max(map(len, result.out.splitlines())) <= 80
    assert msb("audit", "--explain", "nm_vertex_ratio").out == result.out
    wrong = msb("audit", "--explain", "nonmanifold_vertx_ratio", status=2)
    assert "nonmanifold_vertex_ratio" in wrong.err
