"""Models that are damaged, incomplete or belong to another method."""

import math
import re
import zlib
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

NAN = np.float32("nan")


def spoil(array: np.ndarray, at: tuple[int, ...], value: float) -> np.ndarray:
    copy = array.copy()
    copy[at] = value
    return copy


BROKEN: list[tuple[str, str, Callable[[Any], Any] | None, str]] = [
    ("two_dts", "_vertex", lambda a: a[:, :2], "LAYOUT"),
    ("two_dts", "_opacity", None, "LAYOUT"),
    ("two_dts", "_opacity", lambda a: a[:4], "LAYOUT"),
    ("two_dts", "_f_dc", lambda a: a.astype(np.int32), "LAYOUT"),
    ("two_dts", "_f_rest", lambda a: a[:, :7], "LAYOUT"),
    ("triangle_splatting", "triangles_points", lambda a: a[:0], "LAYOUT"),
    ("triangle_splatting", "active_sh_degree", lambda a: 4, "LAYOUT"),
    ("mesh_splatting", "_triangle_indices", lambda a: spoil(a, (1, 2), 6), "LAYOUT"),
    ("mesh_splatting", "_triangle_indices", lambda a: a.astype(np.float32), "LAYOUT"),
    ("mesh_splatting", "vertex_weight", lambda a: a[:, :0], "LAYOUT"),
    ("mesh_splatting", "sigma", lambda a: math.nan, "NONFINITE"),
    ("mesh_splatting", "sigma", lambda a: 800.0, "LAYOUT"),
    ("diffsoup", "feat_acc", lambda a: a[:, :5], "LAYOUT"),
    ("diffsoup", "F", lambda a: a + 1, "LAYOUT"),
    ("diffsoup", "Rmax", lambda a: 9, "LAYOUT"),
    ("diffsoup", "color_mlp", lambda a: 1, "LAYOUT"),
    ("diffsoup", "color_mlp", lambda a: {k: v for k, v in a.items() if k != "mlp.4.bias"}, "LAYOUT"),
    ("diffsoup", "color_mlp", lambda a: {**a, "mlp.0.weight": a["mlp.0.weight"][:8]}, "LAYOUT"),
]
"""Method, key, change of the key's value (None removes the key), and the end of the error code."""


@pytest.mark.parametrize(("method", "key", "change", "code"), BROKEN)
def test_a_broken_model_names_its_file_and_key(
    method: str, key: str, change: Callable[[Any], Any] | None, code: str, tmp_path: Path
) -> None:
    values = VALUES[method]()
    if change is None:
        del values[key]
    else:
        values[key] = change(values[key])
    error = read_rejected(write_model(tmp_path / "run", method, values))
    assert error.code == f"CHECKPOINT_{code}"
    assert key in error.message or "mlp" in error.message
    assert error.file.endswith((".pt", ".ckpt"))


# A parameter and a coordinate of each method are tested.
PARAMETERS = [
    ("two_dts", "_opacity", "_vertex"),
    ("triangle_splatting", "features_dc", "triangles_points"),
    ("mesh_splatting", "vertex_weight", "triangles_points"),
]


@pytest.mark.parametrize(("method", "parameter", "coordinate"), PARAMETERS)
def test_faces_with_values_that_are_not_finite_are_left_out(
    method: str, parameter: str, coordinate: str, tmp_path: Path
) -> None:
    values = VALUES[method]()
    if method == "mesh_splatting":
        values["_triangle_indices"] = np.int32([[0, 1, 2], [2, 3, 4], [3, 4, 5]])
    whole = msb.export(write_model(tmp_path / "whole", method, values))
    for name in (parameter, coordinate):
        at = (1, *[0] * (values[name].ndim - 1))
        folder = write_model(tmp_path / name, method, values | {name: spoil(values[name], at, NAN)})
        opened = msb.open(folder)
        assert 0 < opened.manifest.face_count < whole.manifest.face_count
        assert opened.manifest.topology == whole.manifest.topology
        (warning,) = [item for item in opened.warnings if item.code == "CHECKPOINT_NONFINITE"]
        assert warning.value == whole.manifest.face_count - opened.manifest.face_count
        for buffer in opened.buffers.values():
            assert np.isfinite(buffer).all()
        assert [item.code for item in msb.validate(folder).findings] == ["CHECKPOINT_NONFINITE"]
        if name == coordinate:
            assert read_rejected(folder).code == "CHECKPOINT_NONFINITE"
        else:
            assert msb.export(folder).manifest == opened.manifest
    nothing = values | {parameter: values[parameter] * NAN}
    assert read_rejected(write_model(tmp_path / "nothing", method, nothing)).code == "CHECKPOINT_NONFINITE"


