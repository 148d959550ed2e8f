"""The three.js page: what is in the file, and what a browser makes of it."""

import base64
import hashlib
import json
import re
import tomllib
from collections.abc import Callable
from io import BytesIO
from typing import Any

import numpy as np
import pytest
from PIL import Image

import msb
from msb.asset import Asset
from msb.engines import webpage
from msb.engines.engine import engine_mesh
from msb.meshes import Mesh, write_mesh
from msb.render.images import to_bytes
from tests.conftest import ROOT
from tests.render.standard_scenes import BACKGROUND, camera, mesh_asset, random_colors, scene

InBrowser = Callable[..., Any]

pytestmark = pytest.mark.slow

VIEW = camera(200, 150, 160.0, (91.0, 70.0))


def large() -> Asset:
    mesh = scene("large", 7)
    return mesh_asset(mesh, random_colors(7, len(mesh[0])))


def the_page(**options: Any) -> bytes:
    return webpage.page(engine_mesh(large(), {}).encoded(".glb"), name="mesh.triasset", **options)


def test_everything_is_in_the_file() -> None:
    text = webpage.page(b"glTF", name="a").decode()
    assert not re.findall(r"""(?:src|href)\s*=\s*["'](?!data:)""", text.split("<!--")[0])
    assert not re.findall(r"""<(?:script|link|img|iframe)[^>]*\s(?:src|href)""", text)
    assert "default-src 'none'" in text
    assert base64.b64encode(b"glTF").decode() in text
    for part in ("Permission is hereby granted", "GLTFLoader", "three.js authors"):
        assert part in text
    assert 'fetch("next")' not in text
    assert b'fetch("next")' in webpage.page(served=True)


def test_names_cannot_leave_their_place() -> None:
    name = "</script><script>alert(1)</script> @GLB@ @THREE@"
    text = webpage.page(name=name).decode()
    assert "alert(1)</script>" not in text
    found = re.search(r'<script type="application/json" id="scene">(.*?)</script>', text)
    assert json.loads(found[1])["name"] == name
    assert text.count('data-module="GLTFLoader.js"') == 1


def test_three_js_is_what_was_published_and_says_so() -> None:
    folder = ROOT / "msb" / "engines" / "web" / "three"
    origin = tomllib.loads((folder / "ORIGIN.toml").read_text())
    there = {path.name for path in folder.iterdir()} - {"ORIGIN.toml"}
    assert set(origin["files"]) == there
    for name, about in origin["files"].items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == about["sha256"], name
    assert f"const REVISION = '{webpage.three_revision()}';" in (folder / "three.core.js").read_text()[:1000]
    assert origin["version"].split(".")[1] == webpage.three_revision()
    assert (folder / "LICENSE").read_text().rstrip() in webpage.page().decode()


SHOWN = "await ready; showNow(); return canvas.toDataURL('image/png');"


def pixels(url: str) -> np.ndarray[Any, Any]:
    data = base64.b64decode(url.partition(",")[2])
    return np.asarray(Image.open(BytesIO(data)).convert("RGB"), np.float64)


def test_a_camera_of_the_list_shows_what_our_renderer_draws(in_browser: InBrowser) -> None:
    ours = msb.render(large(), VIEW, background=BACKGROUND)
    page = the_page(cameras=[VIEW], background=BACKGROUND)
    shown = pixels(in_browser(page, SHOWN, "?camera=0"))
    assert shown.shape == (150, 200, 3)
    difference = np.abs(shown - to_bytes(ours.image)).max(axis=2)
    # SwiftShader snaps corners to 1/16 pixel.
    assert (difference <= 1).mean() > 0.995


def test_colours_taken_as_linear_come_out_lighter(in_browser: InBrowser) -> None:
    page = the_page(cameras=[VIEW])
    exact, linear = (
        pixels(in_browser(page, SHOWN, query)) for query in ("?camera=0", "?camera=0&colors=linear")
    )
    light = exact > 50  # below, a byte of ours is many of theirs
    wanted = 255 * (1.055 * (exact / 255) ** (1 / 2.4) - 0.055)
    assert np.abs(linear - wanted)[light].max() < 2
    assert linear.mean() > exact.mean() + 20


def test_a_mesh_without_colours_is_lit_in_grey(in_browser: InBrowser) -> None:
    asset = mesh_asset(scene("large", 7))
    ours = to_bytes(msb.render(asset, VIEW, background=(0, 0, 1)).image)
    bare = BytesIO()  # as somebody's file that is dropped on the page
    write_mesh(
        Mesh(asset.buffers["positions"], asset.buffers["indices"].astype(np.int64)), bare, suffix=".glb"
    )
    for mesh in (engine_mesh(asset, {}).encoded(".glb"), bare.getvalue()):
        page = webpage.page(mesh, name="mesh", cameras=[VIEW], background=(0, 0, 1))
        shown = pixels(in_browser(page, SHOWN, "?camera=0"))
        assert (np.abs(shown - ours).max(axis=2) <= 2).mean() > 0.99


