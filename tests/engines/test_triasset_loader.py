"""The npm package for three.js (integrations/js): images in a browser, and messages about malformed files."""

import json
import re
import shutil
import struct
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from msb import metrics
from msb.asset import Asset
from msb.asset.manifest import StoredSetting
from msb.asset.origin import with_origin
from msb.engines import browser
from msb.engines.agreement import agreement
from msb.engines.dedicated_page.measurement import FAITHFUL
from msb.engines.dedicated_page.page import make_page
from msb.engines.engine import opaque_frame
from msb.engines.webpage import camera_to_json
from msb.render.images import to_bytes
from msb.scenes import Camera
from tests.conftest import ROOT
from tests.engines.conftest import need
from tests.engines.test_engines import OFF_CENTRE
from tests.reference.golden import exported, golden_views
from tests.render.standard_scenes import BACKGROUND, mesh_asset, scene
from tests.render.textured_scenes import CASES, textured_asset

JS = ROOT / "integrations" / "js"
WEB = ROOT / "msb" / "engines" / "web"
SHARED = ("camera.js", "store.js", "dedicated.js")

HTML = """<!DOCTYPE html>
<meta charset="utf-8">
<canvas></canvas>
<script type="importmap">{"imports": {"three": "./three.module.js"}}</script>
<script type="module">
  import * as THREE from "three";
  import { DedicatedPage, viewOf } from "./DedicatedPage.js";
  import { TriassetLoader } from "./TriassetLoader.js";

  const answer = async (head, ...parts) =>
    fetch("answer", { method: "POST", body: new Blob([JSON.stringify(head), "\\n", ...parts]) });
  const canvas = document.querySelector("canvas");
  const renderer = new THREE.WebGLRenderer({ canvas, preserveDrawingBuffer: true });

  // Returns the three.js camera with the intrinsics and the pose of one of our cameras.
  function cameraOf({ width: w, height: h, fx, fy, cx, cy, world_to_camera: m }) {
    const camera = new THREE.PerspectiveCamera(), near = 0.01, far = 5000;
    camera.matrixAutoUpdate = false;
    const turned = m.map((row, k) => (k === 1 || k === 2 ? row.map((value) => -value) : row));
    camera.matrix.set(...turned.flat()).invert();
    camera.projectionMatrix.set(
      2 * fx / w, 0, 1 - 2 * cx / w, 0, 0, 2 * fy / h, 2 * cy / h - 1, 0,
      0, 0, (far + near) / (near - far), 2 * far * near / (near - far), 0, 0, -1, 0);
    camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
    camera.updateMatrixWorld(true);
    return camera;
  }

  async function standard({ file, view, background }) {
    const mesh = await new TriassetLoader().loadAsync(file), scene = new THREE.Scene().add(mesh);
    if (!view) return [{ up: mesh.up.toArray(), method: mesh.userData.triasset.method }];
    mesh.frustumCulled = false;
    const { width, height } = view, gl = renderer.getContext(), bytes = new Uint8Array(4 * width * height);
    renderer.setPixelRatio(1);
    renderer.setSize(width, height, false);
    renderer.setClearColor(new THREE.Color().setRGB(...background, THREE.SRGBColorSpace), 0);
    renderer.render(scene, cameraOf(view));
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    return [{}, bytes];
  }

  async function dedicated({ page, view, background }) {
    const canvas = document.createElement("canvas"), { width, height } = view;
    Object.assign(canvas, { width, height });
    const model = await DedicatedPage.open(page, canvas), camera = cameraOf(view);
    await model.draw(camera, background);
    const { degree, own: values } = model.record;
    const bytes = await model.drawing.pixels(viewOf(camera, width, height), background, degree, values);
    model.dispose();
    return [{ title: model.title }, bytes];
  }

  await answer({});
  for (;;) {
    let task;
    try { task = await (await fetch("next")).json(); } catch { window.close(); break; }
    try { await answer(...await (task.page ? dedicated : standard)(task)); } catch (error) {
      await answer({ message: error.message });
    }
  }
</script>
"""

# Minimum share of pixels that differ by at most one level, for textures of noise with several texels per
# pixel. SwiftShader chooses the mip level less exactly than a graphics card.
MINIFIED = {"minified": 0.75, "several": 0.95, "nearest": 0.99}

Ask = Callable[..., browser.Answer]


