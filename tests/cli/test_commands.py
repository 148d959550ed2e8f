"""The other commands, and what holds for all of them."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import msb as library
from msb.asset.texture import Sampler
from msb.cli.app import GROUPS
from msb.errors import explained_codes
from msb.meshes import Mesh, read_mesh
from msb.meshes.assets import asset_from_mesh
from tests.cli.conftest import Here, Msb, Refused
from tests.conftest import ROOT

COMMANDS = (*(name for entries in GROUPS.values() for name in entries), "config show")


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_has_usage_examples_and_fits_80_columns(msb: Msb, command: str) -> None:
    result = msb(*command.split(), "--help", status=0)
    assert result.err == ""
    assert result.out.startswith("Usage: ")
    assert "Examples:" in result.out
    assert "Exit status: 0 done" in result.out
    assert max(map(len, result.out.splitlines())) <= 80
    assert result.out == msb(*command.split(), "-h").out


def test_no_command_shows_the_list_under_headings(msb: Msb) -> None:
    alone = msb()
    assert (alone.status, alone.err) == (0, "")
    assert alone.out == msb("--help").out
    listed = re.findall(r"^  ([a-z-]+)  +[A-Z]", alone.out, re.MULTILINE)
    assert {*listed} == {name for name in COMMANDS if " " not in name} | {"--version"}
    assert "completion" not in alone.out.partition("Look at a mesh")[0]
    headings = ("Look at a mesh:", "Take a model out:", "Draw:", "Benchmark:", "Machine:")
    places = [alone.out.index(heading) for heading in headings]
    assert places == sorted(places)
    assert "..." not in alone.out.replace("[ARGS]...", "")


@pytest.mark.parametrize("command", ["audit", "convert", "export", "trial"])
def test_help_names_arguments_without_braces_and_breaks_no_word(msb: Msb, command: str) -> None:
    text = msb(command, "--help").out
    assert "{" not in text
    assert not re.search(r"\w-$", text, re.MULTILINE)
    assert "<path>" not in text


def test_version_is_one_line(msb: Msb) -> None:
    result = msb("--version", status=0)
    assert re.fullmatch(r"msb \d+\.\d+\.\d+ \(triasset 1\.1, numpy \S+, pyopencl \S+\)\n", result.out)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("audit", "PATH is missing"),
        ("validate", "PATH is missing"),
        ("info", "usage: msb "),
        ("convert a.ply", "usage: msb "),
        ("nonsense", "usage: msb "),
        ("audit --jsn x", "did you mean --json?"),
        ("rendr", "Did you mean 'render'?"),
        ("audit --profile foo x", "Invalid value for '--profile': 'foo' is not one of 'game', 'print'"),
        ("compare --scale x y", "Invalid value for '--scale': it is \"x\"; it must be a valid number (usage"),
        ("run -j 0 y", 'it is "0"; it must be greater than or equal to 1 (usage'),
        ("render --flight 0 --cameras v -o o y", "'--flight': it is \"0\"; it must be greater than"),
        ("compare --scale 0 --cameras v y", "the factor of --scale is 0; it must be above 0"),
        ("scenes --rules x y", "--rules: there are no rules 'x'; there are ours"),
        ("scenes -r 0 y", "--resolution: the resolution is 0; it must be 1, 2, 4 or 8"),
        (
            "bench --size 100000x100000 data_stubs/splat_like.triasset",
            "--size is 100000x100000; it must be from 1 to 65535 each way",
        ),
        ("audit --weld -1 y", '--weld: the weld is "-1"; it must be exact or a positive length'),
        ("trial --weld -1 y", '--weld: the weld is "-1"'),
        ("web --at-least 0 -o a.html y", "--at-least needs --verify PAGE"),
        ("render --flight 1 --turntable 1 -o o y", "--flight does not go with --turntable"),
        ("scenes --image-folder '' y", "--image-folder is empty, which names nothing"),
        ("render --name '' --turntable 1 -o o y", "--name is empty, which names nothing"),
        ("render --renderer '' --turntable 1 -o o y", "--renderer is empty, which names nothing"),
        ("render --fps 30 --turntable 1 -o o y", "--fps goes with --film FILE"),
        ("bench --seconds inf y", 'it is "inf"; it must be less than or equal to 86400'),
        (
            "convert --texture jpeg data_stubs/checkpoint a.ply",
            "--texture is for formats with textures; .ply",
        ),
        ("convert --color srgb data_stubs/checkpoint a.stl", "--color is for formats with colours; .stl"),
        ("validate --explain all y", "--explain stands alone, without PATH"),
        ("audit --explain faces y", "--explain stands alone, without PATH"),
        ("completion", "Missing argument 'SHELL'. Choose from: bash, zsh, fish, powershell (usage"),
    ],
)
def test_wrong_usage_is_one_line_that_says_what_was_meant(msb: Msb, line: str, said: str) -> None:
    result = msb(line)
    result.ends(2, "USAGE: ")
    assert said in result.err


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("web --verify p.html --up +z", "--up does not go with --verify"),
        ("web --verify p.html --set gamma=1", "--set does not go with --verify"),
        ("web --verify p.html --background white", "--background does not go with --verify"),
        ("web --verify p.html --tier standard", "--tier does not go with --verify"),
        ("render --turntable 2 --film a.gif --format npy y", "--format needs --out FOLDER"),
        ("render --turntable 2 --film a.gif --name {index} y", "--name needs --out FOLDER"),
        ("report --paper --table mesh_connectivity -o OUT", "--out does not go with --table"),
        ("report --allow-mixed -o OUT a.zip", "--allow-mixed does not go with submissions"),
        ("audit --version y", "--version stands alone, without PATH"),
        ("audit --version --fail-on faces>1", "--fail-on does not go with --version"),
        ("audit --version --explain faces", "--explain does not go with --version"),
        ("audit --explain faces --profile game", "--profile does not go with --explain"),
        ("audit --explain faces --fail-on-verdict bad", "--fail-on-verdict does not go with --explain"),
    ],
)
def test_an_option_that_would_change_nothing_is_refused(refused: Refused, line: str, said: str) -> None:
    assert refused(line).startswith(f"USAGE: {said}")


@pytest.mark.parametrize(
    ("line", "status", "said"),
    [
        ("scenes README.md", 3, "FILE_UNREADABLE: README.md: it is no folder"),
        ("convert NEW.obj NEW.glb", 3, "vertex 1 is not finite"),
        (
            "run -o README.md data_stubs/protocol.toml",
            3,
            "README.md: it is a file, or lies in one; results need",
        ),
        (
            "trial --task solid --force --save . NEW.triasset",
            2,
            ".: ASSET lies in it; an output needs a place of its own",
        ),
        (
            "bake --seconds inf -o NEW.glb data_stubs/checkpoint",
            2,
            "seconds is inf; it must be a finite number, 0 or more",
        ),
    ],
)
def test_the_reason_that_is_said_is_the_true_one(
    here: Here, tmp_path: Path, line: str, status: int, said: str
) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n")
    line = line.replace("NEW.triasset", "data_stubs/splat_like.triasset").replace("NEW", str(tmp_path / "a"))
    result = here(*line.split())
    assert (result.status, said in result.err) == (status, True), result


@pytest.mark.slow
def test_info_shows_counts_settings_and_buffers(msb: Msb, demo_asset: Path) -> None:
    text = msb("info", demo_asset).out
    for part in ("mesh_splatting", "17,919 vertices", "34,761 faces", "sigma = 0.0001", "17919 x 3"):
        assert part in text
    data = msb("info", "--json", "-", demo_asset).json
    assert data["manifest"]["face_count"] == 34761
    assert data["schema"] == "msb.info/1"


def test_info_says_what_textures_there_are_and_how_they_are_read(msb: Msb, tmp_path: Path) -> None:
    images = (np.zeros((4, 8, 3), np.uint8), np.zeros((2, 2, 4), np.uint8), np.zeros((4, 8, 3), np.uint8))
    sampler = Sampler("nearest", mipmaps=False, wrap_v="clamp", alpha_cutoff=0.5)
    faces, shown = np.zeros((1, 3), np.int64), np.zeros(1, np.uint32)
    points = np.zeros((3, 3), np.float32)
    mesh = Mesh(
        points, faces, vertex_uvs=points[:, :2], textures=images, face_textures=shown, sampler=sampler
    )
    library.save(asset_from_mesh(mesh), tmp_path / "a.triasset")
    text = " ".join(msb("info", tmp_path / "a.triasset").out.split())
    look = "nearest, no mip maps, repeat along u, clamp along v, nothing where alpha is below 0.5"
    assert f"textures 2 of 8 x 4, 2 x 2; {look} coverage" in text
    assert "opaque_unlit_texture" in text
    data = msb("info", "--json", "-", tmp_path / "a.triasset").json
    assert data["textures"][1] == {"name": "texture.1", "width": 2, "height": 2, "channels": 4}
    assert data["manifest"]["appearance"]["alpha_cutoff"] == 0.5


def test_validate_good_asset(msb: Msb, demo_asset: Path) -> None:
    data = msb("validate --json -", demo_asset, status=0).json
    about = {"schema": "msb.validate/1", "path": str(demo_asset), "tool_version": library.__version__}
    assert data == {**about, "valid": True, "findings": [], "truncated": False}


@pytest.mark.slow
def test_validate_shows_errors_first_and_not_endlessly(msb: Msb, demo_asset: Path, tmp_path: Path) -> None:
    path = tmp_path / "many.triasset"
    library.save(library.load(demo_asset), path, form="folder")
    manifest = json.loads((path / "manifest.json").read_text())
    manifest |= {f"key{number}": 0 for number in range(2000)} | {"sh_degree": 7}
    (path / "manifest.json").write_text(json.dumps(manifest))
    report = msb("validate", "--json", "-", path).json
    assert report["truncated"]
    assert len(report["findings"]) == 1000
    assert report["findings"][0]["code"] == "TRIASSET_FIELD"
    text = msb("validate", path).out
    assert "1 error, 2000 warnings" in text
    assert len(text.splitlines()) < 200


@pytest.mark.slow
def test_validate_reports_all_errors_with_code_and_pointer(
    msb: Msb, demo_asset: Path, tmp_path: Path
) -> None:
    path = tmp_path / "bad.triasset"
    library.save(library.load(demo_asset), path, form="folder")
    positions = np.fromfile(path / "buffers" / "positions.bin", "<f4")
    positions[4] = np.nan
    positions.tofile(path / "buffers" / "positions.bin")
    result = msb("validate", "--json", "-", path, status=1)
    found = {item["code"]: item for item in result.json["findings"]}
    assert not result.json["valid"]
    assert found["TRIASSET_DAMAGED"]["pointer"] == "/buffers/positions/sha256"
    assert found["TRIASSET_VALUE_NONFINITE"]["severity"] == "error"
    assert "TRIASSET_VALUE_NONFINITE" in msb("validate", path).out


def test_validate_degenerate_faces_are_infos_and_status_0(msb: Msb, tmp_path: Path) -> None:
    mesh = tmp_path / "m.off"
    mesh.write_text("OFF\n5 4 0\n0 0 0\n1 0 0\n0 1 0\n2 0 0\n9 9 9\n3 0 1 2\n3 2 1 0\n3 0 1 3\n3 0 0 1\n")
    result = msb("validate", "--json", "-", mesh, status=0)
    assert {(item["code"], item["value"]) for item in result.json["findings"]} == {
        ("TRIASSET_FACE_DUPLICATE", 1),
        ("TRIASSET_FACE_REPEATED_INDEX", 1),
        ("TRIASSET_FACE_ZERO_AREA", 1),
        ("TRIASSET_VERTEX_UNREFERENCED", 1),
    }
    assert {item["severity"] for item in result.json["findings"]} == {"info"}


def test_validate_explains_a_code(msb: Msb) -> None:
    result = msb("validate", "--explain", "triasset_damaged", status=0)
    assert "Copy the asset again" in result.out
    assert "did you mean TRIASSET_DAMAGED" in msb("validate", "--explain", "TRIASSET_DAMAGE").err
    every = msb("validate", "--explain", "all", "--json", "-").json
    assert [item["code"] for item in every] == list(explained_codes())


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".stl", ".glb"])
def test_convert_keeps_rows_order_and_colours(
    msb: Msb, demo_asset: Path, tmp_path: Path, suffix: str
) -> None:
    target = tmp_path / "new" / f"demo{suffix}"
    result = msb("convert", demo_asset, target, status=0)
    asset, mesh = library.load(demo_asset), read_mesh(target)
    corners = asset.buffers["positions"][asset.buffers["indices"]]
    assert np.array_equal(mesh.vertices[mesh.faces].astype(np.float32), corners)
    assert result.out.startswith(f"{target}: ")
    assert f"{len(mesh.vertices):,} vertices, {len(mesh.faces):,} faces" in result.out
    assert "left out: opacity" in result.err
    if suffix == ".stl":
        assert "colours, which .stl has no place for" in result.err
        return
    assert np.array_equal(mesh.faces, asset.buffers["indices"])
    colors = mesh.vertex_colors / (255 if mesh.vertex_colors.dtype == np.uint8 else 1)
    expected = np.clip(0.28209479177387814 * asset.buffers["f_dc"] + 0.5, 0, 1)
    assert np.abs(colors[:, :3] - expected).max() <= 0.5 / 255 + 1e-6


@pytest.mark.slow
def test_convert_names_what_it_leaves_out(msb: Msb, tmp_path: Path) -> None:
    (tmp_path / "t.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nusemtl red\nf 1/1/1 2/1/1 3/1/1\n"
    )
    result = msb("convert", tmp_path / "t.obj", tmp_path / "t.glb")
    assert result.out == f"{tmp_path / 't.glb'}: 3 vertices, 1 faces, no colours\n"
    left, up = result.err.splitlines()
    assert left == f"note: {tmp_path / 't.glb'}: left out: normals, UVs, materials and their textures"
    assert up.endswith(
        "what is up is not known, so nothing is turned: msb convert --up=-y if it comes from COLMAP"
    )
    assert "what is up" not in msb("convert", tmp_path / "t.obj", tmp_path / "t.glb", "-f", "--up=+y").err
    assert "what is up" not in msb("convert", tmp_path / "t.obj", tmp_path / "t.ply").err
    assert (
        "taken to be +y; --up says otherwise" in msb("web", tmp_path / "t.obj", "-o", tmp_path / "t.html").err
    )
    assert "up unknown, drawn as +y" in msb("info", tmp_path / "t.obj").out
    assert "MESH_FILE_LEFT_OUT" in msb("convert", tmp_path / "t.obj", tmp_path / "t.triasset").err
    assert "UVs" not in msb("audit", tmp_path / "t.obj").err


@pytest.mark.slow
def test_a_training_on_colmap_is_turned_upright_and_the_page_and_info_agree(msb: Msb, tmp_path: Path) -> None:
    model, target = ROOT / "data_stubs" / "models" / "walled" / "mesh_splatting", tmp_path / "m.glb"
    assert msb("convert", model, target).out.endswith("vertex colours, turned upright (-y was up)\n")
    assert "-y is up in it, which .ply cannot say" in msb("convert", model, tmp_path / "m.ply").err
    assert "right-handed, up +y" in msb("info", target).out
    assert "right-handed, up -y" in msb("info", model).out
    assert "what is up" not in msb("web", model, "-o", tmp_path / "m.html").err
    kept = msb("convert", model, tmp_path / "kept.glb", "--up=+y")
    assert "turned" not in kept.out + kept.err
    stored = library.open(model).buffers["positions"]
    assert np.array_equal(library.open(tmp_path / "kept.glb").buffers["positions"], stored)
    assert np.array_equal(library.open(target).buffers["positions"], stored * [1, -1, -1])


def test_a_training_of_which_it_is_not_known_what_is_up_is_written_as_the_page_shows_it(
    msb: Msb, tmp_path: Path
) -> None:
    shutil.copytree(ROOT / "data_stubs" / "models" / "walled" / "triangle_splatting", tmp_path / "bare")
    (tmp_path / "bare" / "cfg_args").unlink()
    taken = "what is up is not known and taken to be -y"
    assert taken in msb("convert", tmp_path / "bare", tmp_path / "b.glb").err
    assert taken in msb("web", tmp_path / "bare", "-o", tmp_path / "b.html").err
    stored = library.open(tmp_path / "bare").buffers["positions"]
    assert np.array_equal(library.open(tmp_path / "b.glb").buffers["positions"], stored * [1, -1, -1])


def test_convert_takes_a_folder(msb: Msb, tmp_path: Path) -> None:
    source = ROOT / "data_stubs" / "models" / "pebble"
    result = msb("convert", "--to", "ply", source, tmp_path / "out", status=4)
    assert "diffsoup" in result.err
    made = {path.name for path in (tmp_path / "out").iterdir()}
    assert made == {f"{name}.ply" for name in ("mesh_splatting", "triangle_splatting", "two_dts")}
    msb("convert", source, tmp_path / "out.ply", status=2)
    msb("convert", "--to", "exe", source, tmp_path / "new").ends(
        2, 'USAGE: an output is "diffsoup.exe"; it must end in'
    )
    msb("convert", "--to", "ply", source / "two_dts", tmp_path / "a.ply", status=2)


def test_export_guesses_the_name_of_its_output(msb: Msb, tmp_path: Path) -> None:
    source = ROOT / "data_stubs" / "models" / "pebble" / "two_dts"
    result = msb("export", "-q", source, cwd=tmp_path)
    assert (result.status, [path.name for path in tmp_path.iterdir()]) == (0, ["two_dts.triasset"])
    msb("export", "-q", source, cwd=tmp_path, status=2)


def test_info_reads_meshes_and_checkpoints(msb: Msb) -> None:
    for path in ("tests/golden/meshes/synthetic_splat_small.ply", "data_stubs/checkpoint"):
        found = msb("info", "--json", "-", ROOT / path)
        assert found.json["manifest"]["face_count"] > 0
        assert "not yet one" in " ".join(msb("info", path).out.split())  # wherever the line breaks


def test_which_checkpoint_in_a_folder_is_taken_is_said(msb: Msb, tmp_path: Path) -> None:
    place = ROOT / "data_stubs"
    note = f"note: {place}: the checkpoint in it is taken, {place / 'checkpoint'}"
    for command in ("info", "export"):
        result = msb(command, place, cwd=tmp_path)
        assert result.err.splitlines() == [note]
        assert "checkpoint" in result.out.splitlines()[0]
    assert (tmp_path / "checkpoint.triasset").exists()
    assert msb("info", place / "checkpoint").err == ""


@pytest.mark.slow
def test_convert_round_trip_through_ply_and_both_forms(msb: Msb, tmp_path: Path) -> None:
    source = ROOT / "tests" / "golden" / "meshes" / "synthetic_splat_small.ply"
    steps = [source, *(tmp_path / name for name in ("a.triasset", "b.triasset", "c.triasset", "d.ply"))]
    options: list[list[str]] = [[], ["--form", "folder"], [], []]
    for before, after, extra in zip(steps[:-1], steps[1:], options, strict=True):
        msb("convert", before, after, *extra, status=0)
    assert (tmp_path / "a.triasset").read_bytes() == (tmp_path / "c.triasset").read_bytes()
    first, last = read_mesh(source), read_mesh(steps[-1])
    assert np.array_equal(first.vertices, last.vertices)
    assert np.array_equal(first.faces, last.faces)
    origin = library.load(tmp_path / "a.triasset").manifest.source.files[0]
    assert (origin.path, origin.byte_length) == (source.name, source.stat().st_size)


@pytest.mark.slow
@pytest.mark.parametrize(("up", "direction"), [("-y", (0, -1, 0)), ("+z", (0, 0, 1)), ("-x", (-1, 0, 0))])
def test_convert_up_turns_the_axis_to_y_without_mirroring(
    msb: Msb, tmp_path: Path, up: str, direction: tuple[int, int, int]
) -> None:
    rows = np.array([direction, (0, 0, 0), (1, 2, 3), (4, 5, 7)], float)
    text = "\n".join(" ".join(map(repr, row)) for row in rows.tolist())
    (tmp_path / "in.off").write_text(f"OFF\n4 2 0\n{text}\n3 0 1 2\n3 1 2 3\n")
    msb("convert", tmp_path / "in.off", tmp_path / "out.obj", f"--up={up}", status=0)
    turned = read_mesh(tmp_path / "out.obj").vertices
    assert turned[0].tolist() == [0, 1, 0]
    assert np.linalg.det(turned[[0, 2, 3]]) == pytest.approx(np.linalg.det(rows[[0, 2, 3]]))


def test_convert_linear_colours(msb: Msb, tmp_path: Path) -> None:
    (tmp_path / "in.off").write_text(
        "COFF\n3 1 0\n0 0 0 255 128 0\n1 0 0 255 128 0\n0 1 0 255 128 0\n3 0 1 2\n"
    )
    msb("convert", "--color", "linear", tmp_path / "in.off", tmp_path / "out.ply", status=0)
    colors = read_mesh(tmp_path / "out.ply").vertex_colors
    assert colors[0, :3] == pytest.approx([1.0, 0.2158605, 0.0], abs=1e-6)


@pytest.mark.slow
def test_convert_for_an_engine(msb: Msb, demo_asset: Path, tmp_path: Path) -> None:
    plain, web = tmp_path / "plain.glb", tmp_path / "web.glb"
    assert msb("convert", demo_asset, plain, "--for", "unreal").status == 0
    made = msb("convert", demo_asset, web, "--for", "web")
    assert made.status == 0
    assert float(re.search(r"([\d.]+) dB of ", made.out)[1]) >= 50
    assert "another order" in made.err
    assert web.stat().st_size < plain.stat().st_size / 2
    assert b"extensionsRequired" not in plain.read_bytes()
    assert b"extensionsRequired" in web.read_bytes()


def test_for_is_for_glb_and_knows_colours_itself(msb: Msb, demo_asset: Path, tmp_path: Path) -> None:
    assert msb("convert", demo_asset, tmp_path / "x.ply", "--for", "web").status == 2
    assert msb("convert", demo_asset, tmp_path / "x.glb", "--for", "web", "--color", "srgb").status == 2


@pytest.mark.slow
def test_convert_refuses_what_makes_no_sense(msb: Msb, demo_asset: Path, tmp_path: Path) -> None:
    msb("convert", demo_asset, tmp_path / "x.xyz", status=2)
    msb("convert", demo_asset, tmp_path / "x.glb", "--form", "folder", status=2)
    msb("convert", demo_asset, tmp_path / "x.triasset", "--up=-y", status=2)
    (tmp_path / "nan.off").write_text("OFF\n3 1 0\nnan 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    msb("convert", tmp_path / "nan.off", tmp_path / "nan.triasset").ends(
        3, f"TRIASSET_VALUE_NONFINITE: {tmp_path / 'nan.off'}: vertex 0 "
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["nan.off"]


@pytest.mark.slow
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish", "powershell"])
def test_completion_prints_a_script_for_both_programs(msb: Msb, shell: str) -> None:
    script = msb("completion", shell, status=0).out
    assert "_MSB_COMPLETE" in script
    assert "_MSB_AUDIT_COMPLETE" in script


def test_completion_script_completes_in_bash(msb: Msb) -> None:
    result = msb(_MSB_COMPLETE="complete_bash", COMP_WORDS="msb va", COMP_CWORD="1")
    assert result.out.split() == ["validate"]


def test_control_characters_in_names_do_not_reach_the_terminal(msb: Msb, tmp_path: Path) -> None:
    result = msb("audit", tmp_path / "a\x1b[31m\nb.ply", status=3)
    assert "\x1b" not in result.err
    assert len(result.err.splitlines()) == 1
