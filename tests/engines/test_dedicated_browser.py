"""The page of the dedicated tier in a browser: what it draws, what it says, and how it is measured."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msb import metrics
from msb.engines.browser import VARIABLE
from msb.engines.dedicated_page.measure import FAITHFUL
from msb.engines.dedicated_page.page import MODES, STOPS, BakedLook, CheckView, DedicatedPage, make_page
from msb.engines.dedicated_page.smaller import quantised
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


def scenes() -> list[list[View]]:
    """Return the golden views by their model and settings: one page each."""
    found: dict[Any, list[View]] = {}
    for method in METHODS:
        for view in golden_views(method):
            found.setdefault((view.folder, tuple(sorted(view.settings.items()))), []).append(view)
    return list(found.values())


def page_of(views: list[View], **options: Any) -> DedicatedPage:
    tests = [CheckView(view.camera, view.background, to_bytes(view.image)) for view in views]
    asset = exported(views[0].folder / "checkpoint")
    return make_page(asset, name="a", settings=views[0].settings, tests=tests, **options)


DRAWN = {
    *("torus_sh0_white/0", "bumpy_sphere_sh3/0"),
    *("ring_solid/1", "soup_everything/2", "soup_everything/3"),
    *("ico_l2_white/0", "lattice_l5_black/0"),
}
"""First views of the pages that are drawn: a browser takes seconds to compile the shaders of each. The
renderer `wgpu` draws every view by the same plan (test_hardware.py); two more pages
are held to what that one draws, below."""


def drawn_scenes() -> list[list[View]]:
    return [views for views in scenes() if views[0].name in DRAWN]


def test_the_browser_takes_the_shaders_of_every_page(with_webgpu: InBrowser) -> None:
    """Also of those that are not drawn."""
    texts = {text for views in scenes() for text in page_of(views).scene["dedicated"]["modules"]}
    assert len(texts) > 100
    script = f"""
        const device = await (await navigator.gpu.requestAdapter()).requestDevice();
        const said = [];
        for (const code of {json.dumps(sorted(texts))}) {{
          const {{ messages }} = await device.createShaderModule({{ code }}).getCompilationInfo();
          said.push(...messages.filter(({{ type }}) => type === "error").map(({{ message }}) => message));
        }}
        const broken = device.createShaderModule({{ code: "fn broken( {{" }});
        return [said, (await broken.getCompilationInfo()).messages.length];"""
    said, broken = with_webgpu(b"<html><body></body></html>", script)
    assert said == []
    assert broken > 0


@pytest.mark.parametrize("views", drawn_scenes(), ids=lambda views: f"{views[0].folder.name}-{views[0].name}")
def test_golden_views_are_faithful_to_the_official_image(views: list[View], with_webgpu: InBrowser) -> None:
    script = f"""
        await ready;
        const found = [];
        for (let k = 0; k < {len(views)}; k += 1) found.push([...await pixelsOf(k)]);
        return found;"""
    for view, pixels in zip(views, with_webgpu(page_of(views).encoded(), script), strict=True):
        wanted = to_bytes(view.image)
        psnr = metrics.psnr(np.array(pixels, np.uint8).reshape(wanted.shape), wanted)
        assert psnr >= FAITHFUL


def test_the_page_computes_the_camera_record_as_we_do(in_browser: InBrowser) -> None:
    projections = {}
    for views in scenes():
        packed = pack(exported(views[0].folder / "checkpoint"), views[0].settings)
        projections[packed.model.program, packed.model.own.get("flip")] = packed, views[:2]
    assert len(projections) == 5
    for packed, views in projections.values():
        page = page_of(views)
        script = """
            await ready;
            const read = (view) => [...new Uint8Array(viewRecord(
              about.view, about.plans[0].scale, view, [0.25, 0.5, 1], about.view.degree, about.view.own))];
            return about.tests.map((test) => read(test.view));"""
        for view, bytes_ in zip(views, in_browser(page.encoded(), script), strict=True):
            pair = packed.view_bytes(view.camera, (0.25, 0.5, 1.0)), bytes(bytes_)
            # A zero has no sign here.
            ours, theirs = ((np.frombuffer(one, np.float32) + 0).view(np.int32).astype(int) for one in pair)
            # Tangents may differ by one unit in the last place between mathematical libraries.
            assert np.abs(ours - theirs).max() <= 1


ARRAYS = """
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
def test_the_page_decodes_the_arrays_that_were_packed(in_browser: InBrowser, method: str) -> None:
    view = golden_views(method)[2 if method == "two_dts" else 0]
    asset = quantised(exported(view.folder / "checkpoint"))
    settings = {**view.settings, **({"gamma_rescale": True, "gamma": 7.0} if method == "two_dts" else {})}
    packed = pack(asset, settings)
    page = make_page(asset, name="a", settings=settings)
    if method == "two_dts":
        assert set(page.scene["dedicated"]["arrays"]["positions"]) == {"shrunk"}
    # Before the page takes its own arrays out of the document.
    data = page.encoded().replace(b'return typeof main === "function" && main();', b"return true;")
    found = in_browser(data, ARRAYS)
    for name, array in packed.arrays.items():
        assert found[name] == checksum(array), name


