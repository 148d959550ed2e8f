"""The page of the dedicated tier without a browser: contents, storage of arrays, and reduced assets."""

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
from msb.engines.dedicated_page.measurement import Measurement
from msb.engines.dedicated_page.page import CheckView, Cost, DedicatedPage, make_page, read_page
from msb.engines.dedicated_page.reduction import quantise, select_faces
from msb.engines.dedicated_page.storage import restore, store
from msb.engines.hardware.packing import VIEW, pack
from msb.errors import InputError, Unsupported
from msb.reference import render_reference
from tests.conftest import ROOT
from tests.reference.golden import exported, golden_views, psnr
from tests.render.standard_scenes import mesh_asset, scene

METHODS = ("triangle_splatting", "two_dts", "mesh_splatting", "diffsoup")
RANDOM = np.random.default_rng(5)


def golden_asset(method: str) -> Asset:
    return exported(golden_views(method)[0].folder / "checkpoint")


def assert_same_bits(array: np.ndarray, expected: np.ndarray) -> None:
    assert (array.dtype, array.shape, array.tobytes()) == (expected.dtype, expected.shape, expected.tobytes())


FLOATS = {
    "plain": RANDOM.normal(size=(1000, 7)).astype(np.float32),
    "palette": RANDOM.choice(RANDOM.normal(size=200).astype(np.float32), (6000, 5)),
    "rows": RANDOM.normal(size=(300, 4)).astype(np.float32)[RANDOM.integers(0, 300, 9000)],
    "grid": (RANDOM.integers(-9000, 9000, (5000, 3)) / 256).astype(np.float32),
}


@pytest.mark.parametrize("how", FLOATS)
def test_floats_are_restored_exactly_from_every_encoding(how: str) -> None:
    array = FLOATS[how]
    stored = store(array)
    assert stored.head["how"] == how
    assert_same_bits(restore(json.loads(json.dumps(stored.head)), stored.data), array)
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
def test_other_arrays_are_restored_exactly(array: np.ndarray) -> None:
    stored = store(array)
    assert_same_bits(restore(stored.head, stored.data), array)


def test_streams_of_another_length_are_rejected() -> None:
    stored = store(FLOATS["plain"])
    with pytest.raises(ValueError, match="has"):
        restore(stored.head, zlib.compress(b"few"))
    with pytest.raises(ValueError, match="max_length"):
        restore({"bytes": -1}, b"")
    bomb = restore({**stored.head, "shape": [1, 1], "bytes": 4}, zlib.compress(bytes(1 << 24)))
    assert bomb.nbytes == 4


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_quantised_assets_are_stored_exactly_and_look_alike(method: str) -> None:
    view = golden_views(method)[0]
    rounded = quantise(golden_asset(method))
    assert rounded.manifest.face_count == golden_asset(method).manifest.face_count
    positions = store(rounded.buffers["positions"])
    assert positions.head["how"] in ("grid", "rows")
    assert_same_bits(restore(positions.head, positions.data), rounded.buffers["positions"])
    for name in ("f_dc", "f_rest", "opacity"):
        rows = rounded.buffers.get(name, np.zeros((1, 1)))
        assert all(len(np.unique(column)) <= 256 for column in rows.reshape(len(rows), -1).T)
    for name in ("features.lattice", "features.opacity"):
        assert rounded.buffers.get(name, np.zeros(1, np.uint8)).dtype == np.uint8
    before, after = (
        render_reference(asset, view.camera, view.background, view.settings).image
        for asset in (golden_asset(method), rounded)
    )
    assert psnr(after, before) > 40


