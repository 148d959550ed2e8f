"""The page of the dedicated tier: what is in it, how its arrays lie there, smaller assets."""

import json
import re
import shutil
import subprocess
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msb.asset import Asset
from msb.engines.dedicated_page.measure import Measured
from msb.engines.dedicated_page.page import CheckView, Cost, DedicatedPage, make_page, read_page
from msb.engines.dedicated_page.smaller import quantised, with_faces
from msb.engines.dedicated_page.stored import restore, store
from msb.engines.hardware.packing import VIEW, pack
from msb.errors import InputError, Unsupported
from msb.reference import render_reference
from tests.conftest import ROOT
from tests.reference.golden import exported, golden_views, psnr
from tests.render.standard_scenes import mesh_asset, scene

METHODS = ("triangle_splatting", "two_dts", "mesh_splatting", "diffsoup")
RANDOM = np.random.default_rng(5)


def golden(method: str) -> Asset:
    return exported(golden_views(method)[0].folder / "checkpoint")


def same_bits(one: np.ndarray, other: np.ndarray) -> bool:
    return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()


GRID = (RANDOM.integers(-9000, 9000, (5000, 3)) / 256).astype(np.float32)
ARRAYS = {
    "plain": RANDOM.normal(size=(1000, 7)).astype(np.float32),
    "palette": RANDOM.choice(RANDOM.normal(size=200).astype(np.float32), (6000, 5)),
    "rows": RANDOM.normal(size=(300, 4)).astype(np.float32)[RANDOM.integers(0, 300, 9000)],
    "grid": GRID,
}


@pytest.mark.parametrize("how", ARRAYS)
def test_floats_come_back_bit_for_bit_from_the_smallest_form(how: str) -> None:
    array = ARRAYS[how]
    array[:3] = array[3:6]
    stored = store(array)
    assert stored.head["how"] == how
    assert same_bits(restore(json.loads(json.dumps(stored.head)), stored.data), array)
    if how != "plain":
        assert len(stored.data) < 0.6 * array.nbytes


@pytest.mark.parametrize(
    "array",
    [
        RANDOM.integers(0, 2**32, (100, 3), dtype=np.uint32),
        np.arange(30000, dtype=np.uint32).reshape(-1, 3),
        RANDOM.integers(0, 255, (64, 3), dtype=np.uint8),
        RANDOM.integers(0, 2, 77, dtype=np.uint8),
        np.zeros((1, 1), np.float32),
        np.array([[np.inf, -0.0, np.nan]], np.float32),
        np.full((9000, 2), -0.0, np.float32),
        np.full((9000, 3), 1e30, np.float32) * np.array([1, 1e-38, -1], np.float32),
    ],
)
def test_everything_else_comes_back_too(array: np.ndarray) -> None:
    stored = store(array)
    assert same_bits(restore(stored.head, stored.data), array)


def test_streams_that_are_longer_or_shorter_than_said_are_refused() -> None:
    stored = store(ARRAYS["plain"])
    with pytest.raises(ValueError, match="has"):
        restore(stored.head, zlib.compress(b"few"))
    bomb = restore({**stored.head, "shape": [1, 1], "bytes": 4}, zlib.compress(bytes(1 << 24)))
    assert bomb.nbytes == 4


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_rounded_assets_are_packed_without_a_loss_and_look_alike(method: str) -> None:
    view = golden_views(method)[0]
    rounded = quantised(golden(method))
    assert rounded.manifest.face_count == golden(method).manifest.face_count
    positions = store(rounded.buffers["positions"])
    assert positions.head["how"] in ("grid", "rows")
    assert same_bits(restore(positions.head, positions.data), rounded.buffers["positions"])
    for name in ("f_dc", "f_rest", "opacity"):
        rows = rounded.buffers.get(name, np.zeros((1, 1)))
        assert all(len(np.unique(column)) <= 256 for column in rows.reshape(len(rows), -1).T)
    for name in ("features.lattice", "features.opacity"):
        assert rounded.buffers.get(name, np.zeros(1, np.uint8)).dtype == np.uint8
    frames = [
        render_reference(asset, view.camera, view.background, view.settings)
        for asset in (golden(method), rounded)
    ]
    assert psnr(frames[1].image, frames[0].image) > 40


