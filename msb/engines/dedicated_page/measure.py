"""How faithful a page is: its test views, drawn by a headless browser, against the images that it holds."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.engines.browser import VARIABLE, Page, browser_name, find_browser
from msb.engines.webpage import read_script
from msb.errors import DeviceError
from msb.metrics import psnr

# The PSNR in dB from which a page counts as faithful.
FAITHFUL = 45.0


@dataclass(frozen=True)
class Measured:
    """What a page's pixels have to its test views.

    Attributes
    ----------
    browser, device : str
        What drew.
    format : str
        The format that was blended into.
    psnr : list of float
        In dB, inf where all bytes are equal.
    milliseconds : list of float
        Of each frame, from the call until its pixels were read; the first one includes what WebGPU puts off.
    """

    browser: str
    device: str
    format: str
    psnr: list[float]
    milliseconds: list[float]

    @property
    def worst(self) -> float:
        """The lowest PSNR; inf if all views are equal."""
        return min(self.psnr, default=math.inf)

    @property
    def by(self) -> str:
        """Who drew, in words."""
        half = ", blended in half floats" if self.format == "rgba16float" else ""
        return f"{self.browser}, {self.device}{half}"


def measure_page(
    data: bytes,
    scene: Mapping[str, Any],
    images: Sequence[NDArray[np.uint8]],
    *,
    software: bool = True,
    step: Callable[[], None] = lambda: None,
) -> Measured:
    """Return how faithfully a browser shows a page.

    Parameters
    ----------
    data : bytes
        The page.
    scene : mapping
        Its scene.
    images : sequence of (H, W, 3) uint8
        Those of its test views.
    software : bool
        Whether to draw with the browser's own software adapter, which is the same on every machine.
    step : callable
        Called after each view.
    """
    browser = find_browser()
    if browser is None:
        text = (
            f"no Chromium, Chrome or Edge is on PATH, and {VARIABLE} names none, so no page can be measured"
        )
        raise DeviceError("DEVICE_NOT_FOUND", text)
    script = f"<script>\n{read_script('verify.js')}</script>\n</body>".encode()
    before, _, after = data.rpartition(b"</body>")
    page = Page(browser, {"page.html": before + script + after}, "bare", software=software, webgpu=True)
    values, times = [], []
    try:
        for k, image in enumerate(images):
            head, body = page.ask({"test": k})
            found = np.frombuffer(body, np.uint8)
            if found.size != image.size:
                raise DeviceError("ENGINE_FAILED", f"the page draws {found.size} bytes, not {image.size}")
            values.append(psnr(found.reshape(image.shape), image))
            times.append(float(head["ms"]))
            step()
    finally:
        page.close()
    about = page.about
    return Measured(
        browser_name(str(about["browser"])), str(about["device"]), str(about["format"]), values, times
    )
