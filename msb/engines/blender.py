"""The renderers `blender_cycles` and `blender_workbench` run Blender as the module bpy in a child process.

Blender imports the PLY or GLB file that `msb convert` writes, as an artist would do. The page docs/engines.md
lists the settings for exact colours. `blender_worker.py` is the program of the child process.
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
from msb.render.backend import DrawTime
from msb.render.frame import Frame
from msb.scenes import Camera
from msb.scenes.colors import Color

# The environment variable with the path of a Python interpreter that has bpy. The variable is only needed if
# the Python interpreter of msb has no bpy.
VARIABLE = "MSB_BLENDER"
# Blender's limits: the smallest and largest image side in pixels, and the largest pixel aspect ratio.
_MIN_SIDE, _MAX_SIDE, _MAX_ASPECT = 4, 65536, 200.0
# Width of the camera sensor in millimetres. Images depend only on the ratio of the sensor width to the focal
# length. A wide sensor keeps the focal length above 1 mm, the minimum in Blender.
_SENSOR = 100.0
# Rotation from Blender's camera axes (x right, y up, looking along -z) to OpenCV's camera axes.
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
# Blender's glTF importer applies this rotation, from y up to z up, to a model.
_GLB_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
# Maximum time of a request in seconds. Blender is stopped when a request takes longer. Cycles takes minutes
# to render large meshes.
_LONGEST_SECONDS = 1800
# Depths above this value mark pixels without a face in Blender's images.
_FAR = 1e10


class _Blender(Engine):
    """Blender as a renderer.

    Parameters
    ----------
    source : {"ply", "glb"}
        The file format of the mesh. Blender's PLY importer keeps float colours, but its glTF importer rounds
        colours to bytes. Meshes with textures are always passed as GLB.
    defaults : bool
        Keep Blender's default colour management, to show the effect of the settings for exact colours. With
        the default colour management, images are read from the 8-bit PNG that Blender writes.
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
            path.write_bytes(self._mesh.to_bytes(path.suffix))
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
            text = (
                f"Blender found no GPU, only {self.device_info['name']}; pass --device cpu to draw with "
                "this device"
            )
            raise DeviceError("DEVICE_NOT_FOUND", text)

    def _check_device(self) -> None:
        """Raise an error if Blender cannot draw the asset, or cannot draw on the requested device."""

    def _device_info(self, about: Mapping[str, Any]) -> Mapping[str, str]:
        """Return the value for `device_info`, which the worker sends with its first answer."""
        raise NotImplementedError

    @classmethod
    def missing(cls) -> str | None:
        """Return the name of a missing package, or None."""
        if _python() is not None:
            # If another Python has bpy, the Python of msb only needs the package OpenEXR.
            return None if is_installed("OpenEXR") else f"OpenEXR is not installed: {install('bench')}"
        if os.environ.get(VARIABLE):
            return f"{VARIABLE} is {shorten(os.environ[VARIABLE], 80)}, which is not an executable file"
        text = f"bpy is not installed: {install('blender')} with Python 3.11 or 3.13"
        return f"{text}, or set {VARIABLE} to a Python interpreter that has bpy"

    @classmethod
    def installed(cls) -> str:
        """Return the version of bpy, or "" if bpy is not installed."""
        python = _python()
        if python is None:
            return ""
        code = "import importlib.metadata; print(importlib.metadata.version('bpy'))"
        process = subprocess.run(
            [python, "-c", code], capture_output=True, text=True, timeout=60, check=False
        )
        return process.stdout.strip()

    def memory(self) -> Mapping[str, int]:
        """Return the memory growth of Blender's process in bytes. Blender does not report memory by use."""
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
            image = linear_to_srgb(np.clip(image, 0, 1))  # textured images are rendered in linear light
        return opaque_frame(image, rgba[..., 3] > 0.5, depth, background, None, times)

    def _draw(self, camera: Camera, background: Color) -> DrawTime:
        times = self._render(camera, {})
        return DrawTime(times, sum(times.values()))

    def _render(self, camera: Camera, target: Mapping[str, str]) -> dict[str, float]:
        low, high = self._mesh.depth_range(camera.world_to_camera)
        # Near and far planes close to the mesh give the depth buffer the best resolution.
        clip = [_unit(camera) * plane for plane in (max(NEAR, 0.99 * low), max(2 * NEAR, 1.01 * high))]
        request = blender_camera(camera, self._turn)
        return {WALL_CLOCK: float(self._ask({**request, "clip": clip, **target})["ms"])}

    def _ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Send a request to the worker and return the answer. Raise ENGINE_FAILED if no answer arrives."""
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
            raise DeviceError("ENGINE_FAILED", f"Blender ended unexpectedly: {self._last_log_line()}")
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise DeviceError("ENGINE_FAILED", f"Blender: {shorten(answer['error'], 200)}")
        self._resident = int(answer["resident"])
        return answer

    def _last_log_line(self) -> str:
        """Return the last line that Blender printed, and the exit status of its process."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=10)
        self._log.seek(0)
        lines = [line.strip() for line in self._log.read().decode("utf-8", "replace").splitlines()]
        last = next((line for line in reversed(lines) if line), "the log of Blender is empty")
        return f"{shorten(last, 200)} (status {self._process.returncode})"


