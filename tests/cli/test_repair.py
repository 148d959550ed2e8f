"""`msb repair`, as users meet it."""

from __future__ import annotations

import errno
import io
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msb.cli.whole_words import WholeWordConsole

import msb as library
from msb.meshes import read_mesh, write_mesh
from msb.meshes.assets import asset_from_mesh
from msb.repair.command import print_table
from tests.cli.conftest import Here, Msb, Refused, mesh_file
from tests.conftest import BOOK, ROOT, TETRAHEDRON
from tests.topology.seamed import textured_cube

CHECKPOINT = ROOT / "data_stubs" / "checkpoint"


@pytest.fixture
def book(tmp_path: Path) -> Path:
    """Return a mesh file of three pages at one edge, in double precision."""
    return mesh_file(tmp_path / "book.ply", BOOK[0].astype(np.float64) / 3, BOOK[1])


@pytest.mark.slow
def test_a_checkpoint_becomes_a_repaired_asset_with_its_maps(msb: Msb, tmp_path: Path) -> None:
    target, maps = tmp_path / "new" / "a.triasset", tmp_path / "maps.npz"
    result = msb("repair", CHECKPOINT, "-o", target, "--maps", maps, "--json", "-", status=0)
    assert "where back faces are culled they show from the other side" in result.err
    data = result.json
    assert data["schema"] == "msb.repair/1"
    assert {"path", "output", "plan", "steps", "before", "after", "verdict_before", "verdict_after"} <= set(
        data
    )
    assert {"step", "faces_removed", "faces_added", "vertices_added", "seconds"} <= set(data["steps"][0])
    assert (data["verdict_before"]["level"], data["verdict_after"]["level"]) == ("bad", "limited")
    assert data["after"]["counts"]["nonmanifold_vertices"] == 0
    original, made = library.open(CHECKPOINT), library.load(target)
    assert made.manifest.method == "mesh_splatting"
    with np.load(maps) as found:
        assert found["vertex"].dtype == found["face"].dtype == np.int64
        assert np.array_equal(original.buffers["f_rest"][found["vertex"]], made.buffers["f_rest"])
        assert len(found["face"]) == len(found["turned"]) == made.manifest.face_count


def test_what_a_repaired_mesh_file_does_not_have_of_its_source_is_said(msb: Msb, tmp_path: Path) -> None:
    source = tmp_path / "one.obj"
    source.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n")
    of_mesh = msb("repair", source, "-o", tmp_path / "b.glb")
    assert of_mesh.err == f"note: {tmp_path / 'b.glb'}: left out: UVs\n"
    of_model = msb("repair", CHECKPOINT, "-o", tmp_path / "c.glb")
    assert "c.glb: left out: colours that change with the view (SH degree 1), opacity\n" in of_model.err
    as_stl = msb("repair", CHECKPOINT, "-o", tmp_path / "c.stl")
    assert "c.stl: .stl repeats the vertices of every face" in as_stl.err


def test_a_repaired_soup_is_told_what_merges_it(msb: Msb, tmp_path: Path) -> None:
    corners = TETRAHEDRON[0][TETRAHEDRON[1].reshape(-1)]
    source = mesh_file(tmp_path / "a soup.ply", corners, np.arange(12).reshape(-1, 3))
    target = tmp_path / "out.ply"
    result = msb("repair", source, "-o", target)
    assert "12 boundary edges: a soup stays one unless weld merges vertices" in result.out
    way_out = f'msb repair --plan weld,orient,pair --force -o {target} "{source}"'
    assert f"Merge the vertices: {way_out}\n" in result.out
    welded = msb("repair", "--plan", "weld,orient,pair", "--force", "-o", target, source)
    assert "OK; " in welded.out
    assert "Merge the vertices" not in welded.out
    as_stl = msb("repair", target, "-o", tmp_path / "out.stl")
    assert "out.stl: .stl repeats the vertices of every face: it is a soup again" in as_stl.err
    assert "soup" not in msb("convert", source, tmp_path / "soup.stl").err


@pytest.mark.parametrize("suffix", [".glb", ".ply", ".obj", ".off", ".stl", ".triasset"])
def test_the_verdict_after_a_repair_is_that_of_the_file(msb: Msb, tmp_path: Path, suffix: str) -> None:
    model, target = ROOT / "data_stubs" / "models" / "walled" / "triangle_splatting", tmp_path / f"a{suffix}"
    weld = ("--plan", "weld:0.02,orient,pair")
    result = msb("repair", *weld, model, "-o", target, "--json", "-")
    file = msb("audit", target, "--json", "-").json
    assert result.json["verdict_after"] == file["verdict"]
    assert result.json["after"] == {key: file[key] for key in ("counts", "metrics")}
    split = suffix in (".glb", ".obj", ".stl")  # few of its faces meet, and hardly two have one colour
    assert file["verdict"]["level"] == ("bad" if split else "limited")
    assert ("it is a soup" in result.err) is (suffix == ".stl")
    assert ("holds no colours of faces" in result.err) is (suffix in (".glb", ".obj"))
    gated = msb("repair", "-f", *weld, model, "-o", target, "--fail-on-verdict", "bad")
    assert gated.status == split
    assert ("the file is a soup, because" in gated.out) is split
    assert ("in the file; edges cut by the repair: " in gated.out) is split
    assert "unless weld merges" not in gated.out
    assert "Merge the vertices" not in gated.out  # they were


