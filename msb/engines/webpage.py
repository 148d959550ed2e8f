"""The three.js page: one file that any browser with WebGL 2 opens offline, with or without an asset in it.

The modules of three.js, which `web/three` holds as published, go into the page when it is written, packed and
with their licence.
"""

import base64
import gzip
import html
import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

from msb.asset.look import AMBIENT, GREY, light_toward
from msb.scenes import Camera

# Number of faces from which a page with the asset in it is more than most browsers hold.
LARGE = 3_000_000
_SCRIPTS = ("camera.js", "page.js", "hands.js", "files.js", "start.js")
# What only a file of its own begins with, and what a module has to import and export.
_OF_A_MODULE = re.compile(r"""^("use strict";\n|import .*\n|export )""", re.MULTILINE)


def page(
    glb: bytes | None = None,
    *,
    name: str = "",
    cameras: Sequence[Camera] = (),
    up: str = "+y",
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    served: bool = False,
) -> bytes:
    """Return the page of a mesh, UTF-8; without one it waits for a file to be dropped, or for `?url=`.

    A viewer can choose among `cameras`, and turns the mesh about the axis `up`, such as "+y". `served`: it
    asks its server what to draw (`browser.py`).
    """
    scene = scene_data(name, cameras, up, background)
    encoded = "" if glb is None else base64.b64encode(glb).decode("ascii")
    return filled(scene, _SCRIPTS + (("remote.js",) if served else ()), glb=encoded)


def scene_data(
    name: str, cameras: Sequence[Camera], up: str, background: tuple[float, float, float]
) -> dict[str, Any]:
    """Return what every page is told of its scene."""
    listed = [{**camera_data(camera), "name": camera.name} for camera in cameras]
    # How a file that is dropped on the page is lit if it has no colours; what we write has them.
    daylight = {"grey": GREY, "ambient": AMBIENT, "light": light_toward(up).tolist()}
    return {"name": name, "cameras": listed, "up": up, "background": list(background), "daylight": daylight}


def filled(scene: Mapping[str, Any], scripts: Sequence[str], *, glb: str = "", arrays: str = "") -> bytes:
    """Return web/page.html, UTF-8, with a scene (JSON: `scene_data`, and more) and scripts in their order.

    `glb` is base64, `arrays` are elements that hold arrays.
    """
    three = files("msb.engines") / "web" / "three"
    # Each mark is looked for in what is left of the template only: a name may look like one.
    rest = read_script("page.html")
    parts = []
    for mark, value in (
        ("@TITLE@", html.escape(str(scene["name"]) or "MeshSplatBench")),
        # "</" would end the element it stands in.
        ("@SCENE@", json.dumps(scene, allow_nan=False).replace("<", "\\u003c")),
        ("@GLB@", glb),
        ("@ARRAYS@", arrays),
        ("@LICENSE@", (three / "LICENSE").read_text("utf-8").rstrip()),
        ("@THREE@", _three_modules()),
        ("@SCRIPT@", '"use strict";\n' + "".join(read_script(name) for name in scripts)),
        ("@LOADER@", read_script("loader.js")),
    ):
        before, rest = rest.split(mark, 1)
        parts += [before, value]
    return "".join([*parts, rest]).encode(errors="backslashreplace")  # a file name need not be text


@cache
def _three_modules() -> str:
    """Return the elements that hold the modules of three.js, gzip in base64."""
    folder = files("msb.engines") / "web" / "three"
    elements = []
    for name in _origin()["files"]:
        if name.endswith(".js"):
            packed = base64.b64encode(gzip.compress((folder / name).read_bytes(), 6, mtime=0)).decode("ascii")
            elements.append(f'<script type="text/plain" data-module="{name}">{packed}</script>')
    return "\n".join(elements)


def read_script(name: str) -> str:
    """Return a file of msb/engines/web, to append to another script.

    Some files are modules, which the npm package in integrations/js contains unchanged. A page is one script.
    """
    text = (files("msb.engines") / "web" / name).read_text("utf-8")
    return _OF_A_MODULE.sub("", text)


def camera_data(camera: Camera) -> dict[str, Any]:
    """Return the data of a camera that the page needs."""
    return {
        "width": camera.width,
        "height": camera.height,
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "world_to_camera": camera.world_to_camera.tolist(),
        "unit": camera.unit,
    }


def three_revision() -> str:
    """Return the revision of three.js in the page, such as "187"."""
    return str(_origin()["revision"])


def _origin() -> dict[str, Any]:
    return tomllib.loads((files("msb.engines") / "web" / "three" / "ORIGIN.toml").read_text("utf-8"))
