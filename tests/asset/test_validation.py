"""`validate` reports all findings with their places."""

from pathlib import Path

import numpy as np
import pytest

from msb.asset import build_asset, load, validate
from msb.asset.texture import textures_of
from msb.asset.validation import check_values
from msb.errors import AssetError
from tests.corpus.forge import forge
from tests.corpus.good import Parts, mesh, parts, soup, textured


def report(changed: Parts, path: Path) -> list[tuple[str, str | None]]:
    changed.write_packed(path)
    return [(item.code.removeprefix("TRIASSET_"), item.pointer) for item in validate(path).findings]


def test_all_findings_of_a_manifest_are_reported(tmp_path: Path) -> None:
    bad = parts(mesh()).change("/topology", "quads").change("/color_space", 3).change("/lod", 0)
    bad.change("/buffers/color/dtype", "float64").change("/buffers/color/sha256", "x")
    assert report(bad, tmp_path / "a") == [
        ("FIELD", "/topology"),
        ("FIELD", "/color_space"),
        ("BUFFER", "/buffers/color/dtype"),
        ("BUFFER", "/buffers/color/sha256"),
        ("FIELD_UNKNOWN", "/lod"),
    ]


def test_all_findings_of_the_values_are_reported(tmp_path: Path) -> None:
    positions = mesh().buffers["positions"].copy()
    positions[1, 0] = 7
    indices = mesh().buffers["indices"].copy()
    indices[2, 1], indices[3, 0] = 4, 9
    bad = parts(mesh()).set_array("positions", positions).set_array("indices", indices)
    bad.change("/buffers/indices/sha256", "0" * 64)
    bad.write_packed(tmp_path / "a")
    findings = {item.code: item for item in validate(tmp_path / "a").findings}
    assert set(findings) == {
        f"TRIASSET_{code}" for code in ("DAMAGED", "BOUNDS", "BOUNDS", "INDEX_OUT_OF_RANGE")
    }
    index = findings["TRIASSET_INDEX_OUT_OF_RANGE"]
    assert (index.pointer, index.value, index.limit) == ("indices[2, 1]", 4, 3)
    assert findings["TRIASSET_DAMAGED"].pointer == "/buffers/indices/sha256"


def test_missing_textures_are_errors_and_uvs_outside_0_to_1_infos(tmp_path: Path) -> None:
    bad = parts(textured()).set_array("face_texture", np.array([0, 2], np.uint32))
    bad.set_array("uv", textured().buffers["uv"] * 2).write_packed(tmp_path / "a")
    uv, index = validate(tmp_path / "a").findings
    assert (uv.severity, uv.code, uv.pointer, uv.value) == ("info", "TRIASSET_VALUE_RANGE", "uv", 6)
    assert (index.code, index.pointer) == ("TRIASSET_INDEX_OUT_OF_RANGE", "face_texture[1]")
    with pytest.raises(AssetError, match="TRIASSET_INDEX_OUT_OF_RANGE"):
        textures_of(load(tmp_path / "a"))


def test_an_error_of_the_container_names_the_byte(tmp_path: Path) -> None:
    data = forge(parts(mesh()).entries())
    start = data.rindex(b"PK\x03\x04")
    (tmp_path / "a").write_bytes(data[: start + 8] + b"\x08" + data[start + 9 :])
    (item,) = validate(tmp_path / "a").findings
    assert (item.code, item.pointer) == ("TRIASSET_HOSTILE", f"byte {start}")


def test_bounds_rounded_to_float32_are_good_enough(tmp_path: Path) -> None:
    bounds = soup().manifest.bounds
    rounded = {key: [float(f"{value:.6g}") for value in getattr(bounds, key)] for key in ("min", "max")}
    assert report(parts(soup()).change("/bounds", rounded), tmp_path / "a") == []


def test_a_bad_element_in_the_second_chunk_is_found() -> None:
    vertices = (1 << 20) + 5
    positions = np.zeros((vertices, 3), np.float32)
    asset = build_asset({"positions": positions, "indices": np.zeros((1, 3), np.uint32)}, {})
    positions[-2, 1] = np.nan
    (item,) = check_values(asset)
    assert f" {3 * (vertices - 2) + 1}: nan" in item.message


@pytest.mark.parametrize("name", ["a\nb", "a\x1b[2J", "a\u202eb", "\udcff", " ", "a: b"])
def test_a_file_name_cannot_break_the_line(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    parts(mesh()).change("/method", "NeRF").write_packed(path)
    with pytest.raises(AssetError) as caught:
        load(path)
    assert str(caught.value).isprintable()
    assert str(caught.value).startswith(f"TRIASSET_FIELD: {tmp_path}")