HANDS = """
    await ready;
    const seen = [];
    const look = () => {
      const { eye, right, down, forward } = axes(state.view);
      const away = state.target.clone().sub(eye);
      seen.push({ eye: eye.toArray(), distance: away.length(), ahead: away.normalize().dot(forward),
        up: -down.dot(upVector()), skew: right.dot(down), width: state.view.width });
    };
    const at = (type, x, y, more = {}) => canvas.dispatchEvent(
      new PointerEvent(type, { clientX: x, clientY: y, pointerId: 1, bubbles: true, ...more }));
    canvas.setPointerCapture = () => {};
    look();
    at("pointerdown", 100, 100); at("pointermove", 180, 140, { buttons: 1 }); at("pointerup", 0, 0);
    look();
    at("pointerdown", 100, 100); at("pointermove", 100, 9000, { buttons: 1 }); at("pointerup", 0, 0);
    look();
    canvas.dispatchEvent(new WheelEvent("wheel", { deltaY: -100, cancelable: true, bubbles: true })); look();
    at("pointerdown", 100, 100, { shiftKey: true });
    at("pointermove", 150, 100, { buttons: 1, shiftKey: true }); at("pointerup", 0, 0); look();
    window.dispatchEvent(new KeyboardEvent("keydown", { key: "f" })); look();
    return seen;
"""


def test_hands_turn_zoom_and_move(in_browser: InBrowser) -> None:
    start, turned, over, near, moved, fitted = in_browser(the_page(), HANDS)
    for seen in (start, turned, over, near, moved):
        assert seen["ahead"] == pytest.approx(1, abs=1e-6), "the target stays in the middle"
        assert seen["skew"] == pytest.approx(0, abs=1e-9)
        assert seen["up"] > 0, "never upside down"
    assert turned["distance"] == pytest.approx(start["distance"])
    assert np.linalg.norm(np.subtract(turned["eye"], start["eye"])) > 0.1 * start["distance"]
    assert near["distance"] == pytest.approx(start["distance"] * np.exp(-0.15), rel=1e-6)
    assert moved["distance"] == pytest.approx(near["distance"])
    assert fitted["eye"] == pytest.approx(start["eye"])


def test_an_empty_page_takes_a_dropped_file(in_browser: InBrowser) -> None:
    data = base64.b64encode(engine_mesh(large(), {}).encoded(".glb")).decode()
    script = f"""
        await ready;
        const before = byId("message").textContent;
        const bytes = Uint8Array.from(atob("{data}"), (c) => c.charCodeAt(0));
        const transfer = new DataTransfer();
        transfer.items.add(new File([bytes], "dropped.glb"));
        window.dispatchEvent(new DragEvent("drop", {{ dataTransfer: transfer, cancelable: true }}));
        for (let i = 0; i < 500 && !state.view; i += 1) await new Promise((done) => setTimeout(done, 20));
        return [before, byId("name").textContent, byId("facts").textContent, byId("message").textContent];
    """
    assert in_browser(webpage.page(), script) == ["Drop a .glb here", "dropped.glb", "60 faces", ""]


def test_a_file_that_is_none_is_told(in_browser: InBrowser) -> None:
    page = webpage.page(b"not a glb", name="bad.glb")
    said = in_browser(page, "await ready; return byId('message').textContent;")
    assert said.startswith("bad.glb ")


def test_it_opens_at_the_first_camera_that_was_given(in_browser: InBrowser) -> None:
    script = (
        "await ready; return [byId('cameras').value, state.view.width, state.fitted, byId('panel').open];"
    )
    page = the_page(cameras=[VIEW, camera(40, 30, 20.0, (20.0, 15.0))])
    assert in_browser(page, script) == ["0", 200, False, False]
    assert in_browser(page, script, "?camera=1", (1280, 800)) == ["1", 40, False, True]
    assert in_browser(the_page(), script)[::2] == ["", True]


def test_where_webgl_is_lost_it_says_that_nothing_is_drawn_until_it_is_back(in_browser: InBrowser) -> None:
    script = """
        await ready;
        const pause = (done) => setTimeout(done, 100);  // a context comes back only after its loss was told
        const heard = (name) => new Promise((done) => canvas.addEventListener(name, () => pause(done)));
        const picture = () => { showNow(); return canvas.toDataURL(); };
        const before = picture(), losing = gl.getExtension("WEBGL_lose_context"), said = [];
        for (const [name, act] of [["lost", "loseContext"], ["restored", "restoreContext"]]) {
          const told = heard(`webglcontext${name}`);
          losing[act]();
          await told;
          said.push(byId("message").textContent);
        }
        return [said, picture() === before];"""
    said, same = in_browser(the_page(cameras=[VIEW]), script)
    assert "WebGL" in said[0]
    assert said[1] == ""
    assert same
