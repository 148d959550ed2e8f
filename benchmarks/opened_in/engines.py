"""Which engines there are, why each differs, and what its user can set."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from benchmarks.opened_in.in_browser import WebEngine
from benchmarks.opened_in.in_process import Blender, Godot, Ours, PythonEngine

if TYPE_CHECKING:
    from benchmarks.opened_in.shown import Engine

_THREE = "three/examples/jsm"
_POWER = "encodes by the power 1/2.2 instead of sRGB's curve: up to nine levels too bright in the dark"


class Entry(NamedTuple):
    """An engine; why it shows another picture than ours, and what mends that, "" where nothing has to."""

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
        "an unlit material of it shows no vertex colours: white",
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
        "a shader chunk gammaPS of one's own with sRGB's curve",
    ),
    "Filament": Entry(
        WebEngine(
            "filament.js",
            "filament",
            ("gl-matrix/gl-matrix-min.js", "filament/filament.js"),
            ("filament/filament.wasm",),
        ),
        "maps tones (ACES), of unlit materials as well, and smooths (FXAA)",
        "view.setColorGrading(ColorGrading.Builder().toneMapping(LINEAR) ...); setAntiAliasing(NONE)",
    ),
    "wgpu": Entry(Ours()),
    "pygfx": Entry(
        PythonEngine("in_pygfx.py", "pygfx"),
        "draws twice as large and filters down; makes no mip maps",
        "WgpuRenderer(canvas, pixel_ratio=1)",
    ),
    "VTK": Entry(
        PythonEngine("in_vtk.py", "pyvista", screen=True),
        f"{_POWER}; shows vertex colours as stored, which is linear: too dark",
    ),
    "Panda3D": Entry(
        PythonEngine("in_panda3d.py", "panda3d", screen=True),
        "shows linear values, which it decodes textures to, on a screen that is not told of them: too dark",
        "framebuffer-srgb true (Config.prc)",
    ),
    "Godot 3": Entry(
        Godot(),
        "knows no unlit material, and nothing gives light: black; vertex colours of 16 bits are white",
        "flags_unshaded and vertex_color_use_as_albedo of the material",
    ),
    "Blender": Entry(
        Blender(),
        "AgX maps tones; a pixel shows what lies within 1.5 pixels of it; filters textures anisotropically",
        "Color Management, View Transform: Standard; Film, Filter Size 0.01 px",
    ),
}
NOT_RUN = {
    "Unity": "in no registry, and wants an account",
    "Unreal Engine": "in no registry, and wants an account",
    "Godot 4": "in no registry",
}
"""Engines that no machine without them can be given, and why."""