def read_rejected(path: Path, **options: Any) -> MsbError:
    with pytest.raises(MsbError) as caught:
        msb.export(path, **options)
    line = str(caught.value)
    assert line.isprintable()
    assert line.startswith(f"{caught.value.code}: ")
    assert len(line) < 600
    return caught.value


@pytest.mark.parametrize(
    ("bad", "code"),
    [
        ([None, "x"], "LAYOUT"),
        ([None, math.nan], "NONFINITE"),
        ([[1, 2, 3], 1.0], "LAYOUT"),
    ],
)
def test_two_dts_tuple(bad: list[Any], code: str, tmp_path: Path) -> None:
    values = (models.two_dts(), {}, *bad)
    assert read_rejected(write_model(tmp_path, "two_dts", values)).code == f"CHECKPOINT_{code}"


@pytest.mark.parametrize(
    ("method", "key"),
    [
        ("triangle_splatting", "triangles_points"),
        ("mesh_splatting", "features_dc"),
        ("two_dts", "_f_dc"),
        ("diffsoup", "V"),
    ],
)
def test_similar_keys_name_the_most_similar_method(method: str, key: str, tmp_path: Path) -> None:
    value = VALUES[method]()
    value["my_" + key.strip("_")] = value.pop(key)
    assert key in read_rejected(write_model(tmp_path, method, value)).message


@pytest.mark.parametrize("method", VALUES)
def test_a_model_of_another_method_is_named(method: str, tmp_path: Path) -> None:
    folder = write_model(tmp_path, method, VALUES[method]())
    adapter: Any = adapters()[method]
    assert set(adapter.KEYS) <= VALUES[method]().keys()
    assert msb.export(folder).manifest.method == method
    for other in VALUES:
        if other != method:
            error = read_rejected(folder, method=other)
            assert error.code == "CHECKPOINT_METHOD"
            assert method in error.message


def test_an_unknown_model_is_described_by_its_keys(tmp_path: Path) -> None:
    models.write_torch(tmp_path / "model.pt", {"weights": np.zeros(3, np.float32), "epoch": 3})
    error = read_rejected(tmp_path / "model.pt")
    assert error.code == "CHECKPOINT_UNKNOWN"
    assert "weights, epoch" in error.message
    assert read_rejected(tmp_path / "model.pt", method="diffsoup").code == "CHECKPOINT_LAYOUT"
    models.write_torch(tmp_path / "list.pt", [1, 2])
    assert read_rejected(tmp_path / "list.pt").code == "CHECKPOINT_UNKNOWN"
    assert read_rejected(tmp_path / "list.pt", method="mesh_splatting").code == "CHECKPOINT_LAYOUT"
    assert read_rejected(tmp_path / "list.pt", method="nonsense").code == "USAGE"


