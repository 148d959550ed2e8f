"""Engines that are installed, and a browser to run a page in."""

from __future__ import annotations

import html
import json
import os
import re
import subprocess
from typing import TYPE_CHECKING, Any

import pytest

from msb.engines.browser import find_browser
from msb.render.backend import what_is_missing

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

FLAGS = (
    "--headless=new",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
)


def need(name: str) -> str:
    """Return `name`, or skip what needs the renderer."""
    missing = what_is_missing(name)
    if missing is not None:
        pytest.skip(f"renderer {name}: {missing}")
    return name


@pytest.fixture
def in_browser(tmp_path: Path) -> Callable[[bytes, str, str], Any]:
    """Return what opens a page from its file, runs a script in it and returns the JSON that this makes."""
    need("threejs")
    browser = find_browser()
    assert browser is not None

    def run(page: bytes, script: str, query: str = "") -> Any:
        path = tmp_path / "page.html"
        code = f"""
            const told = document.createElement("pre");
            told.id = "told";
            (async () => {{ {script} }})().catch((error) => ({{ error: String(error) }})).then((value) => {{
              told.textContent = JSON.stringify(value);
              document.body.append(told);
            }});"""
        path.write_bytes(page.replace(b"</body>", f"<script>{code}</script></body>".encode()))
        done = subprocess.run(
            [
                *(browser, *FLAGS, f"--user-data-dir={tmp_path / 'profile'}"),
                *(["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []),
                *("--virtual-time-budget=20000", "--window-size=800,600", "--dump-dom"),
                f"{path.as_uri()}{query}",
            ],
            capture_output=True,
            text=True,
            timeout=120,
        )
        found = re.search(r'<pre id="told">(.*?)</pre>', done.stdout, re.DOTALL)
        assert found is not None, done.stderr[-2000:]
        return json.loads(html.unescape(found[1]))

    return run