@pytest.mark.parametrize("method", ["triangle_splatting", "diffsoup"])
def test_faces_without_a_contribution_can_be_removed(method: str) -> None:
    view, asset = golden_views(method)[0], golden_asset(method)
    frame = render_reference(asset, view.camera, view.background)
    assert frame.contribution.shape == (asset.manifest.face_count,)
    assert frame.contribution.sum() == pytest.approx(frame.alpha.sum(dtype=np.float64), rel=1e-5)
    visible = np.flatnonzero(frame.contribution)
    assert 0 < len(visible) < asset.manifest.face_count
    fewer = select_faces(asset, visible)
    assert fewer.manifest.face_count == len(visible)
    np.testing.assert_array_equal(render_reference(fewer, view.camera, view.background).image, frame.image)


def test_unreferenced_vertices_are_dropped_with_their_faces() -> None:
    asset = golden_asset("mesh_splatting")
    fewer = select_faces(asset, np.arange(10))
    corners = [a.buffers["positions"][a.buffers["indices"][:10]] for a in (asset, fewer)]
    np.testing.assert_array_equal(*corners)
    assert fewer.manifest.vertex_count == len(fewer.buffers["f_dc"]) < asset.manifest.vertex_count


def golden_page(method: str = "triangle_splatting", **options: Any) -> DedicatedPage:
    view = golden_views(method)[0]
    image = np.zeros((view.camera.height, view.camera.width, 3), np.uint8)
    tests = [CheckView(view.camera, (0, 0, 0), image)]
    options = {"name": "a", "tests": tests, "settings": view.settings, **options}
    return make_page(golden_asset(method), **options)


@pytest.mark.parametrize("method", METHODS)
def test_plans_refer_to_existing_arrays_buffers_and_modules(method: str) -> None:
    page = golden_page(method)
    content = json.loads(json.dumps(page.scene))["dedicated"]
    for plan in content["plans"]:
        steps = [*plan["passes"], *plan["band_passes"]]
        targets = {name for step in steps for name in step.get("targets", ())}
        bindings = [binding for step in steps for binding in step["bindings"]]
        targets |= {binding["name"] for binding in bindings if binding["kind"] == "store"}
        assert {binding["name"] for binding in bindings} <= {*plan["buffers"], *targets, "bands", "pixels"}
        assert max(plan["modules"][step["module"]] for step in steps) < len(content["modules"])
        assert {name for step in steps for name, _ in step.get("records", ())} <= set(plan["buffers"])
        assert set(plan["arrays"]) <= set(plan["buffers"])
        assert set(plan["arrays"].values()) <= set(content["arrays"])
    modes = [(plan["order"], plan["sampling"]) for plan in content["plans"]]
    assert modes[0] == ("tile", "official")
    assert len(modes) == (2 if method == "diffsoup" else 5)
    buffers = content["plans"][0]["buffers"]
    for name, head in content["arrays"].items():
        assert f'data-array="{name}"' in page.arrays or "shrunk" in head
        if name in buffers and "shrunk" not in head:
            assert buffers[name][0] >= np.prod(head["shape"]) * np.dtype(head["type"]).itemsize
    members = [name for name, *_ in content["view"]["members"]]
    assert members[: len(VIEW.names or ())] == list(VIEW.names or ())
    record = pack(golden_asset(method), {}).view_bytes(golden_views(method)[0].camera, (0, 0, 0))
    assert content["view"]["bytes"] == len(record)


@pytest.mark.slow
def test_settings_of_the_camera_record_can_be_changed_in_the_page() -> None:
    settings = {method: golden_page(method).scene["dedicated"]["settings"] for method in METHODS}
    names = {method: [setting["name"] for setting in entries] for method, entries in settings.items()}
    assert names == {
        "triangle_splatting": ["view_dir"],
        "two_dts": ["back_culling"],
        "mesh_splatting": [],
        "diffsoup": ["layout"],
    }
    assert [option["own"] for option in settings["diffsoup"][0]["options"]] == [{"flip": 0}, {"flip": 1}]