def test_without_webgpu_it_says_so_and_shows_the_standard_tier(in_browser: InBrowser) -> None:
    views = golden_views("triangle_splatting")[:1]
    page = page_of(views, cameras=[views[0].camera])
    said, shown, names, pixel = in_browser(
        page.encoded(),
        """
        await ready;
        choose("0");
        showNow();
        const copy = document.createElement("canvas").getContext("2d");
        copy.drawImage(canvas, 0, 0);
        return [byId("note").textContent, byId("shown").value, byId("facts").textContent,
          [...copy.getImageData(0, 0, 300, 150).data].reduce((sum, value) => sum + value, 0)];
        """,
    )
    assert "WebGPU" in said
    assert "standard tier" in said
    assert shown == "standard"
    assert names == "Triangle-Splatting, 2,420 faces"
    assert pixel > 300 * 150 * 255


def test_what_was_baked_is_a_look_beside_the_others(in_browser: InBrowser) -> None:
    views = golden_views("triangle_splatting")[:1]
    mesh = mesh_from_asset(exported(views[0].folder / "checkpoint"))
    colors = np.tile(np.uint8([200, 50, 20]), (len(mesh.vertices), 1))
    glb = engine_mesh(asset_from_mesh(replace(mesh, vertex_colors=colors)), {}).encoded(".glb")
    page = page_of(views, cameras=[views[0].camera], baked=BakedLook(glb, 32.25, 18.06))
    first, options, *seen = in_browser(
        page.encoded(),
        """
        await ready;
        const select = byId("shown"), first = select.value, found = [];
        choose("0");
        for (const what of ["baked", "standard", "wipe-baked"]) {
          select.value = what;
          layOut();
          showNow();
          const copy = document.createElement("canvas").getContext("2d");
          copy.drawImage(canvas, 0, 0, 300, 150);
          const data = copy.getImageData(0, 0, 300, 150).data;
          const wanted = [200, 50, 20], isRed = (i) => wanted.every((value, k) => data[4 * i + k] === value);
          found.push([...Array(300 * 150).keys()].filter(isRed).length);
        }
        const label = byId("wipe").querySelector("b:last-of-type").textContent;
        const options = [...select.options].map((option) => option.textContent);
        return [first, options, ...found, label, byId("note").textContent];
        """,
    )
    assert first == "baked", "there is no WebGPU here"
    assert options == [
        "dedicated",
        "standard, with a wipe",
        "standard (18.1 dB)",
        "baked (32.3 dB)",
        "baked, with a wipe",
    ]
    baked, standard, wiped, label, said = seen
    assert baked == wiped > 1000
    assert standard == 0
    assert label == "baked"
    assert "msb bake" in said


