"""The three.js page is a single HTML file, with or without an asset.

The page works offline in any browser with WebGL 2. The page contains the modules of three.js, compressed, and
their licence. The folder `web/three` has the modules of three.js as published.
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
from msb.scenes.framing import Framing

# Pages with more faces than this exceed the memory of most browsers.
LARGE = 3_000_000
_SCRIPTS = ("camera.js", "page.js", "controls.js", "files.js", "start.js")
# Parts of a JavaScript module that are invalid in a plain script: "use strict", imports, exports.
_MODULE_SYNTAX = re.compile(r"""^("use strict";\n|import .*\n|export )""", re.MULTILINE)


def make_mesh_page(
    glb: bytes | None = None,
    *,
    name: str = "",
    cameras: Sequence[Camera] = (),
    up: str = "+y",
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    framing: Framing | None = None,
    served: bool = False,
) -> bytes:
    """Return the page of a mesh as UTF-8 bytes.

    Parameters
    ----------
    glb : bytes, optional
        The mesh. Without a mesh, the page opens a dropped file, or the file named by `?url=` in the address.
    name, cameras, up, background, framing : see `scene_to_json`
    served : bool
        Whether the page executes the tasks of a server (`browser.py`).
    """
    scene = scene_to_json(name, cameras, up, background, framing)
    encoded = "" if glb is None else base64.b64encode(glb).decode("ascii")
    return fill_template(scene, _SCRIPTS + (("remote.js",) if served else ()), glb=encoded)


def scene_to_json(
    name: str,
    cameras: Sequence[Camera],
    up: str,
    background: tuple[float, float, float],
    framing: Framing | None = None,
) -> dict[str, Any]:
    """Return the scene description that all pages contain, as JSON data.

    `name` is the title of the page. A user of the page can select one of `cameras`. `up` is the axis that
    points up, such as "+y", and `background` is a colour in the asset's colour space. The free camera shows
    the whole model, except for far outliers that `framing` excludes.
    """
    listed = [{**camera_to_json(camera), "name": camera.name} for camera in cameras]
    # The page uses these values to shade dropped meshes without colours. Meshes written by msb always have
    # colours.
    daylight = {"grey": GREY, "ambient": AMBIENT, "light": light_toward(up).tolist()}
    scene = {"name": name, "cameras": listed, "up": up, "background": list(background), "daylight": daylight}
    if framing is not None and framing.left_out:
        scene["sphere"] = {"center": list(framing.center), "radius": framing.radius}
    return scene


def fill_template(
    scene: Mapping[str, Any], scripts: Sequence[str], *, glb: str = "", arrays: str = ""
) -> bytes:
    """Return web/page.html filled with a scene and scripts, as UTF-8 bytes.

    `scene` is JSON data: `scene_to_json`, and further keys for some pages. `scripts` are names of files in
    the folder web, in the order of execution. `glb` is a mesh in base64, and `arrays` are HTML elements that
    contain arrays.
    """
    three = files("msb.engines") / "web" / "three"
    # Search for each placeholder after the previous placeholder, because inserted text may itself look like a
    # placeholder.
    rest = read_script("page.html")
    parts = []
    for mark, value in (
        ("@TITLE@", html.escape(str(scene["name"]) or "MeshSplatBench")),
        # The text "</" would end the script element.
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
    return "".join([*parts, rest]).encode(errors="backslashreplace")  # file names may contain invalid Unicode


@cache
def _three_modules() -> str:
    """Return HTML elements with the modules of three.js, compressed with gzip and encoded in base64."""
    folder = files("msb.engines") / "web" / "three"
    elements = []
    for name in _origin()["files"]:
        if name.endswith(".js"):
            packed = base64.b64encode(gzip.compress((folder / name).read_bytes(), 6, mtime=0)).decode("ascii")
            elements.append(f'<script type="text/plain" data-module="{name}">{packed}</script>')
    return "\n".join(elements)


def read_script(name: str) -> str:
    """Return a file of msb/engines/web without module syntax, so that it can precede other scripts.

    The npm package in integrations/js imports some of these files as modules.
    """
    text = (files("msb.engines") / "web" / name).read_text("utf-8")
    return _MODULE_SYNTAX.sub("", text)


def camera_to_json(camera: Camera) -> dict[str, Any]:
    """Return a camera as JSON data for the page, with OpenCV axes and lengths in pixels."""
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


def read_three_revision() -> str:
    """Return the revision of the included three.js, such as "187"."""
    return str(_origin()["revision"])


def _origin() -> dict[str, Any]:
    return tomllib.loads((files("msb.engines") / "web" / "three" / "ORIGIN.toml").read_text("utf-8"))
