"""Measures a page: a headless browser draws the test views, and msb compares them with stored images."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.engines.browser import VARIABLE, Page, find_browser, parse_browser_name
from msb.engines.webpage import read_script
from msb.errors import DeviceError
from msb.metrics import psnr

# Default of --at-least: the minimum PSNR in dB of every test view. Differences are invisible above 40 dB. A
# page that blends in half floats still reaches 45 dB.
FAITHFUL = 45.0


@dataclass(frozen=True)
class Measurement:
    """The accuracy with which a browser reproduces the test views of a page.

    Attributes
    ----------
    browser, device : str
        The name of the browser, and the name of its graphics adapter.
    format : str
        The texture format of the blended targets.
    psnr : list of float
        PSNR of each view in dB; infinite if all bytes are equal.
    milliseconds : list of float
        Time of each frame until its pixels were read. The first frame includes deferred work of WebGPU.
    """

    browser: str
    device: str
    format: str
    psnr: list[float]
    milliseconds: list[float]

    @property
    def worst(self) -> float:
        """The lowest PSNR in dB; infinite if all views are equal."""
        return min(self.psnr, default=math.inf)

    @property
    def by(self) -> str:
        """The names of the browser and adapter as text."""
        half = ", blended in half floats" if self.format == "rgba16float" else ""
        return f"{self.browser}, {self.device}{half}"


def measure_page(
    data: bytes,
    scene: Mapping[str, Any],
    images: Sequence[NDArray[np.uint8]],
    *,
    software: bool = True,
    step: Callable[[], None] = lambda: None,
) -> Measurement:
    """Return how closely a browser reproduces the test views of a page.

    Parameters
    ----------
    data : bytes
        The page.
    scene : mapping
        The scene description in the page.
    images : sequence of (H, W, 3) uint8
        The expected images of its test views.
    software : bool
        Whether to draw with the browser's software adapter, which gives the same result on every machine.
    step : callable
        Called after each view.

    Raises
    ------
    DeviceError
        DEVICE_NOT_FOUND: no browser was found. ENGINE_FAILED: the browser cannot draw the page.
    """
    browser = find_browser()
    if browser is None:
        text = f"measuring a page needs Chromium, Chrome or Edge on PATH, or its path in {VARIABLE}"
        raise DeviceError("DEVICE_NOT_FOUND", text)
    script = f"<script>\n{read_script('verify.js')}</script>\n</body>".encode()
    before, _, after = data.rpartition(b"</body>")
    page = Page(browser, {"page.html": before + script + after}, "bare", software=software, webgpu=True)
    values, times = [], []
    try:
        for k, image in enumerate(images):
            head, body = page.ask({"test": k})
            pixels = np.frombuffer(body, np.uint8)
            if pixels.size != image.size:
                text = f"the page drew test view {k} as {pixels.size} bytes; {image.size} were expected"
                raise DeviceError("ENGINE_FAILED", text)
            values.append(psnr(pixels.reshape(image.shape), image))
            times.append(float(head["ms"]))
            step()
    finally:
        page.close()
    about = page.about
    name = parse_browser_name(str(about["browser"]))
    return Measurement(name, str(about["device"]), str(about["format"]), values, times)
