"""The npm package for three.js (integrations/js): its images in a browser, and its errors for bad files."""

import json
import re
import struct
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
from msb.engines import browser
from msb.engines.agreement import agreement
from msb.engines.dedicated_page.measure import FAITHFUL
from msb.engines.dedicated_page.page import make_page
from msb.engines.engine import opaque_frame
from msb.engines.webpage import camera_data
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
CONTROLS = ROOT / ".engines" / "node_modules" / "three" / "examples" / "jsm" / "controls" / "OrbitControls.js"
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

  // The camera of three.js that sees what one of ours sees.
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
    const own = await DedicatedPage.open(page, canvas), camera = cameraOf(view);
    await own.draw(camera, background);
    const seen = viewOf(camera, width, height), { degree, own: values } = own.look;
    const bytes = await own.drawing.pixels(seen, background, degree, values);
    own.dispose();
    return [{ title: own.title }, bytes];
  }

  async function example({ example }) {
    const frame = Object.assign(document.createElement("iframe"), { src: `example.html?url=${example}` });
    document.body.append(frame);
    await new Promise((done) => frame.addEventListener("load", done));
    const read = () => frame.contentDocument.getElementById("text").textContent;
    while (!read().includes(example)) await new Promise((done) => setTimeout(done, 20));
    const found = { text: read(), size: frame.contentDocument.getElementById("mesh").width };
    frame.remove();
    return [found];
  }

  await answer({});
  for (;;) {
    let asked;
    try { asked = await (await fetch("next")).json(); } catch { window.close(); break; }
    const answerer = asked.page ? dedicated : asked.example ? example : standard;
    try { await answer(...await answerer(asked)); } catch (error) {
      await answer({ said: error.message });
    }
  }