@pytest.fixture(scope="module")
def ask() -> Iterator[Ask]:
    """Return a function that sends a task and a file to the package; one browser serves all tests."""
    need("threejs")
    content = {name: (WEB / "three" / name).read_bytes() for name in ("three.module.js", "three.core.js")}
    content |= {name: (JS / name).read_bytes() for name in ("TriassetLoader.js", "DedicatedPage.js")}
    content |= {f"shared/{name}": (WEB / name).read_bytes() for name in SHARED}
    content["page.html"] = HTML.encode()
    page = browser.Page(str(browser.find_browser()), content, "", software=True, webgpu=True)

    def send(file: bytes, kind: str = "file", **task: Any) -> browser.Answer:
        content["a.triasset"] = file
        return page.ask({kind: "a.triasset", **task})

    yield send
    page.close()


def packed_bytes(asset: Asset, tmp_path: Path) -> bytes:
    msb.save(asset, tmp_path / "a.triasset", overwrite=True)
    return (tmp_path / "a.triasset").read_bytes()


def compare_images(ask: Ask, asset: Asset, views: list[Camera], tmp_path: Path) -> Any:
    """Return the agreement of three.js with our standard-tier renderer."""
    theirs, ours, file = [], [], packed_bytes(asset, tmp_path)
    with msb.Renderer(asset, tier="standard") as renderer:
        for view in views:
            head, body = ask(file, view=camera_to_json(view), background=list(BACKGROUND))
            assert head == {}
            rows = np.frombuffer(body, np.uint8).reshape(view.height, view.width, 4)[::-1]
            image = np.divide(rows[..., :3], 255, dtype=np.float32)
            hit = rows[..., 3] > 0
            theirs.append(opaque_frame(image, hit, hit.astype(np.float32), BACKGROUND, None, {}))
            ours.append(renderer.render(view, BACKGROUND))
    return agreement(theirs, ours)


@pytest.mark.slow
@pytest.mark.oracle
@pytest.mark.parametrize(
    "model",
    ["splat_like", "two_dts", "two_dts, faces hidden", "triangle_splatting", "mesh_splatting", "grey"],
)
def test_models_look_as_on_the_standard_tier(model: str, ask: Ask, tmp_path: Path) -> None:
    if model == "splat_like":
        asset = msb.load(ROOT / "data_stubs" / "splat_like.triasset")
        views = msb.read_cameras(ROOT / "data_stubs" / "views.json")[:1]
    elif model == "grey":
        asset, views = mesh_asset(scene("large", 7)), [OFF_CENTRE]
    else:
        view = golden_views(model.partition(",")[0])[0]
        asset, views = exported(view.folder / "checkpoint"), [view.camera]
    if "hidden" in model:
        settings = {**asset.manifest.settings, "ste_threshold": StoredSetting(0.3, "flag")}
        asset = Asset(replace(asset.manifest, settings=settings), asset.buffers)
    result = compare_images(ask, asset, list(views), tmp_path)
    assert result.interior > 100
    assert result.interior_max <= 1
    assert result.covered_alike > 0.99


@pytest.mark.slow
@pytest.mark.oracle
@pytest.mark.parametrize("case", CASES)
def test_textures_look_as_on_the_standard_tier(case: str, ask: Ask, tmp_path: Path) -> None:
    asset = textured_asset(scene("large", 3), 4, **CASES[case])
    assert asset.manifest.version == "1.1"
    result = compare_images(ask, asset, [OFF_CENTRE], tmp_path)
    assert result.interior > 3000
    assert result.interior_within_a_level >= MINIFIED.get(case, 1)


@pytest.mark.slow
@pytest.mark.oracle
def test_an_origin_is_the_position_of_the_mesh(ask: Ask, tmp_path: Path) -> None:
    origin = (500_000.0, 4_649_776.0, 100.0)
    asset = with_origin(mesh_asset(scene("large", 7)), origin)
    result = compare_images(ask, asset, [OFF_CENTRE.relative_to(-np.array(origin))], tmp_path)
    assert result.interior > 100
    assert result.interior_max <= 1
    assert result.covered_alike > 0.99


@pytest.mark.slow
@pytest.mark.oracle
def test_native_rendering_is_that_of_the_page(ask: Ask) -> None:
    view = golden_views("triangle_splatting")[0]
    page = make_page(exported(view.folder / "checkpoint"), name="a", settings=view.settings).to_bytes()
    task = {"view": camera_to_json(view.camera), "background": list(view.background)}
    head, body = ask(page, "page", **task)
    assert head == {"title": "Triangle-Splatting"}
    official = to_bytes(view.image)
    assert metrics.psnr(np.frombuffer(body, np.uint8).reshape(official.shape), official) >= FAITHFUL
    assert "a.triasset" in ask(b"<html></html>", "page", **task).head["message"]


