"""Models that are damaged, incomplete or of another method: one line each, naming file, key, what is right."""

# ruff: noqa: E501 - a case a line

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import msb
from msb.adapters.exporter import adapters
from msb.errors import MsbError, Unsupported, UsageError
from msb.meshes import Mesh, write_mesh
from tests.adapters import models
from tests.adapters.models import VALUES, write_model, write_web_export
from tests.conftest import ROOT

Change = tuple[str, Any]
NAN = np.float32("nan")


def spoiled(array: np.ndarray, at: tuple[int, ...], value: float) -> np.ndarray:
    copy = array.copy()
    copy[at] = value
    return copy


# method, key, what it becomes (None: removed), code, part of the message
BROKEN: list[tuple[str, str, Callable[[Any], Any] | None, str, str]] = [
    ("two_dts", "_vertex", lambda a: a[:, :2], "LAYOUT", "_vertex has shape [5, 2, 3]; it must be N x 3 x 3"),
    ("two_dts", "_opacity", None, "LAYOUT", 'no key "_opacity"; it has _vertex, _f_dc, _f_rest'),
    ("two_dts", "_opacity", lambda a: a[:4], "LAYOUT", "_opacity has shape [4, 1]; it must be N x 1 with N = 5 as in _vertex"),
    ("two_dts", "_opacity", lambda a: a[:, 0], "LAYOUT", "_opacity has shape [5]"),
    ("two_dts", "_opacity", lambda a: spoiled(a, (2, 0), NAN), "NONFINITE", "_opacity[2, 0] is nan; it must be a number"),
    ("two_dts", "_f_dc", lambda a: spoiled(a, (4, 0, 1), np.inf), "NONFINITE", "_f_dc[4, 0, 1] is inf; it must be a finite number"),
    ("two_dts", "_f_dc", lambda a: a.astype(np.int32), "LAYOUT", "_f_dc is int32; it must be float32"),
    ("two_dts", "_f_rest", lambda a: a[:, :7], "LAYOUT", "_f_rest has 7 SH coefficients per channel"),
    ("two_dts", "_f_rest", lambda a: 3.0, "LAYOUT", "_f_rest is of type float; it must be a tensor"),
    ("triangle_splatting", "triangles_points", lambda a: a[:0], "LAYOUT", "shape [0, 3, 3]: the model is empty"),
    ("triangle_splatting", "sigma", None, "LAYOUT", 'no key "sigma"'),
    ("triangle_splatting", "sigma", lambda a: spoiled(a, (1, 0), np.inf), "NONFINITE", "sigma[1, 0] is inf"),
    ("triangle_splatting", "active_sh_degree", None, "LAYOUT", "active_sh_degree"),
    ("triangle_splatting", "active_sh_degree", lambda a: 4, "LAYOUT", "active_sh_degree is 4; it must be a whole number from 0 to 3"),
    ("triangle_splatting", "active_sh_degree", lambda a: True, "LAYOUT", "active_sh_degree is of type bool; it must be a number"),
    ("triangle_splatting", "active_sh_degree", lambda a: 1.5, "LAYOUT", "active_sh_degree is 1.5"),
    ("triangle_splatting", "features_rest", lambda a: None, "LAYOUT", "features_rest is None; it must be a tensor"),
    ("triangle_splatting", "triangles_points", lambda a: spoiled(a, (3, 2, 1), NAN), "NONFINITE", "triangles_points[3, 2, 1] is nan"),
    ("mesh_splatting", "_triangle_indices", None, "LAYOUT", "_triangle_indices"),
    ("mesh_splatting", "_triangle_indices", lambda a: spoiled(a, (1, 2), 6), "LAYOUT", "_triangle_indices[1, 2] is 6; it must be 0 to 5"),
    ("mesh_splatting", "_triangle_indices", lambda a: spoiled(a, (0, 0), -1), "LAYOUT", "_triangle_indices[0, 0] is -1"),
    ("mesh_splatting", "_triangle_indices", lambda a: a.astype(np.float32), "LAYOUT", "_triangle_indices is float32; it must be int32 or int64"),
    ("mesh_splatting", "vertex_weight", lambda a: a[:, :0], "LAYOUT", "vertex_weight has shape [6, 0]; it must be V x 1 with V = 6 as in triangles_points"),
    ("mesh_splatting", "sigma", lambda a: math.nan, "NONFINITE", "sigma is nan; it must be a finite number"),
    ("mesh_splatting", "sigma", lambda a: 800.0, "LAYOUT", "exp(sigma) is inf; it must be a finite number"),
    ("mesh_splatting", "sigma", lambda a: -800.0, "LAYOUT", "exp(sigma) is 0.0; it must be greater than 0"),
    ("mesh_splatting", "features_dc", lambda a: a[:, 0], "LAYOUT", "features_dc has shape [6, 3]; it must be V x 1 x 3"),
    ("diffsoup", "feat_acc", lambda a: a[:, :5], "LAYOUT", "feat_acc has shape [4, 5, 7]; it must be T x 6 x 7"),
    ("diffsoup", "alpha_acc", lambda a: spoiled(a, (0, 0, 0), NAN), "NONFINITE", "alpha_acc[0, 0, 0] is nan"),
    ("diffsoup", "F", lambda a: a + 1, "LAYOUT", "F[3, 0] is 12; it must be 0 to 11"),
    ("diffsoup", "Rmax", lambda a: 9, "LAYOUT", "Rmax is 9; it must be a whole number from 0 to 8"),
    ("diffsoup", "color_mlp", None, "LAYOUT", "color_mlp"),
    ("diffsoup", "color_mlp", lambda a: 1, "LAYOUT", "color_mlp is no state dict"),
    ("diffsoup", "color_mlp", lambda a: {k: v for k, v in a.items() if k != "mlp.4.bias"}, "LAYOUT", "mlp.4.bias"),
    ("diffsoup", "color_mlp", lambda a: {**a, "mlp.0.weight": a["mlp.0.weight"][:8]}, "LAYOUT", "mlp.0.weight has shape [8, 16]; it must be 16 x 16"),
]  # fmt: skip