</script>
"""

MINIFIED = {"minified": 0.75, "several": 0.95, "nearest": 0.99}
"""Share of pixels within a level where pixels cover texels of noise. SwiftShader takes the level of mip maps
less exactly than a graphics card has to, in renderer `threejs` as well.
"""

Ask = Callable[..., browser.Answer]


@pytest.fixture(scope="module")
def ask() -> Iterator[Ask]:
    """Return what has the package open a file and answer; one browser for all tests."""
    need("threejs")
    content = {name: (WEB / "three" / name).read_bytes() for name in ("three.module.js", "three.core.js")}
    content |= {f"node_modules/three/build/{name}": data for name, data in content.items()}
    if CONTROLS.is_file():
        content["node_modules/three/examples/jsm/controls/OrbitControls.js"] = CONTROLS.read_bytes()
    content |= {
        name: (JS / name).read_bytes() for name in ("TriassetLoader.js", "DedicatedPage.js", "example.html")
    }
    content |= {f"shared/{name}": (WEB / name).read_bytes() for name in SHARED}
    content["page.html"] = HTML.encode()
    page = browser.Page(str(browser.find_browser()), content, "", software=True, webgpu=True)

    def opened(file: bytes, kind: str = "file", **task: Any) -> browser.Answer:
        content["a.triasset"] = file
        return page.ask({kind: "a.triasset", **task})

    yield opened
    page.close()


def packed(asset: Asset, tmp_path: Path) -> bytes:
    msb.save(asset, tmp_path / "a.triasset", overwrite=True)
    return (tmp_path / "a.triasset").read_bytes()


def shown(ask: Ask, asset: Asset, views: list[Camera], tmp_path: Path) -> Any:
    """Return how what three.js shows agrees with the standard tier."""
    theirs, ours, file = [], [], packed(asset, tmp_path)
    with msb.Renderer(asset, tier="standard") as renderer:
        for view in views:
            head, body = ask(file, view=camera_data(view), background=list(BACKGROUND))
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
    "what",
    ["splat_like", "two_dts", "two_dts, faces hidden", "triangle_splatting", "mesh_splatting", "grey"],
)
def test_models_look_as_on_the_standard_tier(what: str, ask: Ask, tmp_path: Path) -> None:
    if what == "splat_like":
        asset = msb.load(ROOT / "data_stubs" / "splat_like.triasset")
        views = msb.read_cameras(ROOT / "data_stubs" / "views.json")[:1]
    elif what == "grey":
        asset, views = mesh_asset(scene("large", 7)), [OFF_CENTRE]
    else:
        view = golden_views(what.partition(",")[0])[0]
        asset, views = exported(view.folder / "checkpoint"), [view.camera]
    if "hidden" in what:
        settings = {**asset.manifest.settings, "ste_threshold": StoredSetting(0.3, "flag")}
        asset = Asset(replace(asset.manifest, settings=settings), asset.buffers)
    found = shown(ask, asset, list(views), tmp_path)
    assert found.interior > 100
    assert found.interior_max <= 1
    assert found.covered_alike > 0.99


@pytest.mark.slow
@pytest.mark.oracle
@pytest.mark.parametrize("case", CASES)
def test_textures_look_as_on_the_standard_tier(case: str, ask: Ask, tmp_path: Path) -> None:
    asset = textured_asset(scene("large", 3), 4, **CASES[case])
    assert asset.manifest.version == "1.1"
    found = shown(ask, asset, [OFF_CENTRE], tmp_path)
    assert found.interior > 3000
    assert found.interior_within_a_level >= MINIFIED.get(case, 1)


@pytest.mark.slow
@pytest.mark.oracle
def test_the_methods_own_look_is_that_of_the_page(ask: Ask) -> None:
    view = golden_views("triangle_splatting")[0]
    page = make_page(exported(view.folder / "checkpoint"), name="a", settings=view.settings).encoded()
    task = {"view": camera_data(view.camera), "background": list(view.background)}
    head, body = ask(page, "page", **task)
    assert head == {"title": "Triangle-Splatting"}
    wanted = to_bytes(view.image)
    psnr = metrics.psnr(np.frombuffer(body, np.uint8).reshape(wanted.shape), wanted)
    assert psnr >= FAITHFUL
    assert "a.triasset" in ask(b"<html></html>", "page", **task).head["said"]


def changed(data: bytes, change: Callable[[dict[str, Any]], Any]) -> bytes:
    """Return a packed asset with another manifest of the same length."""
    (length,) = struct.unpack_from("<I", data, 22)
    start = 30 + sum(struct.unpack_from("<2H", data, 26))
    manifest = json.loads(data[start : start + length])
    change(manifest)
    text = json.dumps(manifest, separators=(",", ":")).encode()
    assert len(text) <= length
    return data[:start] + text.ljust(length) + data[start + length :]


@pytest.mark.slow
def test_what_is_wrong_with_a_file_is_one_sentence(ask: Ask, tmp_path: Path) -> None:
    good = packed(mesh_asset(scene("small", 1)), tmp_path)
    assert ask(good).head == {"up": [0, 1, 0], "method": "mesh"}
    trained = exported(golden_views("two_dts")[0].folder / "checkpoint")
    assert ask(packed(trained, tmp_path)).head == {"up": [0, -1, 0], "method": "two_dts"}

    def buffer(**values: Any) -> bytes:
        return changed(good, lambda manifest: manifest["buffers"]["indices"].update(values))

    def with_key(**values: Any) -> bytes:
        return changed(good, lambda manifest: manifest.update(values))

    last = good.index(b"PK\1\2")
    header = good.rindex(b"buffers/positions.bin", 0, last)  # the manifest names it, too
    at = header + len("buffers/positions.bin") + struct.unpack_from("<H", good, header - 2)[0]
    nan = good[:at] + struct.pack("<f", np.nan) + good[at + 4 :]
    decoded = {"method": "diffsoup", "required_passes": {}}
    far = changed(good, lambda manifest: manifest.update(vertex_count=7))
    wrong = [
        b"glTF" + good,
        good[: last - 1],
        good[:-1],
        good[:8] + b"\x08\0" + good[10:],
        good.replace(b"manifest.json", b"manifest.jsOn", 1),
        good.replace(b"{", b"[", 1),
        with_key(format="triassets"),
        with_key(version="2.0"),
        with_key(face_count=1.5),
        far,
        buffer(dtype="toString"),
        buffer(file="buffers/x.bin"),
        buffer(byte_length=4),
        buffer(offset=1 << 40),
        nan,
        with_key(**decoded),
        with_key(required_passes={"standard": ["other"]}),
    ]
    said = [ask(data).head["said"] for data in wrong]
    assert len(set(said)) == len(wrong)
    for sentence in said:
        assert sentence.startswith("TriassetLoader: a.triasset ")
        assert "\n" not in sentence


def test_the_package_is_whole_and_needs_nothing_but_three() -> None:
    about = json.loads((JS / "package.json").read_text())
    assert about["version"] == msb.__version__
    assert list(about["peerDependencies"]) == ["three"]
    assert "dependencies" not in about
    named = re.findall(r'"\./([^"]+)"', json.dumps(list(about["exports"].values())))
    assert len(named) == 5
    assert all((JS / name).is_file() for name in named)
    copied = {(JS / word).resolve() for word in about["scripts"]["shared"].split() if word.startswith("../")}
    assert copied == {ROOT / "LICENSE", *(WEB / name for name in SHARED)}
    imports = re.compile(r'^(?:import|\}).* from "([^"]+)";$', re.MULTILINE)
    assert imports.findall((JS / "TriassetLoader.js").read_text()) == ["three"]
    assert len((JS / "TriassetLoader.js").read_text().splitlines()) <= 300
    for name in SHARED:
        assert set(imports.findall((WEB / name).read_text())) <= {f"./{one}" for one in SHARED}
