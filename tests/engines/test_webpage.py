"""The three.js page of a mesh: the contents of the file, and its image in a browser."""

import base64
import hashlib
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


def colored_asset() -> Asset:
    mesh = scene("large", 7)
    return mesh_asset(mesh, random_colors(7, len(mesh[0])))


def make_page(**options: Any) -> bytes:
    return webpage.page(engine_mesh(colored_asset(), {}).to_bytes(".glb"), name="mesh.triasset", **options)


def test_everything_is_in_the_file() -> None:
    text = webpage.page(b"glTF", name="a").decode()
    assert not re.findall(r"""(?:src|href)\s*=\s*["'](?!data:)""", text.split("<!--")[0])
    assert base64.b64encode(b"glTF").decode() in text
    for part in ("Permission is hereby granted", "GLTFLoader", "three.js authors"):
        assert part in text
    assert 'fetch("next")' not in text
    assert b'fetch("next")' in webpage.page(served=True)


def test_three_js_is_the_published_one() -> None:
    folder = ROOT / "msb" / "engines" / "web" / "three"
    origin = tomllib.loads((folder / "ORIGIN.toml").read_text())
    assert set(origin["files"]) == {path.name for path in folder.iterdir()} - {"ORIGIN.toml"}
    for name, entry in origin["files"].items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == entry["sha256"], name
    assert f"const REVISION = '{webpage.three_revision()}';" in (folder / "three.core.js").read_text()[:1000]
    assert origin["version"].split(".")[1] == webpage.three_revision()
    assert (folder / "LICENSE").read_text().rstrip() in webpage.page().decode()


SCREENSHOT = "await ready; showNow(); return canvas.toDataURL('image/png');"


def pixels(url: str) -> np.ndarray[Any, Any]:
    data = base64.b64decode(url.partition(",")[2])
    return np.asarray(Image.open(BytesIO(data)).convert("RGB"), np.float64)


def test_a_listed_camera_shows_the_image_of_our_renderer(in_browser: InBrowser) -> None:
    ours = msb.render(colored_asset(), VIEW, background=BACKGROUND)
    page = make_page(cameras=[VIEW], background=BACKGROUND)
    screenshot = pixels(in_browser(page, SCREENSHOT, "?camera=0"))
    assert screenshot.shape == (150, 200, 3)
    difference = np.abs(screenshot - to_bytes(ours.image)).max(axis=2)
    # SwiftShader snaps corners to 1/16 pixel, so some edge pixels differ.
    assert (difference <= 1).mean() > 0.995


def test_colours_taken_as_linear_come_out_lighter(in_browser: InBrowser) -> None:
    page = make_page(cameras=[VIEW])
    exact, linear = (
        pixels(in_browser(page, SCREENSHOT, query)) for query in ("?camera=0", "?camera=0&colors=linear")
    )
    light = exact > 50  # in darker pixels the sRGB curve turns one level into several levels
    expected = 255 * (1.055 * (exact / 255) ** (1 / 2.4) - 0.055)
    assert np.abs(linear - expected)[light].max() < 2
    assert linear.mean() > exact.mean() + 20


def test_a_mesh_without_colours_is_lit_in_grey(in_browser: InBrowser) -> None:
    asset = mesh_asset(scene("large", 7))
    ours = to_bytes(msb.render(asset, VIEW, background=(0, 0, 1)).image)
    bare = BytesIO()  # a GLB of another program, without colours
    write_mesh(
        Mesh(asset.buffers["positions"], asset.buffers["indices"].astype(np.int64)), bare, suffix=".glb"
    )
    for mesh in (engine_mesh(asset, {}).to_bytes(".glb"), bare.getvalue()):
        page = webpage.page(mesh, name="mesh", cameras=[VIEW], background=(0, 0, 1))
        screenshot = pixels(in_browser(page, SCREENSHOT, "?camera=0"))
        assert (np.abs(screenshot - ours).max(axis=2) <= 2).mean() > 0.99