@pytest.mark.parametrize(("method", "key", "change", "code", "text"), BROKEN)
def test_a_broken_model_says_what_is_wrong(
    method: str, key: str, change: Callable[[Any], Any] | None, code: str, text: str, tmp_path: Path
) -> None:
    values = VALUES[method]()
    if change is None:
        del values[key]
    else:
        values[key] = change(values[key])
    error = refused(write_model(tmp_path / "run", method, values))
    assert (error.code, text in error.message) == (f"CHECKPOINT_{code}", True), str(error)
    assert error.file.endswith((".pt", ".ckpt"))


def refused(path: Path, **options: Any) -> MsbError:
    with pytest.raises(MsbError) as caught:
        msb.export(path, **options)
    line = str(caught.value)
    assert line.isprintable()
    assert line.startswith(f"{caught.value.code}: ")
    assert len(line) < 600
    return caught.value


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (lambda v: (v, {}, None), "it is a tuple of 3; it must be (params, optimizer, scene_bbox, gamma)"),
        (lambda v: (v, {}, None, "x"), "gamma is text; it must be a number"),
        (lambda v: (v, {}, None, 0.5), "gamma is 0.5; it must be at least 1"),
        (lambda v: (v, {}, None, math.nan), "gamma is nan; it must be a finite number"),
        (lambda v: (v, {}, [1, 2, 3], 1.0), "scene_bbox must be None or 4 or 6 finite numbers"),
        (lambda v: (v, {}, [1, 2, 3, "4"], 1.0), "scene_bbox must be None or 4 or 6 finite numbers"),
    ],
)
def test_two_dts_tuple(value: Callable[[Any], Any], text: str, tmp_path: Path) -> None:
    error = refused(write_model(tmp_path, "two_dts", value(models.two_dts())))
    assert text in error.message