@pytest.mark.parametrize("method", VALUES)
def test_every_truncated_model_is_rejected(method: str, tmp_path: Path) -> None:
    folder = write_model(tmp_path, method, VALUES[method]())
    file = next(path for path in folder.rglob("*") if path.is_file())
    data = file.read_bytes()
    for end in range(0, len(data), max(1, len(data) // 60)):
        file.write_bytes(data[:end])
        assert read_rejected(folder).code.startswith("CHECKPOINT_")


def gaussians(path: Path, scales: int) -> Path:
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
    names += [f"scale_{i}" for i in range(scales)] + [f"rot_{i}" for i in range(4)]
    lines = ["ply", "format binary_little_endian 1.0", "element vertex 2"]
    lines += [f"property float {name}" for name in names] + ["end_header\n"]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes("\n".join(lines).encode() + np.zeros((2, len(names)), "<f4").tobytes())
    return path


def test_gaussians_of_a_training_are_opened(tmp_path: Path) -> None:
    file = gaussians(tmp_path / "run" / "point_cloud" / "iteration_7000" / "point_cloud.ply", 3)
    (tmp_path / "run" / "cfg_args").write_text("Namespace(white_background=True, source_path='/data/garden')")
    asset = msb.export(tmp_path / "run")
    assert (asset.manifest.method, asset.manifest.primitive) == ("three_dgs", "gaussian")
    assert asset.manifest.appearance["background"] == "#ffffff"
    assert [source.path for source in asset.manifest.source.files] == [
        "point_cloud/iteration_7000/point_cloud.ply",
        "cfg_args",
    ]
    with pytest.raises(Unsupported) as caught:
        msb.audit(file)
    assert (caught.value.code, caught.value.exit_status) == ("UNSUPPORTED_METHOD", 4)
    assert "msb bake" in caught.value.message


def test_the_mesh_of_two_dgs_is_preferred_to_its_gaussians(tmp_path: Path) -> None:
    file = gaussians(tmp_path / "point_cloud" / "iteration_30000" / "point_cloud.ply", 2)
    assert msb.export(tmp_path).manifest.primitive == "gaussian"
    (tmp_path / "train" / "ours_30000").mkdir(parents=True)
    mesh = (ROOT / "tests" / "golden" / "meshes" / "synthetic_splat_small.ply").read_bytes()
    fused = tmp_path / "train" / "ours_30000" / "fuse.ply"
    fused.write_bytes(mesh)
    asset = msb.export(tmp_path)
    assert (asset.manifest.method, asset.manifest.primitive) == ("two_dgs", "triangle")
    assert asset.manifest.required_passes == {"standard": ("opaque_unlit",)}
    assert [source.path for source in asset.manifest.source.files] == ["train/ours_30000/fuse.ply"]
    assert msb.export(fused).manifest.method == "two_dgs"
    assert msb.export(fused, method="mesh").manifest.method == "mesh"
    splats = msb.export(file)
    assert (splats.manifest.method, set(splats.manifest.required_passes)) == (
        "two_dgs",
        {"reference", "dedicated"},
    )


def test_a_web_export_without_meta_uses_defaults_with_a_warning(tmp_path: Path) -> None:
    folder = write_web_export(tmp_path / "scene", level=2)
    assert msb.export(folder).manifest.settings["layout"].value == "synthetic"
    (folder / "meta.json").unlink()
    asset = msb.export(folder)
    assert asset.manifest.settings["layout"].value == "colmap"
    assert asset.manifest.settings["layout"].source == "default"
    assert asset.manifest.appearance["level"] == 2
    assert [w.code for w in asset.warnings] == ["CHECKPOINT_CONFIG_MISSING"]


def bomb(data: bytes) -> bytes:
    """Return a PNG that declares a size of 60,000 x 60,000."""
    head = data[12:16] + (60000).to_bytes(4, "big") * 2 + data[24:29]
    return data[:12] + head + zlib.crc32(head).to_bytes(4, "big") + data[33:]


def beyond_float32(data: bytes) -> bytes:
    """Return the decoder with a number beyond the range of float32."""
    return re.sub(rb'("b3": \[)[^,]+', rb"\g<1>1e39", data)


WEB: dict[str, tuple[str, Any, str]] = {
    "absent": ("lut0.png", None, "FILE_MISSING"),
    "cut PNG": ("lut1.png", lambda data: data[:-20], "DAMAGED"),
    "too small": ("lut0.png", Image.new("RGBA", (23, 1)), "DAMAGED"),
    "bomb": ("lut0.png", bomb, "DAMAGED"),
    "other level": ("lut1.png", Image.new("RGBA", (12, 1)), "DAMAGED"),
    "key missing": ("mlp_weights.json", b"{}", "DAMAGED"),
    "too long": ("mlp_weights.json", b"[" + b" " * (1 << 20) + b"]", "DAMAGED"),
    "no float32": ("mlp_weights.json", beyond_float32, "DAMAGED"),
    "other face count": ("meta.json", b'{"num_faces": 5}', "DAMAGED"),
    "wrong level": ("meta.json", b'{"level": 5}', "DAMAGED"),
}
"""A file of the export, its change, and the end of the error code."""


@pytest.mark.parametrize("case", WEB)
def test_a_damaged_web_export_names_the_file(case: str, tmp_path: Path) -> None:
    folder = write_web_export(tmp_path / "scene")
    name, content, code = WEB[case]
    if content is None:
        (folder / name).unlink()
    elif isinstance(content, Image.Image):
        content.save(folder / name)
    else:
        (folder / name).write_bytes(content((folder / name).read_bytes()) if callable(content) else content)
    error = read_rejected(folder)
    assert error.code == f"CHECKPOINT_{code}"
    assert name in str(error) or case in ("other face count", "wrong level", "no float32", "key missing")


def test_a_web_export_without_faces_is_empty(tmp_path: Path) -> None:
    folder = write_web_export(tmp_path / "scene")
    none = Mesh(np.zeros((3, 3), np.float32), np.zeros((0, 3), np.int64))
    write_mesh(none, folder / "mesh.ply", suffix=".ply")
    assert read_rejected(folder).code == "CHECKPOINT_DAMAGED"


@pytest.mark.parametrize("dtype", [np.float16, np.float64])
def test_other_float_types_become_float32(dtype: type, tmp_path: Path) -> None:
    model = models.triangle_splatting()
    model["opacity"] = model["opacity"].astype(dtype)
    asset = msb.export(write_model(tmp_path, "triangle_splatting", model))
    assert asset.buffers["opacity"].dtype == np.float32
    np.testing.assert_array_equal(asset.buffers["opacity"], model["opacity"][:, 0].astype(np.float32))
    assert ("CHECKPOINT_ROUNDED" in [w.code for w in asset.warnings]) == (dtype == np.float64)


def test_infinite_logits_are_opacities_of_exactly_0_and_1(tmp_path: Path) -> None:
    model = models.two_dts()
    model["_opacity"][:2, 0] = np.inf, -np.inf
    assert msb.export(write_model(tmp_path, "two_dts", model)).buffers["opacity"][0] == np.inf


def test_features_outside_0_to_1_are_warned_about(tmp_path: Path) -> None:
    model = models.diffsoup()
    model["feat_acc"][0, 0, 0] = 1.5
    asset = msb.export(write_model(tmp_path, "diffsoup", model))
    assert [w.code for w in asset.warnings] == ["CHECKPOINT_LAYOUT"]


@pytest.mark.parametrize(
    ("settings", "code"),
    [
        ({"gama": 2.0}, "SETTING_UNKNOWN"),
        ({"gamma": 0.5}, "SETTING_VALUE"),
        ({"sh_degree": 4}, "SETTING_VALUE"),
    ],
)
def test_wrong_settings_are_rejected(settings: dict[str, Any], code: str, tmp_path: Path) -> None:
    folder = write_model(tmp_path, "two_dts", models.two_dts())
    with pytest.raises(UsageError, match=code):
        msb.export(folder, settings=settings)


def test_a_degree_that_is_not_stored_is_rejected(tmp_path: Path) -> None:
    folder = write_model(tmp_path, "mesh_splatting", models.mesh_splatting(coefficients=3))
    with pytest.raises(UsageError, match="SETTING_VALUE"):
        msb.export(folder, settings={"sh_degree": 2})
    assert msb.export(folder, settings={"sh_degree": 0}).manifest.settings["sh_degree"].source == "flag"