@pytest.mark.parametrize("method", ["triangle_splatting", "diffsoup"])
def test_faces_without_a_contribution_are_not_missed(method: str) -> None:
    view = golden_views(method)[0]
    asset = golden(method)
    frame = render_reference(asset, view.camera, view.background)
    assert frame.contribution.shape == (asset.manifest.face_count,)
    assert frame.contribution.sum() == pytest.approx(frame.alpha.sum(dtype=np.float64), rel=1e-5)
    kept = np.flatnonzero(frame.contribution)
    assert 0 < len(kept) < asset.manifest.face_count
    fewer = with_faces(asset, kept)
    assert fewer.manifest.face_count == len(kept)
    np.testing.assert_array_equal(render_reference(fewer, view.camera, view.background).image, frame.image)


def the_page(method: str = "triangle_splatting", **options: Any) -> DedicatedPage:
    view = golden_views(method)[0]
    image = np.zeros((view.camera.height, view.camera.width, 3), np.uint8)
    tests = [CheckView(view.camera, (0, 0, 0), image)]
    options = {"name": "a", "tests": tests, "settings": view.settings, **options}
    return make_page(golden(method), **options)


@pytest.mark.parametrize("method", METHODS)
def test_the_plan_in_the_page_names_arrays_buffers_and_modules_that_are_there(method: str) -> None:
    page = the_page(method)
    about = json.loads(json.dumps(page.scene))["dedicated"]
    plan = about["plans"][0]
    packed = pack(golden(method), {})
    for other in about["plans"]:
        steps = [*other["passes"], *other["band_passes"]]
        drawn = {name for step in steps for name in step.get("targets", ())}
        written = {one["name"] for step in steps for one in step["bindings"] if one["kind"] == "store"}
        for step in steps:
            assert other["modules"][step["module"]] < len(about["modules"])
            for binding in step["bindings"]:
                assert binding["name"] in {*other["buffers"], *drawn, *written, "bands", "pixels"}
            for records, _ in step.get("records", ()):
                assert records in other["buffers"]
        assert set(other["arrays"]) <= set(other["buffers"])
        assert set(other["arrays"].values()) <= set(about["arrays"])
    modes = [(other["order"], other["sampling"]) for other in about["plans"]]
    assert modes[0] == ("tile", "official")
    assert len(modes) == (2 if method == "diffsoup" else 5)
    for name, head in about["arrays"].items():
        assert f'data-array="{name}"' in page.arrays or "shrunk" in head
        if name in plan["buffers"] and "shrunk" not in head:
            assert plan["buffers"][name][0] >= np.prod(head["shape"]) * np.dtype(head["type"]).itemsize
    members = about["view"]["members"]
    assert [name for name, *_ in members][: len(VIEW.names or ())] == list(VIEW.names or ())
    assert about["view"]["bytes"] == len(packed.view_bytes(golden_views(method)[0].camera, (0, 0, 0)))


def test_settings_that_change_the_record_alone_are_live() -> None:
    found = {method: the_page(method).scene["dedicated"]["settings"] for method in METHODS}
    assert [one["name"] for one in found["triangle_splatting"]] == ["view_dir"]
    assert [one["name"] for one in found["two_dts"]] == ["back_culling"]
    assert found["mesh_splatting"] == []
    assert [one["name"] for one in found["diffsoup"]] == ["layout"]
    assert [one["own"] for one in found["diffsoup"][0]["options"]] == [{"flip": 0}, {"flip": 1}]


def test_a_page_is_read_back_and_names_cannot_leave_their_place(tmp_path: Path) -> None:
    name = "</script><script>alert(1)</script> @ARRAYS@ @THREE@"
    page = the_page(name=name, costs=[Cost("half", np.inf)])
    page.record("a browser", [np.inf])
    path = tmp_path / "page.html"
    path.write_bytes(page.encoded())
    text = path.read_text()
    assert "alert(1)</script>" not in text
    assert not re.findall(r"""<(?:script|link|img|iframe)[^>]*\s(?:src|href)""", text)
    assert "default-src 'none'" in text
    assert 'fetch("next")' not in text
    _, found, images = read_page(path)
    assert found["name"] == name
    assert found["dedicated"]["measured"] == {"by": "a browser", "psnr": [None]}
    assert len(images) == 1
    assert not images[0].any()


