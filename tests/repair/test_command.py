"""`msb repair`: its files, JSON and messages, and the arguments that it rejects."""

import errno
import io
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

import msb as library
from msb.meshes import Mesh, read_mesh, write_mesh
from msb.meshes.assets import asset_from_mesh
from msb.repair.assets import repair_asset
from msb.repair.command import print_table, recommend
from msb.repair.plan import parse_plan
from tests.cli.conftest import Here, here, mesh_file
from tests.conftest import BOOK, ROOT, TETRAHEDRON
from tests.topology.seamed import textured_cube

__all__ = ["here"]  # fixture
CHECKPOINT = ROOT / "data_stubs" / "checkpoint"


@pytest.fixture
def book(tmp_path: Path) -> Path:
    """Write a mesh file of three triangles at one edge, in double precision."""
    return mesh_file(tmp_path / "book.ply", BOOK[0].astype(np.float64) / 3, BOOK[1])


@pytest.mark.slow
def test_a_checkpoint_becomes_a_repaired_asset_with_its_maps(here: Here, tmp_path: Path) -> None:
    target, maps = tmp_path / "new" / "a.triasset", tmp_path / "maps.npz"
    result = here("repair", CHECKPOINT, "-o", target, "--maps", maps, "--json", "-")
    assert result.status == 0, result
    data = result.json
    assert data["schema"] == "msb.repair/1"
    keys = {"path", "output", "plan", "steps", "before", "after", "verdict_before", "verdict_after"}
    assert keys <= data.keys()
    assert {"step", "faces_removed", "faces_added", "vertices_added", "seconds"} <= data["steps"][0].keys()
    assert (data["verdict_before"]["level"], data["verdict_after"]["level"]) == ("bad", "limited")
    assert data["after"]["counts"]["nonmanifold_vertices"] == 0
    original, repaired = library.open(CHECKPOINT), library.load(target)
    assert repaired.manifest.method == "mesh_splatting"
    with np.load(maps) as stored:
        assert stored["vertex"].dtype == stored["face"].dtype == np.int64
        assert np.array_equal(original.buffers["f_rest"][stored["vertex"]], repaired.buffers["f_rest"])
        assert len(stored["face"]) == len(stored["turned"]) == repaired.manifest.face_count


def test_losses_of_a_format_are_noted(here: Here, tmp_path: Path) -> None:
    source = tmp_path / "one.obj"
    source.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n")
    assert "UVs" in here("repair", source, "-o", tmp_path / "b.glb").err
    assert "SH degree 1" in here("repair", CHECKPOINT, "-o", tmp_path / "c.glb").err
    assert "c.stl: " in here("repair", CHECKPOINT, "-o", tmp_path / "c.stl").err


def test_the_last_line_names_the_step_that_helps(here: Here, tmp_path: Path) -> None:
    points, faces = TETRAHEDRON
    points = np.concatenate([points, points[faces[0]]])  # the first face has separate vertices
    faces = np.concatenate([[[4, 5, 6]], faces[1:]])
    target = tmp_path / "out.ply"
    printed = here("repair", mesh_file(tmp_path / "a torn.ply", points, faces), "-o", target).out
    assert '"weld"' in printed
    assert '"close"' not in printed
    words = printed.splitlines()[-1].partition(": msb ")[2].split()
    assert words[-1] == "weld,orient,pair"
    welded = here(*words)
    assert "OK; " in welded.out
    assert "--plan" not in welded.out


def audited_after_repair(here: Here, *words: object) -> dict[str, Any]:
    """Repair a mesh.

    Check that the reported audit equals the audit of the file, and return the audit of the file.
    """
    report = here("repair", *words, "--json", "-").json
    file: dict[str, Any] = here("audit", words[-1], "--json", "-").json
    assert report["verdict_after"] == file["verdict"]
    assert report["after"] == {key: file[key] for key in ("counts", "metrics")}
    return file


def test_a_file_with_seams_is_audited_with_and_without_seams(here: Here, tmp_path: Path) -> None:
    source, target = tmp_path / "a.triasset", tmp_path / "a.glb"
    library.save(asset_from_mesh(textured_cube("corner", slice(0, 11))), source)
    file = audited_after_repair(here, "--plan", "close", source, "-o", target)
    assert (file["verdict"]["level"], file["counts"]["vertices"]) == ("ok", 24)
    assert file["without_seams"]["counts"]["vertices"] == 8


