"""Fixtures for engines: skip tests of missing engines; a browser with WebGPU."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from msb.engines import browser as engine
from msb.render.backend import why_unavailable
from tests.browser import Browser


def need(name: str) -> str:
    """Return `name`, or skip the test if that renderer is not installed."""
    missing = why_unavailable(name)
    if missing is not None:
        pytest.skip(f"renderer {name}: {missing}")
    return name


@pytest.fixture(scope="session")
def with_webgpu(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Any]]:
    """Like `in_browser`, but the browser draws with WebGPU in software. Pages are measured in this way."""
    need("threejs")
    flags = (*engine._WEBGPU, *engine._WEBGPU_SOFTWARE)
    opened = Browser(engine.find_browser(), tmp_path_factory.mktemp("webgpu"), flags)
    yield opened.show
    opened.close()
