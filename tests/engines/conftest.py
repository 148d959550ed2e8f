"""Engines that are installed, and a browser with WebGPU."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from msb.engines import browser as engine
from msb.render.backend import what_is_missing
from tests.browser import Browser


def need(name: str) -> str:
    """Return `name`, or skip what needs the renderer."""
    missing = what_is_missing(name)
    if missing is not None:
        pytest.skip(f"renderer {name}: {missing}")
    return name


@pytest.fixture(scope="session")
def webgpu_browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """Return a browser that stays open and draws with WebGPU in software, as when pages are measured."""
    need("threejs")
    program = engine.find_browser()
    flags = (*engine._WEBGPU, *engine._WEBGPU_SOFTWARE)
    opened = Browser(program, tmp_path_factory.mktemp("webgpu"), flags)
    yield opened
    opened.close()


@pytest.fixture
def with_webgpu(webgpu_browser: Browser, tmp_path: Path) -> Callable[[bytes, str], Any]:
    """Return what opens a page, runs a script in it and returns the JSON that this makes."""

    def run(page: bytes, script: str) -> Any:
        path = tmp_path / "page.html"
        path.write_bytes(page)
        return webgpu_browser.run(path, script)

    return run
