"""The page of the dedicated tier in a browser: its images, its messages and its measurement."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msb import metrics
from msb.engines.browser import VARIABLE
from msb.engines.dedicated_page.measurement import FAITHFUL
from msb.engines.dedicated_page.page import MODES, STOPS, BakedMesh, CheckView, DedicatedPage, make_page
from msb.engines.dedicated_page.reduction import quantise
from msb.engines.engine import engine_mesh
from msb.engines.hardware.packing import pack
from msb.engines.hardware.renderer import HardwareRenderer
from msb.meshes.assets import asset_from_mesh, mesh_from_asset
from msb.render.images import to_bytes
from tests.cli.conftest import Msb, msb
from tests.engines.conftest import need
from tests.reference.golden import View, exported, golden_views

InBrowser = Callable[..., Any]

pytestmark = [pytest.mark.slow, pytest.mark.oracle]

__all__ = ["msb"]

METHODS = ("triangle_splatting", "two_dts", "mesh_splatting", "diffsoup")


def golden_scenes() -> list[list[View]]:
    """Return the golden views grouped by model and settings; each group becomes one page."""
    groups: dict[Any, list[View]] = {}
    for method in METHODS:
        for view in golden_views(method):
            groups.setdefault((view.folder, tuple(sorted(view.settings.items()))), []).append(view)
    return list(groups.values())


def page_of(views: list[View], **options: Any) -> DedicatedPage:
    tests = [CheckView(view.camera, view.background, to_bytes(view.image)) for view in views]
    asset = exported(views[0].folder / "checkpoint")
    return make_page(asset, name="a", settings=views[0].settings, tests=tests, **options)


# The pages that are drawn, by the name of their first view. Other pages are not drawn, because a browser
# needs seconds to compile the shaders of a page. test_hardware.py draws every view with the same plans.
DRAWN = {
    *("torus_sh0_white/0", "bumpy_sphere_sh3/0"),
    *("ring_solid/1", "soup_everything/2", "soup_everything/3"),
    *("ico_l2_white/0", "lattice_l5_black/0"),
}


def test_the_browser_compiles_the_shaders_of_every_page(with_webgpu: InBrowser) -> None:
    texts = {text for views in golden_scenes() for text in page_of(views).scene["dedicated"]["modules"]}
    assert len(texts) > 100
    script = f"""
        const device = await (await navigator.gpu.requestAdapter()).requestDevice();
        const errors = [];
        for (const code of {json.dumps(sorted(texts))}) {{
          const {{ messages }} = await device.createShaderModule({{ code }}).getCompilationInfo();
          errors.push(...messages.filter(({{ type }}) => type === "error").map(({{ message }}) => message));
        }}
        const broken = device.createShaderModule({{ code: "fn broken( {{" }});
        return [errors, (await broken.getCompilationInfo()).messages.length];"""
    errors, broken = with_webgpu(b"<html><body></body></html>", script)
    assert errors == []
    assert broken > 0


@pytest.mark.parametrize(
    "views",
    [views for views in golden_scenes() if views[0].name in DRAWN],
    ids=lambda views: f"{views[0].folder.name}-{views[0].name}",
)
def test_golden_views_are_faithful_to_the_official_image(views: list[View], with_webgpu: InBrowser) -> None:
    script = f"""
        await ready;
        const images = [];
        for (let k = 0; k < {len(views)}; k += 1) images.push([...await pixelsOf(k)]);
        return images;"""
    for view, pixels in zip(views, with_webgpu(page_of(views).to_bytes(), script), strict=True):
        official = to_bytes(view.image)
        assert metrics.psnr(np.array(pixels, np.uint8).reshape(official.shape), official) >= FAITHFUL


def test_the_page_computes_the_same_camera_record(in_browser: InBrowser) -> None:
    projections = {}
    for views in golden_scenes():
        packed = pack(exported(views[0].folder / "checkpoint"), views[0].settings)
        projections[packed.model.program, packed.model.method_values.get("flip")] = packed, views[:2]
    assert len(projections) == 5
    script = """
        await ready;
        const read = (view) => [...new Uint8Array(viewRecord(
          about.view, about.plans[0].scale, view, [0.25, 0.5, 1], about.view.degree, about.view.own))];
        return about.tests.map((test) => read(test.view));"""
    for packed, views in projections.values():
        for view, record in zip(views, in_browser(page_of(views).to_bytes(), script), strict=True):
            pair = packed.view_bytes(view.camera, (0.25, 0.5, 1.0)), bytes(record)
            # Adding 0 makes -0 equal to 0.
            ours, theirs = ((np.frombuffer(data, np.float32) + 0).view(np.int32).astype(int) for data in pair)
            # Tangents may differ by one unit in the last place between mathematical libraries.
            assert np.abs(ours - theirs).max() <= 1


CHECKSUMS = """
    await ready;
    const sums = {};
    for (const name of Object.keys(about.plans[0].buffers)) {
      if (!(name in about.arrays)) continue;
      const array = await arrayOf(name, {}), words = new Uint32Array(array.buffer, 0, array.byteLength / 4);
      let sum = 0;
      for (let i = 0; i < words.length; i += 1) sum = (sum * 31 + words[i]) >>> 0;
      sums[name] = sum;
    }
    return sums;