@pytest.mark.parametrize(
    "data", [b"", b"<html></html>", b'<script type="application/json" id="scene">{</script>']
)
def test_a_file_that_is_no_such_page_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "page.html"
    path.write_bytes(data)
    with pytest.raises(InputError) as info:
        read_page(path)
    assert info.value.code == "FILE_NOT_RECOGNISED"


def test_test_views_without_pixels_are_refused_before_their_images_are_unpacked(tmp_path: Path) -> None:
    page = the_page()
    (test,) = page.scene["dedicated"]["tests"]
    page.scene["dedicated"]["arrays"][test["image"]]["bytes"] = 0
    path = tmp_path / "page.html"
    for height in (0, -1, 1.5, True):
        test["view"]["height"] = height
        path.write_bytes(page.encoded())
        with pytest.raises(InputError) as info:
            read_page(path)
        assert info.value.code == "FILE_NOT_RECOGNISED"
    with pytest.raises(ValueError, match="max_length"):
        restore({"bytes": -1}, b"")


def test_a_mesh_has_no_such_page() -> None:
    with pytest.raises(Unsupported) as info:
        make_page(mesh_asset(scene("small", 1)), name="mesh", settings={})
    assert info.value.code == "UNSUPPORTED_TIER"


def test_the_worst_view_is_that_of_those_that_differ() -> None:
    assert Measured("b", "d", "rgba32float", [np.inf, 50.0, 60.0], []).worst == 50
    assert Measured("b", "d", "rgba16float", [np.inf], []).worst == np.inf


def test_vertices_that_no_face_has_are_dropped() -> None:
    asset = golden("mesh_splatting")
    fewer = with_faces(asset, np.arange(10))
    corners = [a.buffers["positions"][a.buffers["indices"][:10]] for a in (asset, fewer)]
    np.testing.assert_array_equal(*corners)
    assert fewer.manifest.vertex_count == len(fewer.buffers["f_dc"]) < asset.manifest.vertex_count


def test_shrunk_triangles_are_stored_once() -> None:
    view = next(view for view in golden_views("two_dts") if view.settings["gamma_rescale"])
    asset = exported(view.folder / "checkpoint")
    page = make_page(quantised(asset), name="a", settings=view.settings)
    arrays = page.scene["dedicated"]["arrays"]
    assert set(arrays["positions"]) == {"shrunk"}
    assert arrays["stored positions"]["how"] in ("grid", "rows")
    assert page.scene["dedicated"]["standard"]["positions"] == "stored positions"
    assert page.scene["dedicated"]["standard"]["shown"] == "shown faces"


SCRIPT = """
import { Dedicated } from "./dedicated.js";
const device = {
  pushErrorScope() {}, popErrorScope: async () => null,
  createShaderModule({ code }) { if (code === "bad") throw new Error("refused"); return {}; },
};
const plan = (module) => ({ modules: { module }, passes: [], band_passes: [], arrays: {}, buffers: {} });
const modules = { good: "good", bad: "bad" }, plans = [plan("good"), plan("bad"), plan("good")];
const made = Object.assign(new Dedicated(), {
  device, about: { modules, plans, arrays: {} }, held: new Map(), compiled: new Map(), groups: new Map(),
});
const found = [];
const add = (error) => found.push([error ? error.message : null, made.number, made.wanted]);
await made.use(0);
await made.use(1).then(() => add(null), add);
const failing = made.use(1).then(() => add(null), add);
await made.use(2);
await failing;
add(null);
console.log(JSON.stringify(found));
"""


def test_after_a_plan_that_does_not_compile_the_one_that_is_drawn_is_wanted(tmp_path: Path) -> None:
    """So that `measure` has a plan to return to; one that was chosen meanwhile stays chosen."""
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    (tmp_path / "package.json").write_text('{"type": "module"}')
    (tmp_path / "test.js").write_text(SCRIPT)
    for name in ("camera.js", "dedicated.js"):
        shutil.copy(ROOT / "msb/engines/web" / name, tmp_path)
    done = subprocess.run(["node", tmp_path / "test.js"], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == [["refused", 0, 0], ["refused", 0, 2], [None, 2, 2]]