@pytest.mark.parametrize("suffix", [".glb", ".ply", ".obj", ".off", ".stl", ".triasset"])
def test_the_verdict_after_a_repair_equals_the_audit_of_the_file(
    here: Here, tmp_path: Path, suffix: str
) -> None:
    model, target = ROOT / "data_stubs" / "models" / "walled" / "triangle_splatting", tmp_path / f"a{suffix}"
    weld = ("--plan", "weld:0.02,orient,pair")
    file = audited_after_repair(here, *weld, model, "-o", target)
    split = suffix in (".glb", ".obj", ".stl")  # vertices are split, because faces differ in colour
    assert file["verdict"]["level"] == ("bad" if split else "limited")
    gated = here("repair", "-f", *weld, model, "-o", target, "--fail-on-verdict", "bad")
    assert gated.status == split
    assert "--plan weld" not in gated.out


def test_a_mesh_file_keeps_its_precision_and_the_original_stays(here: Here, book: Path) -> None:
    before = book.read_bytes()
    target, again = book.with_name("fixed.ply"), book.with_name("again.ply")
    assert here("repair", book, target).status == 0  # OUT as an argument, like convert and export
    assert read_mesh(target).vertices.dtype == np.float64
    assert book.read_bytes() == before
    assert here("repair", target, "-o", again).status == 0
    assert again.read_bytes() == target.read_bytes()
    here("repair", book, "-o", target).ends(2, f"OUTPUT_EXISTS: {target}")


def test_gates_judge_the_result_and_the_file_is_written(here: Here, book: Path) -> None:
    target = book.with_name("fixed.ply")
    line = ("repair", "-q", "-f", book, "-o", target)
    assert here(*line, "--fail-on", "nonmanifold_edges>0").status == 0
    assert target.exists()
    for gate in (["--fail-on-verdict", "limited"], ["--plan", "orient", "--fail-on", "nonmanifold_edges>0"]):
        result = here(*line, *gate)
        assert (result.status, result.err.split(":")[0]) == (1, "GATE_FAILED")


@pytest.mark.slow
def test_debris_uses_pixels_as_weights(here: Here, tmp_path: Path) -> None:
    line = ["repair", CHECKPOINT, "--plan", "debris:0:0.001", "--json", "-"]
    views = ["--cameras", ROOT / "data_stubs" / "views.json"]
    removed = [
        here(*line, "-o", tmp_path / f"{len(more)}.triasset", *more).json["steps"][0]["faces_removed"]
        for more in ([], views)
    ]
    assert 0 < removed[0] != removed[1] > 0


@pytest.mark.parametrize(
    "line",
    [
        "a.ply",
        "a.ply b.ply -o c.ply",
        "a.ply -o b.txt",
        "a.ply -o b.ply --maps c.csv",
        "a.ply -o b.ply --cameras v.json",
        "--compare a.ply --fail-on components>1",
        "a.ply -o b.ply --task uv",
    ],
)
def test_arguments_without_effect_are_rejected(here: Here, line: str) -> None:
    here("repair", *line.split()).ends(2, "USAGE: ")


@pytest.mark.slow
def test_compare_reports_costs_and_writes_images(here: Here, tmp_path: Path) -> None:
    pytest.importorskip("msb.trial")
    model = ROOT / "tests" / "tiny" / "models" / "walled" / "mesh_splatting"
    line = ("repair", "--compare", "--task", "intersections", "--json", "-", model, "-o", tmp_path / "costs")
    data = here(*line).json
    assert data["schema"] == "msb.repair_compare/1"
    rows = {row["strategy"]: row for row in data["strategies"]}
    assert rows["as stored"]["looks"]["dedicated"]["same"]
    assert rows["orient,pair"]["faces_kept"] == 624
    assert rows["orient,pair"]["trials"] == {"self_intersections": "works"}
    assert (rows["drop,orient"]["trials_passed_before"], rows["drop,orient"]["trials_passed_after"]) == (1, 1)
    done = [row for row in rows.values() if row["why"] is None]
    assert len(list((tmp_path / "costs").glob("*.png"))) == len(done) - 1