@pytest.mark.parametrize(
    ("method", "modes"),
    [("triangle_splatting", [MODES[1], MODES[3], MODES[0]]), ("two_dts", [MODES[2], MODES[4]])],
    ids=["triangle_splatting", "two_dts"],
)
def test_modes_of_the_page_are_those_of_the_renderer(
    method: str, modes: list[tuple[Any, Any]], with_webgpu: InBrowser
) -> None:
    """Each choice is a plan of its own, and the official one is there again afterwards.

    Before, the page says what it waits for. What is chosen last is shown, even if what was chosen before is
    still being compiled then.
    """
    need("wgpu")
    view = golden_views(method)[0]
    watch = b"""<script>
        const told = [], observer = new MutationObserver(
          () => told.push([byId("name").textContent, byId("facts").textContent]));
        observer.observe(byId("facts"), { childList: true });
        </script></body>"""
    before, _, after = page_of([view]).encoded().rpartition(b"</body>")
    script = f"""
        const found = [];
        await ready;
        observer.disconnect();
        const facts = byId("facts").textContent, disabled = byId("cameras").disabled;
        const away = setMode({{ sampling: "engine" }});
        await setMode({{ sampling: "official" }});
        await away;
        const back = official.number;
        for (const [order, sampling] of {json.dumps(modes)}) {{
          await setMode({{ order, sampling }});
          found.push([...await pixelsOf(0)]);
        }}
        return [found, told, facts, disabled, back];"""
    found, told, facts, disabled, back = with_webgpu(before + watch + after, script)
    assert back == 0
    assert {name for name, _ in told} == {"a"}
    assert "compiling shaders ..." in [text for _, text in told]
    assert facts.endswith(f", {exported(view.folder / 'checkpoint').manifest.face_count:,} faces")
    assert not disabled
    for (order, sampling), pixels in zip(modes, found, strict=True):
        options = {"order": order, "sampling": sampling, "stops": STOPS, "settings": view.settings}
        with HardwareRenderer(exported(view.folder / "checkpoint"), **options) as renderer:
            wanted = to_bytes(renderer.render(view.camera, view.background).image)
        psnr = metrics.psnr(np.array(pixels, np.uint8).reshape(wanted.shape), wanted)
        assert psnr > 55, (order, sampling)


def test_pages_are_measured_when_made_and_again(msb: Msb, tmp_path: Path) -> None:
    need("threejs")
    checkpoint = golden_views("triangle_splatting")[-1].folder / "checkpoint"
    page = tmp_path / "page.html"
    made = msb("web", "-o", page, "--tier", "dedicated", "--quantise", "--json", "-", checkpoint)
    assert made.status == 0, made.err
    assert made.json["measured"]["worst"] > 40  # what rounding costs at the near cameras of the training
    assert [cost["psnr"] > 40 for cost in made.json["costs"]] == [True]
    assert "Rounded to 16 and 8 bits" in made.err
    # One that is faithful enough ends with 0: docs/web.md, as tests/test_docs_commands.py runs it.
    again = msb("web", "--verify", page, "--at-least", "99", "-q", "--json", "-")
    assert again.status == 1
    assert again.err.startswith("GATE_FAILED: ")
    assert again.json["measured"]["worst"] == pytest.approx(made.json["measured"]["worst"], abs=0.01)


