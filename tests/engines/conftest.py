"""Helpers for tests of engines: skip tests of missing engines, and start a browser with WebGPU."""

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
    """Return a browser like that of `in_browser`, but with WebGPU in software, as in page measurements."""
    need("threejs")
    flags = (*engine._WEBGPU, *engine._WEBGPU_SOFTWARE)
    opened = Browser(engine.find_browser(), tmp_path_factory.mktemp("webgpu"), flags)
    yield opened.show
    opened.close()
