"""Browser engines, installed from npm, in a minimal page that opens a file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.opened_in.scenes import HEIGHT, WIDTH, Scene
from benchmarks.opened_in.shown import ENGINES, NOT_INSTALLED, Shown
from msb.engines.browser import Page, find_browser, parse_browser_name

MODULES = ENGINES / "node_modules"
_WEB = Path(__file__).parent / "web"


@dataclass(frozen=True)
class WebEngine:
    """An engine from npm.

    Its page starts with `scripts` (paths below node_modules) and loads `files`. `modules` is the import map;
    only engines that consist of ES modules need it.
    """

    script: str
    package: str
    scripts: Sequence[str] = ()
    files: Sequence[str] = ()
    modules: Mapping[str, str] | None = None

    def missing(self) -> str | None:
        """Return the reason why the engine cannot run here, or None."""
        if not (MODULES / self.package).is_dir():
            return NOT_INSTALLED
        return "no browser found; run make engines" if find_browser() is None else None

    def draw(self, glb: bytes, scene: Scene, *, mended: bool) -> Shown:
        """Return the engine's image of a file."""
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
            name = parse_browser_name(page.about["browser"])
            return Shown(image, f"{version}, {name}, {page.about['device']}")
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
    """Return meshopt's decoder as a plain script. Without it, some engines would download the decoder."""
    module = MODULES / "three/examples/jsm/libs/meshopt_decoder.module.js"
    return module.read_bytes().replace(b"export { MeshoptDecoder };", b"") if module.exists() else b""