def test_without_a_browser_a_page_is_made_and_cannot_be_measured(msb: Msb, tmp_path: Path) -> None:
    checkpoint = golden_views("triangle_splatting")[-1].folder / "checkpoint"
    page = tmp_path / "page.html"
    nothing = {VARIABLE: "no-such-browser"}
    made = msb("web", "-o", page, "--tier", "dedicated", "--faces", 1000, checkpoint, **nothing)
    assert made.status == 0
    assert "warning: " in made.err
    assert b'"measured": null' in page.read_bytes()
    found = msb("web", "--verify", page, **nothing)
    assert found.status == 5
    assert found.err.startswith("DEVICE_NOT_FOUND: ")
    assert msb("web", "-o", page, "--tier", "dedicated", checkpoint).err.startswith("OUTPUT_EXISTS")
    wrong = tmp_path / "wrong.html"
    wrong.write_text("<html></html>")
    assert msb("web", "--verify", wrong).status == 3
    for args in (
        ("--verify", page, "--quantise"),
        ("-o", wrong, "--quantise", checkpoint),
        ("-o", wrong, "--tier", "dedicated"),
        ("-o", wrong, "--at-least", "3", checkpoint),
    ):
        assert msb("web", *args).status == 2


HANDS = """
    await ready;
    const seen = [];
    const look = () => { const { eye, forward } = axes(state.view);
      seen.push({ eye: eye.toArray(), forward: forward.toArray(), distance: state.target.distanceTo(eye) });
    };
    const finger = (type, id, x, y) => canvas.dispatchEvent(
      new PointerEvent(type, { clientX: x, clientY: y, pointerId: id, bubbles: true, pointerType: "touch" }));
    canvas.setPointerCapture = () => {};
    look();
    finger("pointerdown", 1, 300, 300); finger("pointerdown", 2, 400, 300);
    finger("pointermove", 1, 250, 300); finger("pointermove", 2, 450, 300);
    look();
    finger("pointermove", 1, 300, 300); finger("pointermove", 2, 500, 300);
    look();
    finger("pointerup", 1, 0, 0); finger("pointerup", 2, 0, 0);
    byId("drag").value = "looks";
    finger("pointerdown", 3, 300, 300); finger("pointermove", 3, 350, 320); finger("pointerup", 3, 0, 0);
    look();
    window.dispatchEvent(new KeyboardEvent("keydown", { key: "w" })); fly(performance.now()); look();
    window.dispatchEvent(new KeyboardEvent("keyup", { key: "w" }));
    return [seen, pressed.size];
"""


@pytest.mark.parametrize("when", ["idle", "compiling"])
def test_a_lost_device_stays_said(when: str, with_webgpu: InBrowser) -> None:
    script = f"""
        await ready;
        const {{ lost }} = official;
        const changing = "{when}" === "compiling" ? setMode({{ order: "none" }}) : null;
        official.device.destroy();
        await Promise.all([lost, changing]);
        await new Promise((done) => setTimeout(done, 100));
        const said = [byId("note").hidden, byId("note").textContent, byId("shown").value];
        const told = new Promise((done) => canvas.addEventListener("webglcontextlost", done));
        gl.getExtension("WEBGL_lose_context").loseContext();
        await told;
        return [...said, byId("note").textContent];"""
    hidden, said, shown, nothing = with_webgpu(
        page_of(golden_views("triangle_splatting")[:1]).encoded(), script
    )
    assert (hidden, shown) == (False, "standard")
    assert "lost" in said
    assert "WebGL" not in said
    assert "WebGL" in nothing


def test_two_fingers_zoom_and_move_and_keys_fly(in_browser: InBrowser) -> None:
    views = golden_views("triangle_splatting")[:1]
    (start, near, moved, turned, flown), pressed = in_browser(page_of(views).encoded(), HANDS)
    assert near["distance"] == pytest.approx(start["distance"] / 2)
    assert moved["distance"] == pytest.approx(near["distance"])
    assert np.linalg.norm(np.subtract(moved["eye"], near["eye"])) > 0.05 * near["distance"]
    assert turned["eye"] == pytest.approx(moved["eye"])
    assert np.dot(turned["forward"], moved["forward"]) < 0.999
    step = np.subtract(flown["eye"], turned["eye"])
    assert np.dot(step, turned["forward"]) == pytest.approx(np.linalg.norm(step))
    assert np.linalg.norm(step) > 0
    assert pressed == 0