class CyclesRenderer(_Blender):
    """Blender's path tracer on the CPU, with one ray through the centre of each pixel."""

    name = "blender_cycles"
    engine = "cycles"

    def _check_device(self) -> None:
        if self._kind == "gpu":
            text = f"renderer {self.name} runs on the CPU only; omit --device gpu"
            raise UsageError("DEVICE_SELECTOR", text)

    def _device_info(self, about: Mapping[str, Any]) -> Mapping[str, str]:
        return {"platform": f"Blender {about['version']}, Cycles", "name": "CPU", "kind": "cpu"}


class WorkbenchRenderer(_Blender):
    """Blender's viewport engine, which uses OpenGL; `device` "cpu" selects Mesa's software renderer."""

    name = "blender_workbench"
    engine = "workbench"

    def _check_device(self) -> None:
        """Reject textures with an alpha cutoff or with vertex colours, which Workbench ignores."""
        skin, white = self._mesh.textured, 255 if self._mesh.colors.dtype == np.uint8 else 1
        if skin is not None and (skin.sampler.alpha_cutoff is not None or self._mesh.colors.min() < white):
            text = f"renderer {self.name} cannot draw textures with an alpha cutoff or vertex colours"
            raise Unsupported("UNSUPPORTED_OPTION", text)

    def _device_info(self, about: Mapping[str, Any]) -> Mapping[str, str]:
        drawn_by = str(about["gpu"])
        kind = "cpu" if "llvmpipe" in drawn_by.lower() else "gpu"
        return {"platform": f"Blender {about['version']}, Workbench", "name": drawn_by, "kind": kind}


def blender_camera(camera: Camera, turn: NDArray[np.float64]) -> dict[str, Any]:
    """Return a camera as the properties of Blender's camera and render settings.

    The focal lengths determine `lens` (in mm) and the pixel aspect ratio. The principal point determines
    `shift`, in image widths. `turn` (4, 4) is the rotation that the importer has applied to the model.
    """
    width, height = camera.width, camera.height
    ratio = camera.fx / camera.fy
    aspect = (1.0, ratio) if ratio >= 1 else (1 / ratio, 1.0)
    if min(width, height) < _MIN_SIDE or max(width, height) > _MAX_SIDE:
        text = f"Blender renders {_MIN_SIDE} to {_MAX_SIDE} pixels per side, not {width} x {height}"
        raise Unsupported("UNSUPPORTED_CAMERA", text)
    if max(aspect) > _MAX_ASPECT:
        text = f"the pixel aspect ratio fx / fy is {ratio:g}; Blender allows at most {_MAX_ASPECT:g}"
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
    """Return the length in world units of the camera's axes.

    In Blender, the axes of a camera always have the length 1.
    """
    return float(np.linalg.norm(camera.camera_to_world[:3, 0]))


def _python() -> str | None:
    """Return the path of a Python interpreter with bpy, or None."""
    path = os.environ.get(VARIABLE)
    if path:
        return path if os.access(path, os.X_OK) else None
    return sys.executable if is_installed("bpy") else None


def _read_exr(path: Path) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return colours (H, W, 4) and depths (H, W) from Blender's EXR file.

    Pixels without a face have depth 0.
    """
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        planes = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    color = {name.rpartition(".")[2]: plane for name, plane in planes.items() if ".Combined." in name}
    depth = next(plane for name, plane in planes.items() if name.endswith(".Z"))
    rgba = np.stack([color[channel] for channel in "RGBA"], axis=-1)
    return _floats(rgba), _floats(np.where(depth < _FAR, depth, 0))


def _read_png(path: Path) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the colours (H, W, 4) in Blender's PNG file, and depths (H, W) that are all 0."""
    from PIL import Image

    with Image.open(path) as image:
        rgba = _floats(np.asarray(image.convert("RGBA")) / 255)
    return rgba, np.zeros_like(rgba[..., 0])


def _floats(values: Any) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, np.float32)
