"""Names, one file, placing, the folders for simulators, and the mass properties."""

from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import pytest

import msb
from msb.delivery.hulls import fit_box
from msb.errors import MeshError, UsageError
from msb.lod.collision import make_collision
from msb.lod.options import LodKeywords, LodOptions
from msb.lod.packages import measure_mass
from msb.meshes import read_mesh
from msb.meshes.gltf_scene import read_scene
from tests.cli.conftest import Here
from tests.lod.builders import make_glb, open_glb, root_of


@pytest.fixture
def ball(tmp_path: Path) -> Path:
    path = tmp_path / "ball.glb"
    path.write_bytes(make_glb())
    return path


def test_the_keywords_are_the_options() -> None:
    assert get_type_hints(LodKeywords).keys() == get_type_hints(LodOptions).keys()


@pytest.mark.parametrize("options", [
    {"lods": "0.25,0.5"}, {"lods": "1.5,0.5"}, {"lods": "0.5,0.5"}, {"lods": "many"}, {"lods": [0]},
    {"lods": [2.5]}, {"collision": "hulls"}, {"collision": "sphere"}, {"target": "maya"}, {"scale": 0},
    {"mass": 1}, {"label": "x", "target": "mujoco"}, {"mass": 1, "density": 1, "target": "isaac"},
    {"one_file": True, "target": "isaac"},
])  # fmt: skip
def test_bad_options_are_rejected(options: dict[str, Any]) -> None:
    with pytest.raises(UsageError) as caught:
        LodOptions(**options)
    assert caught.value.code == "USAGE"


def test_more_faces_than_there_are_is_an_error(ball: Path) -> None:
    with pytest.raises(UsageError):
        msb.lod(ball, lods=[100_000])


def test_everything_has_a_name(tmp_path: Path) -> None:
    path = tmp_path / "x.glb"
    plain = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    path.write_bytes(make_glb(materials=plain, nodes=[{"mesh": 0}]))
    made = msb.lod(path, name="chair", lods=[0.5])
    for glb, ending in ((made.glb, ""), (made.levels[0], "_LOD1")):
        root = root_of(glb)
        assert root["nodes"][0]["name"] == "chair" + ending
        assert root["meshes"][0]["name"] == "round" + ending, "a name that exists stays"
        assert root["materials"][0]["name"] == "chair"
        assert [image["name"] for image in root["images"]] == ["chair_0", "chair_1"]


@pytest.mark.parametrize(("target", "names"), [
    ("unreal", {"UCX_ball_00"}), ("godot", {"ball_collision-convcolonly"}), (None, {"ball_collision"}),
])  # fmt: skip
@pytest.mark.slow
def test_collision_has_the_name_that_the_program_looks_for(ball: Path, target: Any, names: set[str]) -> None:
    made = msb.lod(ball, lods="none", collision="box", target=target)
    root = root_of(made.glb if target else made.collision or b"")
    assert names <= {node["name"] for node in root["nodes"]}
    assert names <= {mesh["name"] for mesh in root["meshes"]}
    assert (made.collision is None) == bool(target)


@pytest.mark.slow
def test_hulls_are_nodes_of_their_own(ball: Path) -> None:
    made = msb.lod(ball, lods="none", collision="hulls:4")
    assert made.collision is not None
    root = root_of(made.collision)
    assert made.report.collision is not None
    assert len(root["nodes"]) == len(root["meshes"]) == made.report.collision.parts <= 4
    assert made.report.collision.mean_distance < 0.05
    whole, hulls = (read_scene(open_glb(glb)).vertices for glb in (made.glb, made.collision))
    assert np.ptp(hulls, axis=0) == pytest.approx(np.ptp(whole, axis=0), rel=0.05)


def test_a_collision_mesh_is_near_the_surface(ball: Path) -> None:
    mesh = read_mesh(ball)
    shape = make_collision(mesh.vertices.astype(float), mesh.faces, "mesh:300")
    assert shape.report.faces == pytest.approx(300, rel=0.05)
    assert shape.report.mean_distance < 0.01
    assert shape.report.mid_air_share == 0