def with_manifest(data: bytes, change: Callable[[dict[str, Any]], Any]) -> bytes:
    """Return a packed asset with a changed manifest, padded to the same length."""
    (length,) = struct.unpack_from("<I", data, 22)
    start = 30 + sum(struct.unpack_from("<2H", data, 26))
    manifest = json.loads(data[start : start + length])
    change(manifest)
    text = json.dumps(manifest, separators=(",", ":")).encode()
    assert len(text) <= length
    return data[:start] + text.ljust(length) + data[start + length :]


@pytest.mark.slow
def test_each_malformed_file_has_its_message(ask: Ask, tmp_path: Path) -> None:
    good = packed_bytes(mesh_asset(scene("small", 1)), tmp_path)
    assert ask(good).head == {"up": [0, 1, 0], "method": "mesh"}
    trained = exported(golden_views("two_dts")[0].folder / "checkpoint")
    assert ask(packed_bytes(trained, tmp_path)).head == {"up": [0, -1, 0], "method": "two_dts"}

    def with_buffer(**values: Any) -> bytes:
        return with_manifest(good, lambda manifest: manifest["buffers"]["indices"].update(values))

    def with_key(**values: Any) -> bytes:
        return with_manifest(good, lambda manifest: manifest.update(values))

    last = good.index(b"PK\1\2")
    header = good.rindex(b"buffers/positions.bin", 0, last)  # the manifest contains the name, too
    at = header + len("buffers/positions.bin") + struct.unpack_from("<H", good, header - 2)[0]
    nan = good[:at] + struct.pack("<f", np.nan) + good[at + 4 :]
    bad = [
        b"glTF" + good,
        good[: last - 1],
        good[:-1],
        good[:8] + b"\x08\0" + good[10:],
        good.replace(b"manifest.json", b"manifest.jsOn", 1),
        good.replace(b"{", b"[", 1),
        with_key(format="triassets"),
        with_key(version="2.0"),
        with_key(face_count=1.5),
        with_key(vertex_count=7),
        with_buffer(dtype="toString"),
        with_buffer(file="buffers/x.bin"),
        with_buffer(byte_length=4),
        with_buffer(offset=1 << 40),
        nan,
        with_key(method="diffsoup", required_passes={}),
        with_key(required_passes={"standard": ["other"]}),
        with_key(origin=[1, 2]),
    ]
    messages = [ask(data).head["message"] for data in bad]
    assert len(set(messages)) == len(bad)
    for message in messages:
        assert message.startswith("TriassetLoader: a.triasset ")
        assert "\n" not in message


def test_the_package_is_complete_and_needs_only_three() -> None:
    about = json.loads((JS / "package.json").read_text())
    assert about["version"] == msb.__version__
    assert list(about["peerDependencies"]) == ["three"]
    assert "dependencies" not in about
    exports = re.findall(r'"\./([^"]+)"', json.dumps(list(about["exports"].values())))
    assert len(exports) == 5
    assert all((JS / name).is_file() for name in exports)
    copied = {(JS / word).resolve() for word in about["scripts"]["shared"].split() if word.startswith("../")}
    assert copied == {ROOT / "LICENSE", *(WEB / name for name in SHARED)}
    imports = re.compile(r'^(?:import|\}).* from "([^"]+)";$', re.MULTILINE)
    assert imports.findall((JS / "TriassetLoader.js").read_text()) == ["three"]
    for name in SHARED:
        assert set(imports.findall((WEB / name).read_text())) <= {f"./{other}" for other in SHARED}


def test_the_example_finds_its_modules_after_the_commands_of_the_readme(tmp_path: Path) -> None:
    if shutil.which("npm") is None:
        pytest.skip("npm is not installed")
    package, web = tmp_path / "integrations" / "js", tmp_path / "msb" / "engines" / "web"
    shutil.copytree(JS, package, ignore=shutil.ignore_patterns("node_modules", "shared"))
    shutil.copytree(WEB, web)
    shutil.copy(ROOT / "LICENSE", tmp_path)
    readme = (package / "README.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```console\n(.*?)^```", readme, re.MULTILINE | re.DOTALL)
    commands = [line.partition("#")[0].split() for line in block.splitlines()]
    assert commands[-1][:3] == ["python3", "-m", "http.server"]
    for words in commands[:-1]:
        if words[1] == "run":  # npm install needs a network
            subprocess.run(words, cwd=package, check=True, capture_output=True)
    # Follow the imports from the page.
    pattern = re.compile(r'^\s*(?:import|\}).* from "(\.[^"]+)";$', re.MULTILINE)
    loaded, waiting = set(), [package / "example.html"]
    while waiting:
        path = waiting.pop()
        loaded.add(path)
        found = {(path.parent / name).resolve() for name in pattern.findall(path.read_text(encoding="utf-8"))}
        waiting += found - loaded
    assert (package / "shared" / "dedicated.js").resolve() in loaded