@pytest.mark.parametrize(
    ("method", "key", "said"),
    [
        ("triangle_splatting", "triangles_points", "triangles_points, which may be my_triangles_points here"),
        ("mesh_splatting", "features_dc", None),  # its indices show whose it is
        ("two_dts", "_f_dc", None),
        ("diffsoup", "V", None),
    ],
)
def test_keys_that_nearly_fit_name_the_nearest_method(
    method: str, key: str, said: str | None, tmp_path: Path
) -> None:
    value = VALUES[method]()
    value["my_" + key.strip("_")] = value.pop(key)
    message = refused(write_model(tmp_path, method, value)).message
    assert (f"nearest: {method}, but for {said}" if said else f'it has no key "{key}"') in message


@pytest.mark.parametrize("method", VALUES)
def test_the_keys_that_a_method_names_are_in_its_checkpoints(method: str) -> None:
    adapter: Any = adapters()[method]
    assert set(adapter.KEYS) <= VALUES[method]().keys()


@pytest.mark.parametrize("method", VALUES)
def test_a_model_of_another_method_is_named(method: str, tmp_path: Path) -> None:
    folder = write_model(tmp_path, method, VALUES[method]())
    assert msb.export(folder).manifest.method == method
    for other in VALUES:
        if other != method:
            error = refused(folder, method=other)
            assert error.code == "CHECKPOINT_METHOD"
            assert f"it holds a {method} model; --method says {other}" in error.message


def test_a_stranger_is_named_by_its_keys(tmp_path: Path) -> None:
    models.write_torch(tmp_path / "model.pt", {"weights": np.zeros(3, np.float32), "epoch": 3})
    error = refused(tmp_path / "model.pt")
    assert error.code == "CHECKPOINT_UNKNOWN"
    assert "its keys are weights, epoch" in error.message
    error = refused(tmp_path / "model.pt", method="diffsoup")
    assert (error.code, 'no key "Rmax"' in error.message) == ("CHECKPOINT_LAYOUT", True)
    models.write_torch(tmp_path / "list.pt", [1, 2])
    assert "it holds a list" in refused(tmp_path / "list.pt").message
    assert refused(tmp_path / "list.pt", method="mesh_splatting").code == "CHECKPOINT_LAYOUT"
    assert refused(tmp_path / "list.pt", method="nonsense").code == "USAGE"