@pytest.mark.slow
def test_one_file_has_all_levels(ball: Path, tmp_path: Path) -> None:
    made = msb.lod(ball, lods=[0.5, 0.25], one_file=True)
    root = root_of(made.glb)
    (first,) = root["scenes"][0]["nodes"]
    ids = root["nodes"][first]["extensions"]["MSFT_lod"]["ids"]
    assert [root["nodes"][number]["name"] for number in ids] == ["ball_LOD1", "ball_LOD2"]
    assert len(root["nodes"][first]["extras"]["MSFT_screencoverage"]) == 3
    assert len(read_scene(open_glb(made.glb)).faces) == made.report.faces
    siblings = root_of(msb.lod(ball, lods=[0.5], one_file=True, target="unity").glb)
    names = [siblings["nodes"][number]["name"] for number in siblings["scenes"][0]["nodes"]]
    assert names == ["ball_LOD0", "ball_LOD1"]
    report = made.save(tmp_path / "all.glb")
    assert {level.output for level in report.levels} == {tmp_path / "all.glb"}
    assert [path.name for path in tmp_path.glob("all*")] == ["all.glb"]


@pytest.mark.slow
def test_scale_floor_and_centre(ball: Path) -> None:
    before = read_mesh(ball).vertices
    made = msb.lod(ball, lods=[0.5], scale=0.01, floor=True, center=True, collision="mesh:200")
    assert made.collision is not None
    after = read_scene(open_glb(made.glb)).vertices
    assert np.ptp(after, axis=0) == pytest.approx(0.01 * np.ptp(before, axis=0), rel=1e-5)
    for glb in (made.glb, made.collision):
        low, high = (f(read_scene(open_glb(glb)).vertices, axis=0) for f in (np.min, np.max))
        assert low[1] == pytest.approx(0, abs=1e-3)
        assert (low + high)[[0, 2]] == pytest.approx(0, abs=1e-3)


def test_mass_of_a_box_and_of_two() -> None:
    """A box a x b x c of mass m has the moment m (b^2 + c^2) / 12 about its first axis."""
    size, middle = np.array((1.0, 2.0, 3.0)), np.array((50.0, -20.0, 7.0))
    corners, faces = fit_box(middle + (np.indices((2, 2, 2)).reshape(3, -1).T - 0.5) * size)
    volume, center, inertia = measure_mass([(corners, faces)])
    assert volume == pytest.approx(6)
    assert center == pytest.approx(middle)
    expected = np.diag([(4 + 9) / 2, (1 + 9) / 2, (1 + 4) / 2])
    assert inertia == pytest.approx(expected, abs=1e-9)
    # Two boxes side by side are one box of twice the length.
    both = measure_mass([(corners, faces), (corners + np.eye(3)[0], faces)])
    assert both[0] == pytest.approx(12)
    assert both[2] == pytest.approx(np.diag([13, 13, 8]), abs=1e-9)
    assert measure_mass([(corners, faces[:, ::-1])])[0] == 0


@pytest.mark.slow
def test_a_body_and_a_box_come_to_rest_in_mujoco(ball: Path, tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    folder = tmp_path / "body"
    made = msb.lod(ball, target="mujoco", mass=2.5, collision="hulls:4")
    report = made.save(folder)
    assert report.output == folder / "body.xml"
    spec = mujoco.MjSpec.from_file(str(folder / "scene.xml"))
    size = 0.3
    box = spec.worldbody.add_body(name="box", pos=[0.05, 0.02, 3.2])
    box.add_freejoint()
    box.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[size] * 3, density=100)
    model = spec.compile()
    data = mujoco.MjData(model)
    body = model.body("body").id
    assert model.body_mass[body] == pytest.approx(2.5)
    assert model.ntex >= 1
    data.qpos[2] += 0.2
    mujoco.mj_forward(model, data)
    for _ in range(20_000):
        mujoco.mj_step(model, data)
    assert np.abs(data.qvel).max() < 0.02, "everything rests"
    assert data.qpos[2] > -0.1, "nothing falls through the floor"


