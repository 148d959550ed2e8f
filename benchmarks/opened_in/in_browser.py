"""Engines that draw in a browser: what npm brings of them, in a page of ours that only opens a file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.opened_in.scenes import HEIGHT, WIDTH, Scene
from benchmarks.opened_in.shown import ENGINES, NOT_INSTALLED, Shown
from msb.engines.browser import Page, browser_name, find_browser

MODULES = ENGINES / "node_modules"
_WEB = Path(__file__).parent / "web"


@dataclass(frozen=True)
class WebEngine:
    """An engine of npm.

    Its page begins with `scripts`, below node_modules, and loads `files`, too; `modules` is what the names of
    modules stand for, if it is made of such.
    """

    script: str
    package: str
    scripts: Sequence[str] = ()
    files: Sequence[str] = ()
    modules: Mapping[str, str] | None = None

    def missing(self) -> str | None:
        """Return why it cannot draw here, or None."""
        if not (MODULES / self.package).is_dir():
            return NOT_INSTALLED
        return "no browser: make engines" if find_browser() is None else None

    def draw(self, glb: bytes, scene: Scene, *, mended: bool) -> Shown:
        """Return what it shows of a file."""
        browser = find_browser()
        assert browser is not None
        content = {name: (MODULES / name).read_bytes() for name in (*self.scripts, *self.files)}
        content |= {"page.html": self._html(), "model.glb": glb}
        content["meshopt_decoder.js"] = _decoder()
        content |= {name: (_WEB / name).read_bytes() for name in ("page.js", self.script)}
        query = f"width={WIDTH}&height={HEIGHT}" + "&mended" * mended
        page = Page(browser, content, query, software=True)
        try:
            pixels = page.ask(scene.view).body
            version = json.loads((MODULES / self.package / "package.json").read_text())["version"]
            image = np.frombuffer(pixels, np.uint8).reshape(HEIGHT, WIDTH, 4)[..., :3]
            return Shown(image, f"{version}, {browser_name(page.about['browser'])}, {page.about['device']}")
        finally:
            page.close()

    def _html(self) -> bytes:
        lines = ["<!DOCTYPE html>", '<meta charset="utf-8">', "<canvas></canvas>"]
        if self.modules:
            lines.append(f'<script type="importmap">{json.dumps({"imports": self.modules})}</script>')
        lines.append('<script src="page.js"></script>')
        kind = "" if self.modules is None else ' type="module"'
        lines += [f'<script{kind} src="{name}"></script>' for name in (*self.scripts, self.script)]
        return "\n".join(lines).encode()


def _decoder() -> bytes:
    """Return the decoder of meshopt as a plain script, which some engines would fetch from a network."""
    module = MODULES / "three/examples/jsm/libs/meshopt_decoder.module.js"
    return module.read_bytes().replace(b"export { MeshoptDecoder };", b"") if module.exists() else b""