def test_a_mesh_file_keeps_its_precision_and_the_original_stays(msb: Msb, book: Path) -> None:
    before = book.read_bytes()
    target = book.with_name("fixed.ply")
    result = msb("repair", book, target, status=0)  # where convert and export take it, too
    assert "LIMITED; " in result.out
    assert "Components: 1 before, 2 after; edges cut: 1" in result.out
    assert read_mesh(target).vertices.dtype == np.float64
    assert book.read_bytes() == before
    again = book.with_name("again.ply")
    msb("repair", target, "-o", again, status=0)
    assert again.read_bytes() == target.read_bytes()
    assert msb("repair", book, "-o", target).err.startswith(f"OUTPUT_EXISTS: {target}")


def test_gates_judge_what_came_out_and_what_came_out_is_there(msb: Msb, book: Path) -> None:
    target = book.with_name("fixed.ply")
    result = msb("repair", "-q", book, "-o", target, "--fail-on", "nonmanifold_edges>0")
    assert (result.status, target.exists()) == (0, True)
    result = msb("repair", "-q", "-f", book, "-o", target, "--fail-on-verdict", "limited", status=1)
    assert result.err.startswith(f"GATE_FAILED: {target}: verdict is LIMITED (open")
    result = msb(
        "repair -q -f", book, "-o", target, "--plan", "orient", "--fail-on", "nonmanifold_edges>0", status=1
    )


@pytest.mark.slow
def test_pixels_weigh_what_debris_removes(msb: Msb, tmp_path: Path) -> None:
    views = ROOT / "data_stubs" / "views.json"
    line = ["repair", CHECKPOINT, "--plan", "debris:0:0.001"]
    for name, more in (("area", []), ("seen", ["--cameras", views])):
        msb(*line, "-o", tmp_path / f"{name}.triasset", "--json", tmp_path / f"{name}.json", *more, status=0)
    removed = [
        json.loads((tmp_path / f"{name}.json").read_text())["steps"][0]["faces_removed"]
        for name in ("area", "seen")
    ]
    assert 0 < removed[0] != removed[1] > 0


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("repair a.ply", "OUT is missing"),
        ("repair a.ply b.ply -o c.ply", "--out names OUT a second time"),
        ("repair a.ply -o b.txt", 'OUT is "b.txt"; it must end in one of'),
        ("repair a.ply -o b.ply --plan orient,polish", 'there is no step "polish"; there are orient, pair'),
        (
            "repair a.ply -o b.ply --plan close:few",
            'close_edges of the plan is "few"; it must be a whole number',
        ),
        (
            "repair a.ply -o b.ply --plan weld:-1",
            '--plan: the weld is "-1"; it must be exact or a positive length',
        ),
        ("repair a.ply -o b.ply --plan orient:5", '"orient:5" has too many numbers; it may be orient'),
        ("repair a.ply -o b.ply --maps c.csv", '--maps is "c.csv"; it must end in .npz'),
        ("repair a.ply -o b.ply --cameras v.json", "--cameras weigh faces for debris and drop"),
        ("repair a.ply -o b.ply --with igl --plan drop", "igl can do cut, and the plan is drop"),
        ("repair --compare a.ply --fail-on components>1", "--fail-on does not go with --compare"),
        ("repair a.ply -o b.ply --task uv", "--task goes with --compare"),
        ("repair --compare a.ply --task uvs", 'there is no task "uvs"'),
    ],
)
def test_what_would_be_ignored_is_refused(refused: Refused, line: str, text: str) -> None:
    assert text in refused(line)


def test_a_vertex_that_is_not_finite_is_named(msb: Msb, tmp_path: Path) -> None:
    source = tmp_path / "a.off"
    source.write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 nan 0\n3 0 1 2\n")
    msb("repair", source, "-o", tmp_path / "b.ply").ends(3, f"MESH_NONFINITE: {source}: vertex 2 is")
    assert not (tmp_path / "b.ply").exists()


@pytest.mark.slow
def test_compare_shows_what_each_way_costs_with_pictures(msb: Msb, tmp_path: Path) -> None:
    model = ROOT / "tests" / "tiny" / "models" / "walled" / "mesh_splatting"
    task = ("--task", "intersections")
    result = msb(
        "repair --compare", *task, model, "-o", tmp_path / "costs", "--json", tmp_path / "c.json", status=0
    )
    assert "PSNR in dB against the asset as stored, the mean over 8 views from inside: " in result.out
    data = json.loads((tmp_path / "c.json").read_text())
    assert data["schema"] == "msb.repair_compare/1"
    rows = {row["strategy"]: row for row in data["strategies"]}
    assert rows["as stored"]["looks"]["dedicated"]["same"]
    assert rows["orient,pair"]["faces_kept"] == 624
    assert rows["orient,pair"]["trials"] == {"self_intersections": "works"}
    assert (rows["drop,orient"]["trials_passed_before"], rows["drop,orient"]["trials_passed_after"]) == (1, 1)
    done = [row for row in rows.values() if row["why"] is None]
    assert len(list((tmp_path / "costs").glob("*.png"))) == len(done) - 1