MOUSE = """
    await ready;
    const states = [];
    const record = () => {
      const { eye, right, down, forward } = axes(state.view);
      const away = state.target.clone().sub(eye);
      states.push({ eye: eye.toArray(), distance: away.length(), ahead: away.normalize().dot(forward),
        up: -down.dot(upVector()), skew: right.dot(down) });
    };
    const send = (type, x, y, more = {}) => canvas.dispatchEvent(
      new PointerEvent(type, { clientX: x, clientY: y, pointerId: 1, bubbles: true, ...more }));
    const drag = (x, y, more = {}) => {
      send("pointerdown", 100, 100, more); send("pointermove", x, y, { buttons: 1, ...more });
      send("pointerup", 0, 0); record();
    };
    canvas.setPointerCapture = () => {};
    record();
    drag(180, 140);
    drag(100, 9000);
    canvas.dispatchEvent(new WheelEvent("wheel", { deltaY: -100, cancelable: true, bubbles: true }));
    record();
    drag(150, 100, { shiftKey: true });
    window.dispatchEvent(new KeyboardEvent("keydown", { key: "f" })); record();
    return states;
"""


def test_the_mouse_turns_zooms_and_moves(in_browser: InBrowser) -> None:
    start, turned, over_the_pole, near, moved, fitted = in_browser(make_page(), MOUSE)
    for view in (start, turned, over_the_pole, near, moved):
        assert view["ahead"] == pytest.approx(1, abs=1e-6), "the target stays in the middle"
        assert view["skew"] == pytest.approx(0, abs=1e-9)
        assert view["up"] > 0, "the model is never upside down"
    assert turned["distance"] == pytest.approx(start["distance"])
    assert np.linalg.norm(np.subtract(turned["eye"], start["eye"])) > 0.1 * start["distance"]
    assert near["distance"] == pytest.approx(start["distance"] * np.exp(-0.15), rel=1e-6)
    assert moved["distance"] == pytest.approx(near["distance"])
    assert fitted["eye"] == pytest.approx(start["eye"])


def test_an_empty_page_shows_a_dropped_file(in_browser: InBrowser) -> None:
    data = base64.b64encode(engine_mesh(colored_asset(), {}).to_bytes(".glb")).decode()
    script = f"""
        await ready;
        const bytes = Uint8Array.from(atob("{data}"), (c) => c.charCodeAt(0));
        const transfer = new DataTransfer();
        transfer.items.add(new File([bytes], "dropped.glb"));
        window.dispatchEvent(new DragEvent("drop", {{ dataTransfer: transfer, cancelable: true }}));
        for (let i = 0; i < 500 && !state.view; i += 1) await new Promise((done) => setTimeout(done, 20));
        return [byId("name").textContent, byId("facts").textContent, byId("message").textContent];
    """
    assert in_browser(webpage.page(), script) == ["dropped.glb", "60 faces", ""]
    message = in_browser(
        webpage.page(b"not a glb", name="bad.glb"), "await ready; return byId('message').textContent;"
    )
    assert message.startswith("bad.glb ")


def test_the_page_opens_at_the_first_camera(in_browser: InBrowser) -> None:
    script = (
        "await ready; return [byId('cameras').value, state.view.width, state.fitted, byId('panel').open];"
    )
    page = make_page(cameras=[VIEW, camera(40, 30, 20.0, (20.0, 15.0))])
    assert in_browser(page, script) == ["0", 200, False, False]
    assert in_browser(page, script, "?camera=1", (1280, 800)) == ["1", 40, False, True]
    assert in_browser(make_page(), script)[::2] == ["", True]


def test_a_lost_webgl_context_is_reported_until_it_is_restored(in_browser: InBrowser) -> None:
    script = """
        await ready;
        const pause = (done) => setTimeout(done, 100);  // let three.js handle the event first
        const heard = (name) => new Promise((done) => canvas.addEventListener(name, () => pause(done)));
        const screenshot = () => { showNow(); return canvas.toDataURL(); };
        const before = screenshot(), losing = gl.getExtension("WEBGL_lose_context"), messages = [];
        for (const [name, act] of [["lost", "loseContext"], ["restored", "restoreContext"]]) {
          const event = heard(`webglcontext${name}`);
          losing[act]();
          await event;
          messages.push(byId("message").textContent);
        }
        return [messages, screenshot() === before];"""
    messages, same = in_browser(make_page(cameras=[VIEW]), script)
    assert "WebGL" in messages[0]
    assert messages[1] == ""
    assert same
