"""Renderers `blender_cycles` and `blender_workbench`: Blender, through bpy in a process of its own.

The asset goes to Blender as an artist would bring it: the PLY (or GLB) that `msb convert` writes, imported by
Blender's importer. docs/engines.md has the settings that make the colours exact; `blender_worker.py` is what
runs there.
"""

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.texture import linear_to_srgb
from msb.base.extras import install, is_installed
from msb.engines.engine import NEAR, WALL_CLOCK, Engine, opaque_frame
from msb.errors import DeviceError, Unsupported, UsageError, shorten
from msb.render.backend import Drawn
from msb.render.frame import Frame
from msb.scenes import Camera
from msb.scenes.colors import Color

# The environment variable with the Python of an environment that has bpy, if that is not ours.
VARIABLE = "MSB_BLENDER"
# Limits of Blender: the least and most pixels each way, and the largest ratio of a pixel's sides.
_MIN_SIDE, _MAX_SIDE, _MAX_ASPECT = 4, 65536, 200.0
# Width of the sensor in millimetres; only its ratio to the focal length counts, which must be at least 1 mm.
_SENSOR = 100.0
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
# Blender's glTF importer turns y up into z up.
_GLB_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
_LONGEST_SECONDS = 1800
# Depths beyond this number are Blender's "nothing".
_FAR = 1e10


class _Blender(Engine):
    """Blender as a renderer.

    Parameters
    ----------
    source : {"ply", "glb"}
        The format that Blender imports. Its PLY importer keeps float colours; its glTF importer makes bytes
        of them. Textures come as GLB.
    defaults : bool
        Whether Blender's colour handling stays as it comes, to see its effect; images are then those of the
        8-bit PNG that Blender writes.
    """

    engine: ClassVar[str]

    def __init__(
        self,
        asset: Asset,
        *,
        device: Any = None,
        settings: Mapping[str, Any] | None = None,
        supersample: int = 1,
        source: Literal["ply", "glb"] = "ply",
        defaults: bool = False,
    ) -> None:
        super().__init__(asset, device=device, settings=settings, supersample=supersample)
        self._check_device()
        if (skin := self._mesh.textured) is not None:
            source = "glb"
        self._turn = _GLB_UP if source == "glb" else np.eye(4)
        self._defaults = defaults
        python = _python()
        assert python is not None
        self._folder = tempfile.TemporaryDirectory(prefix="msb-blender-", ignore_cleanup_errors=True)
        self._log: IO[bytes] = (Path(self._folder.name) / "log").open("w+b")
        self._process = subprocess.Popen(
            [python, str(Path(__file__).with_name("blender_worker.py"))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            encoding="utf-8",
            env={**os.environ, **({"LIBGL_ALWAYS_SOFTWARE": "1"} if self._kind == "cpu" else {})},
        )
        try:
            path = Path(self._folder.name) / f"mesh.{source}"
            path.write_bytes(self._mesh.encoded(path.suffix))
            about = self._ask(
                {
                    "file": str(path),
                    "engine": self.engine,
                    "exact": not defaults,
                    "textured": skin is not None,
                    "cutoff": None if skin is None else skin.sampler.alpha_cutoff,
                }
            )
            path.unlink()
        except BaseException:
            self.close()
            raise
        self._baseline = about["baseline"]
        self.version = str(about["version"])
        self.device_info = self._device_info(about)
        if self._kind == "gpu" and self.device_info["kind"] == "cpu":
            self.close()
            text = f"Blender finds no GPU, only {self.device_info['name']}; --device cpu asks for that"
            raise DeviceError("DEVICE_NOT_FOUND", text)

    def _check_device(self) -> None:
        """Refuse a device, or an asset, that this engine does not draw."""

    def _device_info(self, about: Mapping[str, Any]) -> Mapping[str, str]:
        raise NotImplementedError

    @classmethod
    def missing(cls) -> str | None:
        """Return what to install, if anything."""
        if _python() is not None:
            # With MSB_BLENDER the rest of the extra is not wanted here.
            return None if is_installed("OpenEXR") else f"OpenEXR is not installed: {install('bench')}"
        if os.environ.get(VARIABLE):
            return f"{VARIABLE} names {shorten(os.environ[VARIABLE], 80)}, which is no program"
        text = f"bpy is not installed: {install('blender')} with Python 3.11 or 3.13"
        return f"{text}, or set {VARIABLE} to a python that has it"

    @classmethod
    def installed(cls) -> str:
        """Return the version of bpy where it is."""
        python = _python()
        if python is None:
            return ""
        code = "import importlib.metadata; print(importlib.metadata.version('bpy'))"
        done = subprocess.run([python, "-c", code], capture_output=True, text=True, timeout=60, check=False)
        return done.stdout.strip()

    def memory(self) -> Mapping[str, int]:
        """Return by how many bytes Blender's process has grown since its start; it reports nothing finer."""
        return {"Blender's process": max(0, self._resident - self._baseline)}

    def close(self) -> None:
        """End Blender."""
        with contextlib.suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.close()
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._log.close()
        self._folder.cleanup()

    def _frame(self, camera: Camera, background: Color) -> Frame:
        form = "png" if self._defaults else "exr"
        path = Path(self._folder.name) / f"frame.{form}"
        times = self._render(camera, {form: str(path)})
        rgba, depth = (_read_png if self._defaults else _read_exr)(path)
        path.unlink()
        depth = depth / np.float32(_unit(camera))
        image = rgba[..., :3]
        if self._mesh.textured is not None and not self._defaults:
            image = linear_to_srgb(np.clip(image, 0, 1))  # what is read of a texture is linear light
        return opaque_frame(image, rgba[..., 3] > 0.5, depth, background, None, times)

    def _draw(self, camera: Camera, background: Color) -> Drawn:
        times = self._render(camera, {})
        return Drawn(times, sum(times.values()))

    def _render(self, camera: Camera, target: Mapping[str, str]) -> dict[str, float]:
        low, high = self._mesh.depth_range(camera.world_to_camera)
        # A near and a far plane as tight as can be cost nothing and make the most of a depth buffer.
        clip = [_unit(camera) * plane for plane in (max(NEAR, 0.99 * low), max(2 * NEAR, 1.01 * high))]
        request = blender_camera(camera, self._turn)
        return {WALL_CLOCK: float(self._ask({**request, "clip": clip, **target})["ms"])}

    def _ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        watch = threading.Timer(_LONGEST_SECONDS, process.kill)
        watch.start()
        try:
            process.stdin.write(json.dumps(request) + "\n")
            process.stdin.flush()
            line = process.stdout.readline()
        except OSError:
            line = ""
        finally:
            watch.cancel()
        if not line:
            raise DeviceError("ENGINE_FAILED", f"Blender ended: {self._last_words()}")
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise DeviceError("ENGINE_FAILED", f"Blender: {shorten(answer['error'], 200)}")
        self._resident = int(answer["resident"])
        return answer

    def _last_words(self) -> str:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=10)
        self._log.seek(0)
        lines = [line.strip() for line in self._log.read().decode("utf-8", "replace").splitlines()]
        words = next((line for line in reversed(lines) if line), "it said nothing")
        return f"{shorten(words, 200)} (status {self._process.returncode})"