@pytest.mark.slow
def test_isaac_gets_a_rigid_prop(ball: Path, tmp_path: Path) -> None:
    pxr = pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdPhysics

    assert pxr
    folder = tmp_path / "prop"
    options: LodKeywords = {"target": "isaac", "label": "chair:Q15026", "collision": "hulls:4"}
    report = msb.lod(ball, density=500, **options).save(folder)
    assert report.output == folder / "simready_usd" / "prop.usda"
    stage = Usd.Stage.Open(str(report.output))
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1
    root = stage.GetDefaultPrim()
    assert root.HasAPI(UsdPhysics.RigidBodyAPI)
    mass = UsdPhysics.MassAPI(root)
    # The bumpy sphere has a volume of about 4.2.
    assert mass.GetMassAttr().Get() == pytest.approx(2100, rel=0.15)
    moments = sorted(mass.GetDiagonalInertiaAttr().Get())
    assert moments[0] + moments[1] > moments[2] > 0
    assert root.GetAttribute("semantics:labels:wikidata_qcode").Get() == ["Q15026"]
    shapes = [prim for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.CollisionAPI)]
    assert 1 <= len(shapes) <= 4
    assert {prim.GetAttribute("physics:approximation").Get() for prim in shapes} == {"convexHull"}
    extents = stage.GetRootLayer().customLayerData["SimReady_Metadata"]["asset_extents"]
    assert extents[2] == pytest.approx(np.ptp(read_mesh(ball).vertices[:, 1]), rel=1e-4)
    assert (folder / "simready_usd" / "prop.png").is_file()
    assert (folder / "simready_usd/.thumbs/256x256/prop.usda.png").is_file()


def test_a_flat_mesh_collision_has_no_mass(tmp_path: Path) -> None:
    path = tmp_path / "flat.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 1 0 1\nv 0 0 1\nf 1 2 3\nf 1 3 4\n")
    made = msb.lod(path, target="mujoco", collision="mesh:10")
    with pytest.raises(MeshError) as caught:
        made.save(tmp_path / "flat")
    assert caught.value.code == "MESH_ARRAY"


def test_the_command_writes_files_and_json(here: Here, ball: Path, tmp_path: Path) -> None:
    out = tmp_path / "out" / "ball.glb"
    result = here("lod", ball, "-o", out, "--lods", "0.5,0.004", "--collision", "box", "--json", "-")
    assert result.status == 0, result
    data = result.json
    assert (data["schema"], data["path"], data["output"]) == ("msb.lod/1", str(ball), str(out))
    first, second = data["levels"]
    assert first.keys() == {"output", "share", "faces", "bytes", "texture", "psnr", "usable", "why"}
    assert (first["output"], second["output"]) == (str(out.with_name("ball_lod1.glb")), None)
    assert (first["usable"], first["why"], second["usable"]) == (True, None, False)
    assert first["bytes"] == out.with_name("ball_lod1.glb").stat().st_size
    shape = data["collision"]
    assert (shape["kind"], shape["parts"], shape["faces"]) == ("box", 1, 12)
    assert sorted(path.name for path in out.parent.iterdir()) == [
        "ball.glb", "ball_collision.glb", "ball_lod1.glb",
    ]  # fmt: skip
    here("lod", ball, "-o", out).ends(2, "OUTPUT_EXISTS: ")
    here("lod", ball).ends(2, "USAGE: ")
    here("lod", ball, "-o", tmp_path / "x.triasset").ends(2, "USAGE: ")


def test_a_bake_of_a_textured_mesh_keeps_the_texture(here: Here, ball: Path, tmp_path: Path) -> None:
    pytest.importorskip("msb.bake")
    out = tmp_path / "baked.glb"
    result = here("bake", ball, "-o", out, "--lods", "0.5", "--json", "-")
    assert result.status == 0, result
    assert result.json["schema"] == "msb.lod/1"
    assert result.json["levels"][0]["output"] == str(tmp_path / "baked_lod1.glb")
    assert root_of(out.read_bytes())["materials"] == root_of(ball.read_bytes())["materials"]


@pytest.mark.slow
def test_a_geometry_asks_for_a_new_texture(here: Here, ball: Path, tmp_path: Path) -> None:
    pytest.importorskip("msb.bake")
    words = "bake", ball, "-o", tmp_path / "baked.glb", "--geometry", "kept", "--color", "vertex"
    result = here(*words, "--json", "-")
    assert result.status == 0, result
    assert result.json["schema"] == "msb.bake/1"
