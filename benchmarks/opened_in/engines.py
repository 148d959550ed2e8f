"""The engines, the reasons why they differ from our rendering, and the user settings that correct this."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from benchmarks.opened_in.in_browser import WebEngine
from benchmarks.opened_in.in_process import Blender, Godot, Ours, PythonEngine

if TYPE_CHECKING:
    from benchmarks.opened_in.shown import Engine

_THREE = "three/examples/jsm"
_POWER = "encodes with a power of 1/2.2 instead of the sRGB curve: up to nine levels too bright in the dark"


class Entry(NamedTuple):
    """An engine, the reason why its image differs from ours, and the setting that corrects it ("" if not
    needed).
    """

    engine: Engine
    why: str = ""
    setting: str = ""


ENTRIES = {
    "three.js": Entry(
        WebEngine(
            "three.js",
            "three",
            files=(
                "three/build/three.module.js",
                "three/build/three.core.js",
                f"{_THREE}/loaders/GLTFLoader.js",
                f"{_THREE}/utils/BufferGeometryUtils.js",
                f"{_THREE}/utils/SkeletonUtils.js",
                f"{_THREE}/libs/meshopt_decoder.module.js",
            ),
            modules={"three": "./three/build/three.module.js", "three/addons/": f"./{_THREE}/"},
        ),
    ),
    "<model-viewer>": Entry(
        WebEngine(
            "model-viewer.js",
            "@google/model-viewer",
            ("@google/model-viewer/dist/model-viewer.min.js",),
            modules={},
        ),
        "filters textures anisotropically (4)",
    ),
    "Galacean": Entry(
        WebEngine("galacean.js", "@galacean/engine", ("@galacean/engine/dist/browser.min.js",)),
        "unlit materials ignore vertex colours: white",
    ),
    "Babylon.js": Entry(
        WebEngine(
            "babylon.js",
            "babylonjs",
            ("babylonjs/babylon.js", "babylonjs-loaders/babylon.glTF2FileLoader.min.js"),
        ),
        f"{_POWER}; filters textures anisotropically (4)",
        "new Engine(canvas, true, { useExactSrgbConversions: true }); texture.anisotropicFilteringLevel = 1",
    ),
    "PlayCanvas": Entry(
        WebEngine("playcanvas.js", "playcanvas", ("playcanvas/build/playcanvas.min.js",)),
        _POWER,
        "replace the shader chunk gammaPS with one that has the sRGB curve",
    ),
    "Filament": Entry(
        WebEngine(
            "filament.js",
            "filament",
            ("gl-matrix/gl-matrix-min.js", "filament/filament.js"),
            ("filament/filament.wasm",),
        ),
        "applies ACES tone mapping, also to unlit materials, and FXAA",
        "view.setColorGrading(ColorGrading.Builder().toneMapping(LINEAR) ...); setAntiAliasing(NONE)",
    ),
    "wgpu": Entry(Ours()),
    "pygfx": Entry(
        PythonEngine("in_pygfx.py", "pygfx"),
        "renders at twice the size and downsamples; creates no mip maps",
        "WgpuRenderer(canvas, pixel_ratio=1)",
    ),
    "VTK": Entry(
        PythonEngine("in_vtk.py", "pyvista", screen=True),
        f"{_POWER}; shows vertex colours without converting them from linear: too dark",
    ),
    "Panda3D": Entry(
        PythonEngine("in_panda3d.py", "panda3d", screen=True),
        "decodes textures to linear values and displays them without encoding: too dark",
        "framebuffer-srgb true (Config.prc)",
    ),
    "Godot 3": Entry(
        Godot(),
        "has no unlit material, and the scene has no lights: black; 16-bit vertex colours are white",
        "set the material's flags_unshaded and vertex_color_use_as_albedo",
    ),
    "Blender": Entry(
        Blender(),
        "applies AgX tone mapping and a pixel filter 1.5 pixels wide; filters textures anisotropically",
        "Color Management, View Transform: Standard; Film, Filter Size 0.01 px",
    ),
}
NOT_RUN = {
    "Unity": "not in a package registry; needs an account",
    "Unreal Engine": "not in a package registry; needs an account",
    "Godot 4": "in no registry",
}
"""Engines that cannot be installed automatically, and the reason."""