@pytest.mark.parametrize("method", VALUES)
def test_every_prefix_of_a_model_is_refused(method: str, tmp_path: Path) -> None:
    folder = write_model(tmp_path, method, VALUES[method]())
    file = next(path for path in folder.rglob("*") if path.is_file())
    data = file.read_bytes()
    for end in range(0, len(data), max(1, len(data) // 60)):
        file.write_bytes(data[:end])
        assert refused(folder).code.startswith("CHECKPOINT_")


def gaussians(path: Path, scales: int) -> Path:
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
    names += [f"scale_{i}" for i in range(scales)] + [f"rot_{i}" for i in range(4)]
    lines = ["ply", "format binary_little_endian 1.0", "element vertex 2"]
    lines += [f"property float {name}" for name in names] + ["end_header\n"]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes("\n".join(lines).encode() + np.zeros((2, len(names)), "<f4").tobytes())
    return path


def test_three_dgs_is_recognised_and_refused(tmp_path: Path) -> None:
    gaussians(tmp_path / "run" / "point_cloud" / "iteration_7000" / "point_cloud.ply", 3)
    captured = (3, *[np.zeros((2, 3), np.float32)] * 11)
    (tmp_path / "other").mkdir()
    models.write_torch(tmp_path / "other" / "chkpnt30000.pth", (captured, 30000))
    for folder in ("run", "other"):
        with pytest.raises(
            Unsupported, match="three_dgs on every tier: its primitives are Gaussians"
        ) as caught:
            msb.export(tmp_path / folder)
        assert (caught.value.code, caught.value.exit_status) == ("UNSUPPORTED_METHOD", 4)


def test_two_dgs_needs_its_mesh(tmp_path: Path) -> None:
    gaussians(tmp_path / "point_cloud" / "iteration_30000" / "point_cloud.ply", 2)
    error = refused(tmp_path)
    assert error.code == "CHECKPOINT_FILE_MISSING"
    assert "train/ours_N/fuse_post.ply" in error.message
    (tmp_path / "train" / "ours_30000").mkdir(parents=True)
    mesh = (ROOT / "tests" / "golden" / "meshes" / "synthetic_splat_small.ply").read_bytes()
    (tmp_path / "train" / "ours_30000" / "fuse.ply").write_bytes(mesh)
    asset = msb.export(tmp_path)
    assert asset.manifest.method == "two_dgs"
    assert asset.manifest.required_passes == {"standard": ("opaque_unlit",)}
    assert [file.path for file in asset.manifest.source.files] == ["train/ours_30000/fuse.ply"]
    assert msb.export(tmp_path / "train" / "ours_30000" / "fuse.ply").manifest.method == "two_dgs"
    assert msb.export(tmp_path / "train" / "ours_30000" / "fuse.ply", method="mesh").manifest.method == "mesh"


@pytest.mark.parametrize("missing", ["mesh.ply", "lut0.png", "lut1.png", "mlp_weights.json"])
def test_a_file_missing_from_the_web_export_is_named(missing: str, tmp_path: Path) -> None:
    folder = write_web_export(tmp_path / "scene")
    (folder / missing).unlink()
    error = refused(folder)
    assert error.code == "CHECKPOINT_FILE_MISSING"
    assert f"{missing} is missing" in error.message


def test_web_export_without_meta_takes_defaults_and_says_so(tmp_path: Path) -> None:
    folder = write_web_export(tmp_path / "scene", level=2)
    assert msb.export(folder).manifest.settings["layout"].value == "synthetic"
    (folder / "meta.json").unlink()
    asset = msb.export(folder)
    assert asset.manifest.settings["layout"].value == "colmap"
    assert asset.manifest.settings["layout"].source == "default"
    assert asset.manifest.appearance["level"] == 2
    assert [w.code for w in asset.warnings] == ["CHECKPOINT_CONFIG_MISSING"]


WEB = {
    "not a PNG": ("lut0.png", b"hello", "lut0.png is not a complete PNG"),
    "cut PNG": ("lut1.png", -20, "lut1.png is not a complete PNG"),
    "grey": ("lut0.png", Image.new("L", (24, 1)), "lut0.png has mode L; the look-up textures are RGBA with 8 bits"),
    "too small": ("lut0.png", Image.new("RGBA", (23, 1)), "lut0.png is 23 x 1; 4 faces need one of 12 x 1, 24 x 1"),
    "other level": ("lut1.png", Image.new("RGBA", (12, 1)), "lut1.png is 12 x 1, but lut0.png 24 x 1"),
    "not JSON": ("mlp_weights.json", b"{", "mlp_weights.json is not JSON"),
    "no object": ("mlp_weights.json", b"[]", "mlp_weights.json holds no object"),
    "key missing": ("mlp_weights.json", b"{}", '"W1" must be a list of 256 numbers'),
    "too long": ("mlp_weights.json", b"[" + b" " * (1 << 20) + b"]", "mlp_weights.json has more than"),
    "other face count": ("meta.json", b'{"num_faces": 5}', "num_faces is 5, but mesh.ply and the textures have 4"),
    "wrong level": ("meta.json", b'{"level": 5}', "level is 5, but mesh.ply and the textures have 1"),
}  # fmt: skip


@pytest.mark.parametrize("case", WEB)
def test_a_damaged_web_export_says_what_is_wrong(case: str, tmp_path: Path) -> None:
    folder = write_web_export(tmp_path / "scene")
    name, content, text = WEB[case]
    if isinstance(content, bytes):
        (folder / name).write_bytes(content)
    elif isinstance(content, int):
        (folder / name).write_bytes((folder / name).read_bytes()[:content])
    else:
        content.save(folder / name)
    error = refused(folder)
    assert (error.code, text in error.message) == ("CHECKPOINT_DAMAGED", True), str(error)


def test_a_web_export_without_faces_is_empty(tmp_path: Path) -> None:
    folder = write_web_export(tmp_path / "scene")
    none = Mesh(np.zeros((3, 3), np.float32), np.zeros((0, 3), np.int64))
    write_mesh(none, folder / "mesh.ply", suffix=".ply")
    assert "the model is empty" in refused(folder).message


def test_a_bomb_of_a_texture_is_refused_before_it_is_decoded(tmp_path: Path) -> None:
    folder = write_web_export(tmp_path / "scene")
    data = bytearray((folder / "lut0.png").read_bytes())
    data[16:24] = (60000).to_bytes(4, "big") * 2
    import zlib

    data[29:33] = zlib.crc32(bytes(data[12:29])).to_bytes(4, "big")
    (folder / "lut0.png").write_bytes(data)
    assert "lut0.png is 60000 x 60000" in refused(folder).message


def test_decoder_numbers_must_fit_float32(tmp_path: Path) -> None:
    folder = write_web_export(tmp_path / "scene")
    weights = json.loads((folder / "mlp_weights.json").read_text())
    weights["b3"] = [0, 1e39, 0]
    (folder / "mlp_weights.json").write_text(json.dumps(weights))
    assert '"b3" holds numbers that float32 cannot' in refused(folder).message


@pytest.mark.parametrize("values", [lambda a: a.astype(np.float16), lambda a: a.astype(np.float64)])
def test_other_float_types_become_float32(values: Callable[[Any], Any], tmp_path: Path) -> None:
    model = models.triangle_splatting()
    model["opacity"] = values(model["opacity"])
    asset = msb.export(write_model(tmp_path, "triangle_splatting", model))
    assert asset.buffers["opacity"].dtype == np.float32
    np.testing.assert_array_equal(asset.buffers["opacity"], model["opacity"][:, 0].astype(np.float32))
    rounded = model["opacity"].dtype == np.float64
    assert ("CHECKPOINT_ROUNDED" in [w.code for w in asset.warnings]) == rounded


def test_infinite_logits_are_opacities_of_exactly_0_and_1(tmp_path: Path) -> None:
    model = models.two_dts()
    model["_opacity"][:2, 0] = np.inf, -np.inf
    assert msb.export(write_model(tmp_path, "two_dts", model)).buffers["opacity"][0] == np.inf


def test_features_that_are_no_sigmoid_are_warned_about(tmp_path: Path) -> None:
    model = models.diffsoup()
    model["feat_acc"][0, 0, 0] = 1.5
    asset = msb.export(write_model(tmp_path, "diffsoup", model))
    assert [w.code for w in asset.warnings] == ["CHECKPOINT_LAYOUT"]
    assert "feat_acc has values from" in asset.warnings[0].message


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"gama": 2.0}, 'two_dts has no setting "gama"; it has rasterizer, sh_degree'),
        ({"gamma": 0.5}, "setting gamma is 0.5; it must be at least 1"),
        ({"gamma": "2"}, "setting gamma is '2'; it must be a number"),
        ({"sh_degree": 4}, "setting sh_degree is 4; it must be at most 3"),
        ({"rasterizer": "4D"}, "setting rasterizer is '4D'; it must be one of 2D, 3D"),
        ({"back_culling": 1}, "setting back_culling is 1; it must be true or false"),
    ],
)
def test_wrong_settings_list_what_is_right(settings: dict[str, Any], text: str, tmp_path: Path) -> None:
    folder = write_model(tmp_path, "two_dts", models.two_dts())
    with pytest.raises(UsageError) as caught:
        msb.export(folder, settings=settings)
    assert text in caught.value.message
    assert caught.value.code in ("SETTING_UNKNOWN", "SETTING_VALUE")


def test_a_degree_that_is_not_stored_cannot_be_asked_for(tmp_path: Path) -> None:
    folder = write_model(tmp_path, "mesh_splatting", models.mesh_splatting(coefficients=3))
    with pytest.raises(UsageError, match="sh_degree is 2; the checkpoint stores degree 1 only"):
        msb.export(folder, settings={"sh_degree": 2})
    assert msb.export(folder, settings={"sh_degree": 0}).manifest.settings["sh_degree"].source == "flag"