@pytest.mark.parametrize(
    ("width", "lost"), [(108, []), (101, []), (90, []), (85, ["MB"]), (80, ["MB", "Added"])]
)
def test_a_terminal_gets_as_much_of_the_comparison_as_it_is_wide(width: int, lost: list[str]) -> None:
    row = ["orient,pair,debris", "100.0 %", "0", "0", "852", "0.65"]
    row += ["LIMITED", "-", "same", "-", "0.10", "0.0"]
    console = WholeWordConsole(file=io.StringIO(), width=width)
    print_table([row, ["cut by igl", *[""] * 5, "not done"]], console)
    text = console.file.getvalue()
    assert max(len(line.rstrip()) for line in text.splitlines()) <= width
    names = text.splitlines()[0].split()
    assert ("Tasks" in names, "Dedicated" in names) == (width >= 108, width >= 101)
    assert set(lost).isdisjoint(names)
    assert ("also show" in text) == bool(lost)
    assert text.splitlines()[1].split()[:3] == ["orient,pair,debris", "100.0", "%"]


@pytest.mark.slow
def test_compare_says_which_tier_is_not_drawn_and_that_a_plan_would_leave_nothing(
    msb: Msb, tmp_path: Path
) -> None:
    source = tmp_path / "one.obj"
    source.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    result = msb("repair", "--compare", "--task", "none", source, status=0)
    lines = result.out.splitlines()
    assert "Dedicated: not drawn: it has static colours only, no appearance of its own to draw" in lines
    assert not any(line.startswith("not drawn") for line in lines)
    plan = "orient,pair,debris"
    assert f"{plan}: TRIASSET_EMPTY: the plan {plan} would remove every piece" in lines


@pytest.mark.parametrize("suffix", [".ply", ".glb", ".triasset"])
def test_a_plan_that_would_leave_nothing_is_refused_in_every_format(
    here: Here, book: Path, suffix: str
) -> None:
    target = book.with_name(f"none{suffix}")
    here("repair", book, "--plan", "debris", target).ends(
        3, f"TRIASSET_EMPTY: {book}: the plan debris would remove every piece"
    )
    assert not target.exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a full disk is played by Linux")
@pytest.mark.parametrize("suffix", [".ply", ".triasset"])
def test_out_and_maps_are_both_written_or_neither(here: Here, book: Path, suffix: str) -> None:
    target, maps = book.with_name(f"out{suffix}"), book.with_name("maps.npz")
    maps.symlink_to("/dev/full")
    here("repair", "-q", "--maps", maps, book, target).ends(3, f"OUTPUT_UNWRITABLE: {maps}: ")
    maps.unlink()
    assert list(book.parent.iterdir()) == [book]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("msb.base.npz.write_npz", _on_a_full_disk)
        here("repair", "-q", "--maps", maps, book, target).ends(3, f"OUTPUT_UNWRITABLE: {maps}: ")
    assert list(book.parent.iterdir()) == [book]
    target.symlink_to("/dev/full")
    assert here("repair", "--maps", maps, book, target).status == 3
    assert not maps.exists()
    target.unlink()
    assert here("repair", "--maps", maps, book, target).status == 0
    assert {maps, target} <= set(book.parent.iterdir())


def _on_a_full_disk(*_: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_what_is_said_of_a_repaired_file_with_seams_is_what_it_holds(msb: Msb, tmp_path: Path) -> None:
    source, target = tmp_path / "a.triasset", tmp_path / "a.glb"
    library.save(asset_from_mesh(textured_cube("corner", slice(0, 11))), source)
    said = msb("repair", "--plan", "close", source, "-o", target, "--json", "-")
    file = msb("audit", target, "--json", "-").json
    assert said.json["verdict_after"] == file["verdict"]
    assert said.json["after"] == {key: file[key] for key in ("counts", "metrics")}
    assert (file["verdict"]["level"], file["counts"]["vertices"]) == ("ok", 24)
    assert file["without_seams"]["counts"]["vertices"] == 8
    assert "colours of faces" not in said.err


def test_uvs_without_a_texture_are_kept_and_tell_seams(msb: Msb, tmp_path: Path) -> None:
    source, target = tmp_path / "a.glb", tmp_path / "b.glb"
    mesh = replace(textured_cube("vertex"), textures=())
    with source.open("wb") as file:
        write_mesh(mesh, file, suffix=".glb")
    result = msb("repair", source, "-o", target)
    assert f"{target}: OK; {source} was OK" in result.out
    assert "UVs" not in result.err
    again = read_mesh(target)
    assert np.array_equal(again.vertex_uvs, mesh.vertex_uvs)
    assert msb("audit", "-q", target).out.endswith("16 vertices are doubled at texture seams.\n")