"""


def checksum(array: np.ndarray) -> int:
    total = 0
    for word in np.ascontiguousarray(array).reshape(-1).view(np.uint32).tolist():
        total = (total * 31 + word) & 0xFFFFFFFF
    return total


@pytest.mark.parametrize("method", METHODS[1:])
def test_the_page_decodes_the_packed_arrays(in_browser: InBrowser, method: str) -> None:
    view = golden_views(method)[2 if method == "two_dts" else 0]
    asset = quantise(exported(view.folder / "checkpoint"))
    settings = {**view.settings, **({"gamma_rescale": True, "gamma": 7.0} if method == "two_dts" else {})}
    packed = pack(asset, settings)
    page = make_page(asset, name="a", settings=settings)
    if method == "two_dts":
        assert set(page.scene["dedicated"]["arrays"]["positions"]) == {"shrunk"}
    # Do not run main(), because it removes the stored arrays from the document.
    data = page.to_bytes().replace(b'return typeof main === "function" && main();', b"return true;")
    sums = in_browser(data, CHECKSUMS)
    for name, array in packed.arrays.items():
        assert sums[name] == checksum(array), name


@pytest.mark.parametrize(
    ("method", "label", "facts"),
    [
        ("triangle_splatting", "standard mesh", "Triangle-Splatting, 2,420 faces"),
        ("diffsoup", "grey triangles", "DiffSoup, 1,600 faces"),
    ],
)
def test_without_webgpu_the_page_explains_it_and_shows_a_mesh(
    method: str, label: str, facts: str, in_browser: InBrowser
) -> None:
    views = golden_views(method)[:1]
    note, label_shown, facts_shown, colors, greys = in_browser(
        page_of(views, cameras=[views[0].camera]).to_bytes(),
        """
        await ready;
        showNow();
        const copy = document.createElement("canvas").getContext("2d");
        copy.drawImage(canvas, 0, 0, 300, 150);
        const data = copy.getImageData(0, 0, 300, 150).data, colors = new Set(), greys = new Set();
        for (let i = 0; i < data.length; i += 4) {
          const [r, g, b] = data.subarray(i, i + 3);
          (r === g && g === b ? greys : colors).add(65536 * r + 256 * g + b);
        }
        return [byId("note").textContent, byId("shown").selectedOptions[0].textContent,
          byId("facts").textContent, colors.size, greys.size];
        """,
    )
    assert "WebGPU" in note
    assert (label_shown, facts_shown) == (label, facts)
    assert (greys > 10 and colors == 0) if method == "diffsoup" else colors > 10


def test_the_baked_mesh_can_be_shown_beside_the_others(in_browser: InBrowser) -> None:
    views = golden_views("triangle_splatting")[:1]
    mesh = mesh_from_asset(exported(views[0].folder / "checkpoint"))
    colors = np.tile(np.uint8([200, 50, 20]), (len(mesh.vertices), 1))
    glb = engine_mesh(asset_from_mesh(replace(mesh, vertex_colors=colors)), {}).to_bytes(".glb")
    page = page_of(views, cameras=[views[0].camera], baked=BakedMesh(glb, 32.25, 18.06))
    first, options, *counts, label, note = in_browser(
        page.to_bytes(),
        """
        await ready;
        const select = byId("shown"), first = select.value, counts = [];
        choose("0");
        for (const what of ["baked", "wipe-baked", "standard"]) {
          select.value = what;
          layOut();
          showNow();
          const copy = document.createElement("canvas").getContext("2d");
          copy.drawImage(canvas, 0, 0, 300, 150);
          const data = copy.getImageData(0, 0, 300, 150).data;
          const isRed = (i) => [200, 50, 20].every((value, k) => data[4 * i + k] === value);
          counts.push([...Array(300 * 150).keys()].filter(isRed).length);
        }
        select.value = "wipe-baked";
        layOut();
        const label = byId("wipe").querySelector("b:last-of-type").textContent;
        const options = [...select.options].map((option) => option.textContent);
        return [first, options, ...counts, label, byId("note").textContent];
        """,
    )
    assert first == "baked", "there is no WebGPU in this browser"
    assert len(options) == 5
    assert [text for text in options if "dB" in text] == ["standard mesh (18.1 dB)", "baked mesh (32.3 dB)"]
    baked, wiped, standard = counts
    assert baked == wiped > 1000
    assert standard == 0
    assert label == "baked mesh"
    assert "msb bake" in note


@pytest.mark.parametrize(
    ("method", "modes"),
    [("triangle_splatting", [MODES[1], MODES[3], MODES[0]]), ("two_dts", [MODES[2], MODES[4]])],
    ids=["triangle_splatting", "two_dts"],
)
def test_modes_of_the_page_are_those_of_the_renderer(
    method: str, modes: list[tuple[Any, Any]], with_webgpu: InBrowser
) -> None:
    """The panel reports progress while the page opens, and the last choice of a mode is drawn.

    The shaders of an earlier choice may still be compiling.
    """
    need("wgpu")
    view = golden_views(method)[0]
    watch = b"""<script>
        const progress = [], observer = new MutationObserver(
          () => progress.push([byId("name").textContent, byId("facts").textContent]));
        observer.observe(byId("facts"), { childList: true });
        </script></body>"""
    before, _, after = page_of([view]).to_bytes().rpartition(b"</body>")
    script = f"""
        const images = [];
        await ready;
        observer.disconnect();
        const facts = byId("facts").textContent, disabled = byId("cameras").disabled;
        const away = setMode({{ sampling: "engine" }});
        await setMode({{ sampling: "official" }});
        await away;
        const back = native.number;
        for (const [order, sampling] of {json.dumps(modes)}) {{
          await setMode({{ order, sampling }});
          images.push([...await pixelsOf(0)]);
        }}
        return [images, progress, facts, disabled, back];"""
    images, progress, facts, disabled, back = with_webgpu(before + watch + after, script)
    assert back == 0
    assert {name for name, _ in progress} == {"a"}
    assert len({text for _, text in progress}) > 2
    assert facts.endswith(f", {exported(view.folder / 'checkpoint').manifest.face_count:,} faces")
    assert not disabled
    for (order, sampling), pixels in zip(modes, images, strict=True):
        options = {"order": order, "sampling": sampling, "stops": STOPS, "settings": view.settings}
        with HardwareRenderer(exported(view.folder / "checkpoint"), **options) as renderer:
            ours = to_bytes(renderer.render(view.camera, view.background).image)
        psnr = metrics.psnr(np.array(pixels, np.uint8).reshape(ours.shape), ours)
        assert psnr > 55, (order, sampling)


def test_pages_are_measured_when_written_and_again(msb: Msb, tmp_path: Path) -> None:
    need("threejs")
    checkpoint = golden_views("triangle_splatting")[-1].folder / "checkpoint"
    page = tmp_path / "page.html"
    first = msb("web", "-o", page, "--tier", "dedicated", "--quantise", "--json", "-", checkpoint, status=0)
    assert first.json["measured"]["worst"] > 40  # the near training cameras lose most by rounding
    assert [cost["psnr"] > 40 for cost in first.json["costs"]] == [True]
    assert "--quantise" in first.err
    # tests/test_docs_commands.py tests a page that passes.
    again = msb("web", "--verify", page, "--at-least", "99", "-q", "--json", "-", status=1)
    assert again.err.startswith("GATE_FAILED: ")
    assert again.json["measured"]["worst"] == pytest.approx(first.json["measured"]["worst"], abs=0.01)


def test_without_a_browser_a_page_is_written_but_not_measured(msb: Msb, tmp_path: Path) -> None:
    checkpoint = golden_views("triangle_splatting")[-1].folder / "checkpoint"
    page, wrong = tmp_path / "page.html", tmp_path / "wrong.html"
    no_browser = {VARIABLE: "no-such-browser"}
    web = ("web", "-o", page, "--tier", "dedicated", "--faces", 1000, checkpoint)
    assert "warning: " in msb(*web, status=0, **no_browser).err
    assert b'"measured": null' in page.read_bytes()
    assert msb("web", "--verify", page, status=5, **no_browser).err.startswith("DEVICE_NOT_FOUND: ")
    assert msb(*web).err.startswith("OUTPUT_EXISTS")
    wrong.write_text("<html></html>")
    msb("web", "--verify", wrong, status=3)


TOUCH = """
    await ready;
    const states = [];
    const record = () => { const { eye, forward } = axes(state.view);
      states.push({
        eye: eye.toArray(), forward: forward.toArray(), distance: state.target.distanceTo(eye) });
    };
    const finger = (type, id, x, y) => canvas.dispatchEvent(
      new PointerEvent(type, { clientX: x, clientY: y, pointerId: id, bubbles: true, pointerType: "touch" }));
    canvas.setPointerCapture = () => {};
    record();
    finger("pointerdown", 1, 300, 300); finger("pointerdown", 2, 400, 300);
    finger("pointermove", 1, 250, 300); finger("pointermove", 2, 450, 300);
    record();
    finger("pointermove", 1, 300, 300); finger("pointermove", 2, 500, 300);
    record();
    finger("pointerup", 1, 0, 0); finger("pointerup", 2, 0, 0);
    byId("drag").value = "looks";
    finger("pointerdown", 3, 300, 300); finger("pointermove", 3, 350, 320); finger("pointerup", 3, 0, 0);
    record();
    window.dispatchEvent(new KeyboardEvent("keydown", { key: "w" })); fly(performance.now()); record();
    window.dispatchEvent(new KeyboardEvent("keyup", { key: "w" }));
    return [states, pressed.size];
