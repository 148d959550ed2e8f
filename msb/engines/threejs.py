"""The renderer `threejs` draws with three.js (WebGL 2). A headless browser shows the page of `msb web`."""

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

from msb.asset import Asset
from msb.engines.browser import Page, find_browser, identify_browser, parse_browser_name
from msb.engines.engine import DRAW, WALL_CLOCK, Engine, opaque_frame
from msb.engines.webpage import camera_to_json, make_mesh_page, read_three_revision
from msb.errors import DeviceError
from msb.render.backend import DrawTime
from msb.render.frame import Frame
from msb.scenes import Camera
from msb.scenes.colors import Color


class ThreeJsRenderer(Engine):
    """Draws the GLB file of an asset with three.js.

    With `device` "cpu", SwiftShader draws in software. With "gpu", a graphics card draws. Colours and depths
    are read from float32 render targets, so they are not rounded. Frames have no face ids, because WebGL has
    no primitive numbers. If the browser supports timer queries, the device measures times. If the browser has
    no timer queries, the wall clock measures times in the stage `WALL_CLOCK`.

    Parameters
    ----------
    defaults : bool
        Keep the default colour management of three.js, to show the effect of the settings for exact colours.
        With the default colour management, images are read from the 8-bit canvas.
    """

    name = "threejs"

    def __init__(
        self,
        asset: Asset,
        *,
        device: Any = None,
        settings: Mapping[str, Any] | None = None,
        supersample: int = 1,
        defaults: bool = False,
    ) -> None:
        super().__init__(asset, device=device, settings=settings, supersample=supersample)
        content = {"page.html": make_mesh_page(served=True), "mesh.glb": self._mesh.to_bytes(".glb")}
        browser = find_browser()
        assert browser is not None
        self._defaults = defaults
        query = "url=mesh.glb&bare" + ("&colors=linear" if defaults else "")
        self._page = Page(browser, content, query, software=self._kind == "cpu")
        about = self._page.about
        self.version = f"r{about['three']}"
        drawn_by = str(about["device"])
        in_software = any(word in drawn_by.lower() for word in ("swiftshader", "llvmpipe", "software"))
        self.device_info = {
            "platform": f"{parse_browser_name(about['browser'])}, WebGL 2",
            "name": drawn_by,
            "kind": "cpu" if in_software else "gpu",
        }
        if self._kind == "gpu" and in_software:
            self.close()
            text = f"the browser found no GPU, only {drawn_by}; pass --device cpu to draw with this device"
            raise DeviceError("DEVICE_NOT_FOUND", text)
        self._memory: Mapping[str, int] = {}

    @classmethod
    def missing(cls) -> str | None:
        """Return a message if no browser is found."""
        if find_browser() is None:
            text = "found no Chromium, Chrome or Edge on PATH or in MSB_BROWSER"
            return text + ("; apt-get install chromium" if sys.platform == "linux" else "")
        return None

    @classmethod
    def installed(cls) -> str:
        """Return the revision of three.js and the name and date of the browser."""
        browser = find_browser()
        return "" if browser is None else f"r{read_three_revision()}, {identify_browser(browser)}"

    def memory(self) -> Mapping[str, int]:
        """Return the bytes of each buffer and render target of the page, by use."""
        return dict(self._memory)

    def close(self) -> None:
        """End the browser."""
        self._page.close()

    def _frame(self, camera: Camera, background: Color) -> Frame:
        head, body = self._ask(camera, background, read=True)
        height, width = camera.height, camera.width
        count = 4 * height * width
        # The answer contains float32 RGBA (H, W, 4) and depth (H, W). WebGL stores the lowest row first.
        floats = np.frombuffer(body[: 5 * count], np.float32)
        rgba = floats[:count].reshape(height, width, 4)[::-1]
        depth = floats[count:].reshape(height, width)[::-1]
        image = rgba[..., :3]
        if self._defaults:
            canvas = np.frombuffer(body[5 * count :], np.uint8).reshape(height, width, 4)[::-1]
            image = np.divide(canvas[..., :3], 255, dtype=np.float32)
        return opaque_frame(image, rgba[..., 3] > 0, depth, background, None, _times(head))

    def _draw(self, camera: Camera, background: Color) -> DrawTime:
        stages = _times(self._ask(camera, background, read=False)[0])
        return DrawTime(stages, sum(stages.values()))

    def _ask(self, camera: Camera, background: Color, *, read: bool) -> tuple[dict[str, Any], memoryview]:
        side = self._page.about["side"]
        if max(camera.width, camera.height) > side:
            size = f"{camera.width} x {camera.height}"
            text = f"{self.device_info['name']} draws at most {side} x {side} pixels, not {size}"
            raise DeviceError("DEVICE_MEMORY", text)
        task = {"view": camera_to_json(camera), "background": list(background), "read": read}
        task["canvas"] = read and self._defaults
        head, body = self._page.ask(task)
        self._memory = head["memory"]
        return head, body


def _times(head: Mapping[str, Any]) -> dict[str, float]:
    times = head["ms"]
    return {DRAW: times["device"]} if "device" in times else {WALL_CLOCK: times["wall"]}
