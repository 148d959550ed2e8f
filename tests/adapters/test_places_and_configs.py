"""Find the model in an output folder, and its settings in configs, logs and cfg_args."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from data_stubs.made_meshes import PLACES
from msb.adapters.exporter import detect
from msb.adapters.training_config import MAX_BYTES, read_cfg_args
from msb.api.inputs import expand
from msb.asset.texture import is_textured
from msb.errors import CheckpointError, InputError, UsageError
from msb.scenes.datasets.notes import warn_test_views
from tests.adapters import models
from tests.adapters.models import GOLDEN, VALUES, write_model, write_web_export
from tests.conftest import ROOT
from tests.tiny import MODELS

TORUS = GOLDEN / "triangle_splatting" / "torus_sh0_white" / "checkpoint"


def test_the_latest_iteration_is_the_largest_number() -> None:
    asset = msb.export(TORUS)  # compared as text, "7000" is larger than "30000"
    assert (asset.manifest.face_count, asset.warnings) == (2136, ())
    inside = msb.export(TORUS / "point_cloud" / "iteration_30000" / "point_cloud_state_dict.pt")
    assert inside.manifest.face_count == 2136
    older = msb.export(TORUS / "point_cloud" / "iteration_7000")
    assert older.manifest.face_count == 40
    assert older.manifest.source.files[0].path.startswith("point_cloud/iteration_7000/")


def test_a_folder_with_a_single_checkpoint_is_accepted(tmp_path: Path) -> None:
    write_model(tmp_path / "a" / "run", "diffsoup", models.diffsoup())
    asset = msb.export(tmp_path / "a")
    assert (asset.manifest.method, asset.opened_from) == ("diffsoup", tmp_path / "a" / "run")
    write_model(tmp_path / "a" / "other", "two_dts", models.two_dts())
    with pytest.raises(CheckpointError, match=r"\(other, run\)"):
        msb.export(tmp_path / "a")


def test_the_folder_of_web_exports(tmp_path: Path) -> None:
    write_web_export(tmp_path / "data" / "garden")
    (tmp_path / "data" / "models.json").write_text('["garden"]')
    assert msb.export(tmp_path / "data").manifest.method == "diffsoup"
    assert msb.export(tmp_path / "data" / "garden" / "mesh.ply").manifest.method == "diffsoup"


def test_an_asset_is_not_a_checkpoint() -> None:
    with pytest.raises(CheckpointError, match="CHECKPOINT_NOT_RECOGNISED"):
        msb.export(ROOT / "data_stubs" / "splat_like.triasset")


def test_a_folder_with_a_single_model_file_is_accepted(tmp_path: Path) -> None:
    file = write_model(tmp_path / "run", "triangle_splatting", VALUES["triangle_splatting"]())
    model = next(file.rglob("*.pt"))
    (tmp_path / "r").mkdir()
    shutil.copy(model, tmp_path / "r" / "my_model.pt")
    assert msb.open(tmp_path / "r").manifest.method == "triangle_splatting"
    assert expand(tmp_path / "r") == [tmp_path / "r"]
    shutil.copy(model, tmp_path / "r" / "other.pt")
    for read in (msb.open, expand):
        with pytest.raises(CheckpointError, match=r"other\.pt"):
            read(tmp_path / "r")


def test_a_last_iteration_without_a_model_is_an_error(tmp_path: Path) -> None:
    shutil.copytree(TORUS, tmp_path / "run")
    (tmp_path / "run" / "point_cloud" / "iteration_100000").mkdir()
    with pytest.raises(CheckpointError, match=r"CHECKPOINT_FILE_MISSING: .*iteration_100000"):
        msb.export(tmp_path / "run")


def settings_of(folder: Path, **options: Any) -> dict[str, tuple[Any, str]]:
    return {k: (s.value, s.source) for k, s in msb.export(folder, **options).manifest.settings.items()}


def test_without_a_config_there_are_defaults_and_one_warning(tmp_path: Path) -> None:
    folder = write_model(tmp_path, "two_dts", models.two_dts())
    asset = msb.export(folder)
    assert [w.code for w in asset.warnings] == ["CHECKPOINT_CONFIG_MISSING"]
    settings = settings_of(folder)
    assert settings["rasterizer"] == ("2D", "default")
    assert settings["gamma"] == (1.0, "checkpoint")
    assert settings["sh_degree"] == (3, "checkpoint")


CONFIG = (
    "model:\n  rasterizer_type: 3D\n  max_sh_degree: 2\n  ste_threshold: 0.25\n"
    "trainer:\n  eval_background: black\n"
)


def test_a_yaml_in_the_folder_a_given_config_and_flags(tmp_path: Path) -> None:
    folder = write_model(tmp_path / "run", "two_dts", models.two_dts())
    (folder / "config.yaml").write_text(CONFIG)
    settings = settings_of(folder)
    assert settings["rasterizer"] == ("3D", "config")
    assert settings["sh_degree"] == (2, "config")
    assert settings["ste_threshold"] == (0.25, "config")
    assert settings["back_culling"] == (False, "default")
    assert msb.export(folder).manifest.appearance["background"] == "#000000"
    (tmp_path / "other.yml").write_text("model:\n  rasterizer_type: 2D\n  render_up_scale: 2\n")
    settings = settings_of(
        folder, config=tmp_path / "other.yml", settings={"ste_threshold": None, "gamma": 20.0}
    )
    assert settings["rasterizer"] == ("2D", "config")
    assert settings["render_up_scale"] == (2, "config")
    assert settings["ste_threshold"] == (None, "flag")
    assert settings["gamma"] == (20.0, "flag")


def test_the_last_log_with_a_config_is_used(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(GOLDEN / "two_dts" / "ring_solid" / "checkpoint", folder)
    log = next((folder / "log").iterdir())
    (folder / "log" / "2025-08-01_12-00-00_outputs.log").write_text("2025 - INFO: nothing here\n")
    asset = msb.export(folder)
    assert asset.manifest.settings["rasterizer"].value == "3D"
    assert [w.code for w in asset.warnings] == ["CHECKPOINT_CONFIG"]
    (folder / "log" / "2025-08-01_12-00-00_outputs.log").write_text(log.read_text().replace("3D", "2D"))
    assert msb.export(folder).manifest.settings["rasterizer"].value == "2D"
    crlf = log.read_text().replace("\n", "\r\n")
    (folder / "log" / "2025-08-01_12-00-00_outputs.log").write_bytes(crlf.encode())
    assert msb.export(folder).manifest.settings["rasterizer"].value == "3D"


def test_a_degree_above_the_stored_one_is_lowered_with_a_warning(tmp_path: Path) -> None:
    folder = write_model(tmp_path, "two_dts", models.two_dts(coefficients=3))
    (folder / "config.yaml").write_text("model:\n  max_sh_degree: 3\n")
    asset = msb.export(folder)
    assert asset.manifest.settings["sh_degree"].value == 1
    assert "max_sh_degree" in asset.warnings[0].message


@pytest.mark.parametrize(
    "line",
    [
        "rasterizer_type: 4D",
        "ste_threshold: 2",
        "render_up_scale: [2]",
    ],
)
def test_an_invalid_config_value_is_an_error_unless_overridden(line: str, tmp_path: Path) -> None:
    folder = write_model(tmp_path, "two_dts", models.two_dts())
    (folder / "config.yaml").write_text(f"model:\n  {line}\n")
    with pytest.raises(CheckpointError, match="CHECKPOINT_CONFIG") as caught:
        msb.export(folder)
    assert str(caught.value.file).endswith("config.yaml")
    name = {"rasterizer_type": "rasterizer", "max_sh_degree": "sh_degree"}.get(
        line.split(":")[0], line.split(":")[0]
    )
    value = {"rasterizer": "3D", "back_culling": True, "ste_threshold": 0.5}.get(name, 2)
    assert msb.export(folder, settings={name: value}).manifest.settings[name].source == "flag"


HOSTILE_YAML = {
    "laughs": "a: &a [x,x]\nb: &b [*a,*a]\nmodel: {rasterizer_type: *b}\n",
    "object": "model: !!python/object/apply:os.system [echo]\n",
    "deep": "model: " + "[" * 20000,
    "huge number": "model: {max_sh_degree: " + "9" * 20000 + "}\n",
    "number of 3000 places": "model: {a: 1" + ":59" * 3000 + "}\n",
    "long": "model:\n" + "  x: 1\n" * MAX_BYTES,
    "no section": "trainer: {}\n",
}


@pytest.mark.slow
@pytest.mark.parametrize("case", HOSTILE_YAML)
def test_a_hostile_config_is_ignored_or_rejected(case: str, tmp_path: Path) -> None:
    folder = write_model(tmp_path / "run", "two_dts", models.two_dts())
    (folder / "config.yaml").write_text(HOSTILE_YAML[case])
    asset = msb.export(folder)
    assert [w.code for w in asset.warnings] in (
        ["CHECKPOINT_CONFIG", "CHECKPOINT_CONFIG_MISSING"],
        [] if case == "long" else None,  # the text is truncated at the limit and is still a valid config
    )
    assert asset.manifest.settings["rasterizer"].value in ("2D", "3D")
    if asset.warnings:
        with pytest.raises(CheckpointError, match="CHECKPOINT_CONFIG"):
            msb.export(folder, config=folder / "config.yaml")
    with pytest.raises(InputError, match="FILE_NOT_FOUND"):
        msb.export(folder, config=folder / "nothing.yaml")


@pytest.mark.parametrize(("config", "code"), [("nothing.yaml", "FILE_NOT_FOUND"), ("there.yaml", "USAGE")])
def test_an_unused_config_is_an_error(config: str, code: str, tmp_path: Path) -> None:
    (tmp_path / "there.yaml").write_text("model:\n  rasterizer_type: 3D\n")
    with pytest.raises((InputError, UsageError), match=code):
        msb.export("data_stubs/checkpoint", config=tmp_path / config)


CFG_ARGS = {
    "Namespace(white_background=True)": {"white_background": True},
    "Namespace(a=1, b='x', c=None, d=-2.5, e=[1, 2])\n": {
        "a": 1,
        "b": "x",
        "c": None,
        "d": -2.5,
        "e": [1, 2],
    },
    "Namespace(a=__import__('os').getcwd())": None,
    "Namespace(a=1); x": None,
    "": None,
    "Namespace(a=" + "[" * 30000: None,
    "Namespace(a=" + "1+" * 30000 + "1)": None,
    "Namespace(a='\\d')": {"a": "\\d"},
}


@pytest.mark.parametrize("text", CFG_ARGS, ids=lambda text: text[:20])
def test_cfg_args_are_literals(text: str, tmp_path: Path) -> None:
    (tmp_path / "cfg_args").write_text(text)
    values, files, warnings = read_cfg_args(tmp_path)
    expected = CFG_ARGS[text]
    if expected is None:
        assert (values, files) == ({}, ())
        assert [w.code for w in warnings] == ["CHECKPOINT_CONFIG"]
    else:
        assert (values, files, warnings) == (expected, (tmp_path / "cfg_args",), [])


@pytest.mark.parametrize(
    "value",
    [
        "device(type='cuda')",
        "<class 'a, b'>",
        "nan",
        "PosixPath('/a, b')",
        "1, b=2",
        "__import__('os').getcwd()",
    ],
)
def test_values_that_are_no_literals_are_skipped(value: str, tmp_path: Path) -> None:
    text = f"Namespace(a='x, (y', b={value}, white_background=True, c=[1, {{'d': (2, 3)}}])"
    (tmp_path / "cfg_args").write_text(text)
    values, files, warnings = read_cfg_args(tmp_path)
    assert values == {"a": "x, (y", "white_background": True, "c": [1, {"d": (2, 3)}]}
    assert files == (tmp_path / "cfg_args",)
    assert [(w.code, w.severity) for w in warnings] == [("CHECKPOINT_CONFIG", "warning")]


def test_an_unreadable_cfg_args_is_a_warning(tmp_path: Path) -> None:
    (tmp_path / "cfg_args").write_bytes(b"version https://git-lfs.github.com/spec/v1\n")
    assert [w.code for w in read_cfg_args(tmp_path)[2]] == ["CHECKPOINT_CONFIG"]


@pytest.mark.parametrize("method", ["triangle_splatting", "mesh_splatting"])
def test_cfg_args_become_properties_of_the_training(method: str, tmp_path: Path) -> None:
    folder = write_model(tmp_path, method, getattr(models, method)())
    values = r"source_path='/home/me/s', images='C:\\me\\images_2/', resolution=-1, white_background=True"
    (tmp_path / "cfg_args").write_text(f"Namespace({values}, eval=False)")
    asset = msb.export(folder)
    assert asset.manifest.training == {"eval": False, "images": "images_2", "resolution": -1}
    assert asset.manifest.appearance["background"] == "#ffffff"
    assert [w.message for w in asset.warnings] == [warn_test_views().message]
    (tmp_path / "cfg_args").write_text("Namespace(eval=1, images=3, resolution=1.5)")
    assert msb.export(folder).manifest.training == {}


@pytest.mark.parametrize(
    ("values", "up"),
    [
        ("source_path='/data/mipnerf360/garden', white_background=False", "-y"),
        ("source_path='C:\\\\me\\\\my_capture\\\\', white_background=True", "-y"),
        ("source_path='/data/nerf_synthetic/lego'", "+z"),
        ("source_path='/data/lego/', white_background=True", "+z"),
        ("source_path='/data/lego', white_background=False", "-y"),
        ("eval=True", "unknown"),
    ],
)
def test_the_up_axis_follows_from_cfg_args(values: str, up: str, tmp_path: Path) -> None:
    folder = write_model(tmp_path, "triangle_splatting", models.triangle_splatting())
    (tmp_path / "cfg_args").write_text(f"Namespace({values})")
    assert msb.export(folder).manifest.coordinate_frame.up == up


def test_diffsoup_keeps_the_size_of_its_training(tmp_path: Path) -> None:
    values = {**models.diffsoup(), "H": 60, "W": 80}
    kept = msb.export(write_model(tmp_path, "diffsoup", values)).manifest
    assert kept.training == {"width": 80, "height": 60}


def test_a_checkpoint_without_cfg_args_has_no_background(tmp_path: Path) -> None:
    asset = msb.export(write_model(tmp_path, "triangle_splatting", models.triangle_splatting()))
    assert [w.code for w in asset.warnings] == ["CHECKPOINT_CONFIG_MISSING"]
    assert "background" not in asset.manifest.appearance


def test_optional_keys_of_mesh_splatting(tmp_path: Path) -> None:
    values = models.mesh_splatting()
    del values["features_rest"], values["active_sh_degree"], values["pixel_count"]
    asset = msb.export(write_model(tmp_path, "mesh_splatting", values))
    assert asset.manifest.sh_degree == 0
    settings = {k: (s.value, s.source) for k, s in asset.manifest.settings.items()}
    assert settings["sh_degree"] == (0, "default")
    assert settings["opacity_floor"] == (0.9999, "default")


def test_diffsoup_up_axis_and_layout_overrides(tmp_path: Path) -> None:
    values = {**models.diffsoup(), "up": [0.0, 0.0, -1.0]}
    folder = write_model(tmp_path, "diffsoup", values)
    asset = msb.export(folder)
    assert asset.manifest.coordinate_frame.up == "-z"
    values["up"] = np.array([0.5, 0.5, 0.0], np.float32)
    asset = msb.export(write_model(tmp_path, "diffsoup", values))
    assert asset.manifest.coordinate_frame.up == "unknown"
    assert asset.manifest.appearance["up_x"] == 0.5
    asset = msb.export(folder, settings={"layout": "synthetic"})
    assert asset.manifest.settings["z_far"].value == 10.0
    assert asset.manifest.appearance["background"] == "#ffffff"


PEBBLE = MODELS / "pebble"
MADE = msb.open(PEBBLE / "milo")


@pytest.mark.parametrize("method", PLACES)
def test_meshes_of_a_method_are_recognised(method: str) -> None:
    folder, file = PEBBLE / method, PEBBLE / method / PLACES[method]
    asset = msb.open(folder)
    assert asset.manifest.method == method == detect(file) == detect(file.parent)
    np.testing.assert_allclose(asset.buffers["positions"], MADE.buffers["positions"], atol=1e-6)
    assert is_textured(asset) is (file.suffix == ".obj")
    assert expand(folder) == [folder]  # the folder is a model, not a folder of meshes
    sources = msb.open(file).manifest.source.files
    assert sources == asset.manifest.source.files
    assert sources[0].path == PLACES[method]
    assert asset.audit().counts.faces == MADE.audit().counts.faces


def test_background_and_split_of_the_training_are_stored() -> None:
    manifest = msb.open(PEBBLE / "gaussian_wrapping").manifest
    assert manifest.appearance["background"] == "#ffffff"
    assert manifest.training == {"eval": True, "images": "images", "resolution": -1}
    assert "background" not in msb.open(PEBBLE / "trisplat").manifest.appearance


@pytest.mark.parametrize(
    ("names", "best"),
    [
        (("mesh_integration_sdf.ply", "mesh_learnable_sdf.ply"), "mesh_learnable_sdf.ply"),
        (("mesh_regular_tsdf_res512.ply", "mesh_regular_tsdf_res1024.ply"), "mesh_regular_tsdf_res1024.ply"),
        (("mesh_ours_2pivots.ply", "mesh_ours_2pivots_post.ply"), "mesh_ours_2pivots.ply"),
        (
            (
                "mesh_exact_computation_2pivots_searched.ply",
                "mesh_exact_computation_2pivots_searched_post.ply",
            ),
            "mesh_exact_computation_2pivots_searched.ply",
        ),
        (
            ("mesh/DIRECT_triangle_mesh.ply", "mesh/DIRECT_triangle_mesh_post.ply"),
            "mesh/DIRECT_triangle_mesh_post.ply",
        ),
    ],
)
def test_the_preferred_mesh_of_several_is_used(tmp_path: Path, names: tuple[str, ...], best: str) -> None:
    for name in (*names, "point_cloud/iteration_30000/point_cloud.ply"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(PEBBLE / "milo" / PLACES["milo"], tmp_path / name)
    assert msb.open(tmp_path).manifest.source.files[0].path == best


def test_equally_ranked_meshes_are_an_error(tmp_path: Path) -> None:
    source = PEBBLE / "sugar" / PLACES["sugar"]
    for name in ("sugarfine_level01.obj", "sugarfine_level03.obj"):
        shutil.copy(source, tmp_path / name)
    with pytest.raises(CheckpointError, match=r"\(sugarfine_level01.obj, "):
        msb.open(tmp_path)