class CyclesRenderer(_Blender):
    """Blender's path tracer, one ray through the centre of each pixel, on the CPU."""

    name = "blender_cycles"
    engine = "cycles"

    def _check_device(self) -> None:
        if self._kind == "gpu":
            text = f"renderer {self.name} draws on the CPU; leave out --device gpu"
            raise UsageError("DEVICE_SELECTOR", text)

    def _device_info(self, about: Mapping[str, Any]) -> Mapping[str, str]:
        return {"platform": f"Blender {about['version']}, Cycles", "name": "CPU", "kind": "cpu"}


class WorkbenchRenderer(_Blender):
    """Blender's viewport engine, OpenGL; `device` "cpu" forces Mesa's software renderer."""

    name = "blender_workbench"
    engine = "workbench"

    def _check_device(self) -> None:
        """Refuse what this engine would draw otherwise."""
        skin, white = self._mesh.textured, 255 if self._mesh.colors.dtype == np.uint8 else 1
        if skin is not None and (skin.sampler.alpha_cutoff is not None or self._mesh.colors.min() < white):
            text = f"renderer {self.name} draws textures alone: no cut-off, no colours that they are times"
            raise Unsupported("UNSUPPORTED_OPTION", text)

    def _device_info(self, about: Mapping[str, Any]) -> Mapping[str, str]:
        drawn_by = str(about["gpu"])
        kind = "cpu" if "llvmpipe" in drawn_by.lower() else "gpu"
        return {"platform": f"Blender {about['version']}, Workbench", "name": drawn_by, "kind": kind}


def blender_camera(camera: Camera, turn: NDArray[np.float64]) -> dict[str, Any]:
    """Return K and world_to_camera as Blender has them.

    The focal lengths become lens and pixel aspect, the principal point the shifts, which count in widths of
    the image; Blender's cameras look along -z with y up. `turn` (4, 4) is how an importer turned the world.
    """
    width, height = camera.width, camera.height
    ratio = camera.fx / camera.fy
    aspect = (1.0, ratio) if ratio >= 1 else (1 / ratio, 1.0)
    if min(width, height) < _MIN_SIDE or max(width, height) > _MAX_SIDE:
        text = f"Blender draws images of {_MIN_SIDE} to {_MAX_SIDE} pixels each way, not {width} x {height}"
        raise Unsupported("UNSUPPORTED_CAMERA", text)
    if max(aspect) > _MAX_ASPECT:
        text = f"fx / fy is {ratio:g}; Blender's pixels are at most {_MAX_ASPECT:g} times as long as wide"
        raise Unsupported("UNSUPPORTED_CAMERA", text)
    sensor = max(_SENSOR, 2 * width / camera.fx)
    return {
        "size": [width, height],
        "aspect": aspect,
        "sensor_width": sensor,
        "lens": camera.fx * sensor / width,
        "shift": [(width / 2 - camera.cx) / width, (camera.cy - height / 2) / width * aspect[1] / aspect[0]],
        "matrix": (turn @ camera.camera_to_world @ _FLIP @ np.diag([*[1 / _unit(camera)] * 3, 1])).tolist(),
    }


def _unit(camera: Camera) -> float:
    """Return the length of the camera's axes, which Blender takes for 1."""
    return float(np.linalg.norm(camera.camera_to_world[:3, 0]))


def _python() -> str | None:
    named = os.environ.get(VARIABLE)
    if named:
        return named if os.access(named, os.X_OK) else None
    return sys.executable if is_installed("bpy") else None


def _read_exr(path: Path) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return colours (H, W, 4) and depths (H, W) of what Blender wrote."""
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        planes = {name: np.array(found.pixels) for name, found in file.channels().items()}
    color = {name.rpartition(".")[2]: plane for name, plane in planes.items() if ".Combined." in name}
    depth = next(plane for name, plane in planes.items() if name.endswith(".Z"))
    rgba = np.stack([color[channel] for channel in "RGBA"], axis=-1)
    return _floats(rgba), _floats(np.where(depth < _FAR, depth, 0))


def _read_png(path: Path) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    from PIL import Image

    with Image.open(path) as image:
        rgba = _floats(np.asarray(image.convert("RGBA")) / 255)
    return rgba, np.zeros_like(rgba[..., 0])


def _floats(values: Any) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, np.float32)