def test_a_page_is_read_back_and_its_name_is_escaped(tmp_path: Path) -> None:
    name = "</script><script>alert(1)</script> @ARRAYS@ @THREE@"
    page = golden_page(name=name, costs=[Cost("half", np.inf)])
    page.record("a browser", [np.inf])
    path = tmp_path / "page.html"
    path.write_bytes(page.to_bytes())
    text = path.read_text()
    assert "alert(1)</script>" not in text
    assert text.count('data-module="GLTFLoader.js"') == 1
    assert not re.findall(r"""<(?:script|link|img|iframe)[^>]*\s(?:src|href)""", text)
    assert "default-src 'none'" in text
    assert 'fetch("next")' not in text
    _, content, images = read_page(path)
    assert content["name"] == name
    assert content["dedicated"]["measured"] == {"by": "a browser", "psnr": [None]}
    assert len(images) == 1
    assert not images[0].any()


def test_files_that_are_not_valid_pages_are_rejected(tmp_path: Path) -> None:
    files = [b"", b"<html></html>", b'<script type="application/json" id="scene">{</script>']
    page = golden_page()
    (test,) = page.scene["dedicated"]["tests"]
    page.scene["dedicated"]["arrays"][test["image"]]["bytes"] = 0
    for height in (0, -1, 1.5, True):  # test views without pixels
        test["view"]["height"] = height
        files.append(page.to_bytes())
    path = tmp_path / "page.html"
    for data in files:
        path.write_bytes(data)
        with pytest.raises(InputError) as info:
            read_page(path)
        assert info.value.code == "FILE_NOT_RECOGNISED"


def test_a_mesh_file_has_no_dedicated_page() -> None:
    with pytest.raises(Unsupported) as info:
        make_page(mesh_asset(scene("small", 1)), name="mesh", settings={})
    assert info.value.code == "UNSUPPORTED_TIER"


def test_the_worst_view_is_infinite_only_if_all_views_are_equal() -> None:
    assert Measurement("b", "d", "rgba32float", [np.inf, 50.0, 60.0], []).worst == 50
    assert Measurement("b", "d", "rgba16float", [np.inf], []).worst == np.inf


def test_shrunk_triangles_are_stored_once() -> None:
    view = next(view for view in golden_views("two_dts") if view.settings["gamma_rescale"])
    asset = exported(view.folder / "checkpoint")
    content = make_page(quantise(asset), name="a", settings=view.settings).scene["dedicated"]
    assert set(content["arrays"]["positions"]) == {"shrunk"}
    assert content["arrays"]["stored positions"]["how"] in ("grid", "rows")
    assert content["standard"]["positions"] == "stored positions"
    assert content["standard"]["shown"] == "shown faces"


SCRIPT = """
import { Dedicated } from "./dedicated.js";
const device = {
  pushErrorScope() {}, popErrorScope: async () => null,
  createShaderModule({ code }) { if (code === "bad") throw new Error("rejected"); return {}; },
};
const plan = (module) => ({ modules: { module }, passes: [], band_passes: [], arrays: {}, buffers: {} });
const modules = { good: "good", bad: "bad" }, plans = [plan("good"), plan("bad"), plan("good")];
const model = Object.assign(new Dedicated(), {
  device, about: { modules, plans, arrays: {} }, held: new Map(), compiled: new Map(), groups: new Map(),
});
const states = [];
const record = (error) => states.push([error ? error.message : null, model.number, model.wanted]);
await model.use(0);
await model.use(1).then(() => record(null), record);
const failing = model.use(1).then(() => record(null), record);
await model.use(2);
await failing;
record(null);
console.log(JSON.stringify(states));
"""


def test_after_a_compile_error_the_page_keeps_the_plan_in_use_or_a_later_choice(tmp_path: Path) -> None:
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    (tmp_path / "package.json").write_text('{"type": "module"}')
    (tmp_path / "test.js").write_text(SCRIPT)
    for name in ("camera.js", "dedicated.js"):
        shutil.copy(ROOT / "msb/engines/web" / name, tmp_path)
    process = subprocess.run(["node", tmp_path / "test.js"], capture_output=True, text=True, check=True)
    assert json.loads(process.stdout) == [["rejected", 0, 0], ["rejected", 0, 2], [None, 2, 2]]