"""


def test_two_fingers_zoom_and_move_and_keys_fly(in_browser: InBrowser) -> None:
    views = golden_views("triangle_splatting")[:1]
    (start, near, moved, turned, flown), pressed = in_browser(page_of(views).to_bytes(), TOUCH)
    assert near["distance"] == pytest.approx(start["distance"] / 2)
    assert moved["distance"] == pytest.approx(near["distance"])
    assert np.linalg.norm(np.subtract(moved["eye"], near["eye"])) > 0.05 * near["distance"]
    assert turned["eye"] == pytest.approx(moved["eye"])
    assert np.dot(turned["forward"], moved["forward"]) < 0.999
    step = np.subtract(flown["eye"], turned["eye"])
    assert np.dot(step, turned["forward"]) == pytest.approx(np.linalg.norm(step))
    assert np.linalg.norm(step) > 0
    assert pressed == 0


@pytest.mark.parametrize("when", ["idle", "compiling"])
def test_a_lost_device_is_reported(when: str, with_webgpu: InBrowser) -> None:
    script = f"""
        await ready;
        const {{ lost }} = native;
        const changing = "{when}" === "compiling" ? setMode({{ order: "none" }}) : null;
        native.device.destroy();
        await Promise.all([lost, changing]);
        await new Promise((done) => setTimeout(done, 100));
        const state = [byId("note").hidden, byId("note").textContent, byId("shown").value];
        const event = new Promise((done) => canvas.addEventListener("webglcontextlost", done));
        gl.getExtension("WEBGL_lose_context").loseContext();
        await event;
        return [...state, byId("note").textContent];"""
    page = page_of(golden_views("triangle_splatting")[:1])
    hidden, note, choice, without_webgl = with_webgpu(page.to_bytes(), script)
    assert (hidden, choice) == (False, "standard")
    assert "lost" in note
    assert "WebGL" not in note
    assert "WebGL" in without_webgl