@pytest.mark.slow
def test_compare_continues_if_a_plan_fails(here: Here, tmp_path: Path) -> None:
    pytest.importorskip("msb.trial")
    source = tmp_path / "one.obj"
    source.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    here("repair", "--compare", "--task", "uvs", source).ends(2, "USAGE: ")
    rows = here("repair", "--compare", "--task", "none", "--json", "-", source).json["strategies"]
    why = {row["strategy"]: row["why"] for row in rows}
    assert why["orient,pair,debris"].startswith("TRIASSET_EMPTY")
    assert why["orient,pair"] is None
    assert all(row["looks"]["dedicated"]["why"] for row in rows if "looks" in row), "it has no method"


def test_a_comparison_recommends_one_of_its_rows() -> None:
    points, faces = TETRAHEDRON
    torn = np.concatenate([points, points[faces[0]]]), np.concatenate([[[4, 5, 6]], faces[1:]])
    asset = asset_from_mesh(Mesh(*torn))
    pytest.importorskip("msb.trial")
    from msb.trial.repairs import StrategyResult, TierLikeness

    looks = {"standard": TierLikeness(None, same=True)}
    rows = []
    for plan in ("orient,pair", "orient,pair,close", "weld,orient,pair", "drop,orient"):
        done = repair_asset(asset, parse_plan(plan))
        before = done.before
        if not rows:
            rows.append(StrategyResult("as stored", before=before, after=before, looks=looks))
        rows.append(StrategyResult(plan, before=before, after=done.after, looks=looks))
    rows.append(StrategyResult("cut by igl", why="it failed"))
    assert [row.after.verdict for row in rows[:-1]] == [*["limited"] * 3, "ok", "limited"]
    assert recommend(rows).startswith("Recommended: weld,orient,pair (")
    assert recommend(rows[:1]).startswith("Recommended: as stored (")
    assert recommend(rows[-1:]) == ""
    rows[3] = replace(rows[3], faces_kept=2, looks={"standard": TierLikeness(25.0)})
    assert not recommend(rows).startswith("Recommended: weld,orient,pair ("), "half of the faces are lost"


@pytest.mark.parametrize(
    ("width", "lost"), [(108, set()), (101, set()), (90, set()), (85, {"MB"}), (80, {"MB", "Added"})]
)
def test_columns_are_omitted_on_narrow_terminals(width: int, lost: set[str]) -> None:
    row = ["orient,pair,debris", "100.0 %", "0", "0", "852", "0.65"]
    row += ["LIMITED", "-", "same", "-", "0.10", "0.0"]
    console = Console(file=io.StringIO(), width=width)
    print_table([row, ["cut by igl", *[""] * 5, "not done"]], console)
    lines = console.file.getvalue().splitlines()
    assert max(len(line.rstrip()) for line in lines) <= width
    names = lines[0].split()
    assert ("Tasks" in names, "Dedicated" in names) == (width >= 108, width >= 101)
    assert lost.isdisjoint(names)


@pytest.mark.skipif(
    not Path("/dev/full").exists(), reason="only Linux has /dev/full, which simulates a full disk"
)
@pytest.mark.parametrize("suffix", [".ply", ".triasset"])
def test_out_and_maps_are_written_together_or_not_at_all(here: Here, book: Path, suffix: str) -> None:
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


def test_uvs_without_a_texture_are_kept_and_define_seams(here: Here, tmp_path: Path) -> None:
    source, target = tmp_path / "a.glb", tmp_path / "b.glb"
    mesh = replace(textured_cube("vertex"), textures=())
    with source.open("wb") as file:
        write_mesh(mesh, file, suffix=".glb")
    result = here("repair", source, "-o", target)
    assert (result.status, "UVs" in result.err) == (0, False)
    assert np.array_equal(read_mesh(target).vertex_uvs, mesh.vertex_uvs)
    file = here("audit", target, "--json", "-").json
    assert (file["verdict"]["level"], file["without_seams"]["counts"]["vertices"]) == ("ok", 8)


@pytest.mark.parametrize(
    ("words", "instead"),
    [
        (["--weld", "0.02"], "--plan weld:0.02"),
        (["--weld=exact"], "--plan weld:exact"),
        (["--close"], "--plan close"),
        (["--orient", "out.ply"], "--plan orient"),
    ],
)
def test_a_step_given_as_an_option_is_shown_as_a_plan(here: Here, words: list[str], instead: str) -> None:
    result = here("repair", "data_stubs/checkpoint", *words)
    result.ends(2, "USAGE: ")
    assert f"{instead}?" in result.err
