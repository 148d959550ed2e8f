"""Engines that run in a separate process, with a virtual screen if they need one."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import msb
from benchmarks.opened_in.scenes import HEIGHT, WIDTH, Scene
from benchmarks.opened_in.shown import ENGINES, NOT_INSTALLED, Shown
from msb.base.extras import is_installed
from msb.engines.blender import VARIABLE
from msb.render.backend import why_unavailable

_HERE = Path(__file__).parent
_PYTHON = ENGINES / "python"
_LONGEST_SECONDS = 600


@dataclass(frozen=True)
class PythonEngine:
    """An engine from PyPI, driven by a script in this folder."""

    script: str
    package: str
    screen: bool = False

    def missing(self) -> str | None:
        """Return the reason why the engine cannot run here, or None."""
        if not (_PYTHON / self.package).is_dir() and not is_installed(self.package):
            return NOT_INSTALLED
        return "no virtual screen found; run make engines" if self.screen and not _screen_is_there() else None

    def draw(self, glb: bytes, scene: Scene, *, mended: bool) -> Shown:
        """Return the engine's image of a file."""
        path = os.pathsep.join([str(_PYTHON), os.environ.get("PYTHONPATH", "")])
        with _screen() if self.screen else _nothing() as display:
            return _run(sys.executable, self.script, glb, scene, mended, {"PYTHONPATH": path, **display})


class Blender:
    """Blender, through bpy."""

    def missing(self) -> str | None:
        """Return the reason why the engine cannot run here, or None."""
        return why_unavailable("blender_workbench")

    def draw(self, glb: bytes, scene: Scene, *, mended: bool) -> Shown:
        """Return the engine's image of a file."""
        return _run(os.environ.get(VARIABLE, sys.executable), "in_blender.py", glb, scene, mended, {})


class Godot:
    """Godot 3 from Debian: the editor imports the file into a project, which then runs."""

    def missing(self) -> str | None:
        """Return the reason why the engine cannot run here, or None."""
        return None if shutil.which("godot3") and _screen_is_there() else NOT_INSTALLED

    def draw(self, glb: bytes, scene: Scene, *, mended: bool) -> Shown:
        """Return the engine's image of a file."""
        with tempfile.TemporaryDirectory() as made, _screen() as display:
            folder = Path(made)
            for path in (_HERE / "godot").iterdir():
                shutil.copy(path, folder)
            (folder / "model.glb").write_bytes(glb)
            (folder / "view.json").write_text(json.dumps({**scene.view, "mended": mended}))
            command = ["godot3", "--path", made, "--audio-driver", "Dummy"]
            for more in (["--editor", "--quit"], []):
                done = _output([*command, *more], {"HOME": made, **display}, made)
            image = np.asarray(Image.open(folder / "picture.png").convert("RGB"))
        number = done.partition("Godot Engine v")[2].partition(".stable")[0]
        return Shown(image, f"{number}, {done.partition('drawn by ')[2].splitlines()[0]}")


class Ours:
    """Our engine `wgpu`, which reads the written file again."""

    def missing(self) -> str | None:
        """Return the reason why the engine cannot run here, or None."""
        return why_unavailable("wgpu")

    def draw(self, glb: bytes, scene: Scene, *, mended: bool) -> Shown:
        """Return the engine's image of a file."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "model.glb")
            path.write_bytes(glb)
            asset = msb.open(path)
        with msb.Renderer(asset, "standard", name="wgpu") as renderer:
            frame = renderer.render(scene.camera, (0.0, 0.0, 0.0))
            about = renderer.device_info or {}
            image = np.round(255 * np.clip(frame.image, 0, 1)).astype(np.uint8)
            return Shown(image, f"{version('wgpu')}, {about['name']}")


def _run(
    python: str, script: str, glb: bytes, scene: Scene, mended: bool, variables: Mapping[str, str]
) -> Shown:
    with tempfile.TemporaryDirectory() as folder:
        file, picture = Path(folder, "model.glb"), Path(folder, "picture.png")
        file.write_bytes(glb)
        wanted = json.dumps({**scene.view, "size": [WIDTH, HEIGHT], "mended": mended})
        command = [python, str(_HERE / script), file.name, picture.name, wanted]
        about: dict[str, Any] = json.loads(_output(command, variables, folder).splitlines()[-1])
        image = np.asarray(Image.open(picture).convert("RGB"))
    return Shown(image, f"{about['version']}, {about['device']}")


def _output(command: list[str], variables: Mapping[str, str], folder: str) -> str:
    done = subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        timeout=_LONGEST_SECONDS,
        check=False,
    )
    if done.returncode:
        last = [line for line in done.stderr.splitlines() if line.strip()][-1:]
        raise RuntimeError(f"the process ended with status {done.returncode}: {''.join(last)}")
    return done.stdout


def _screen_is_there() -> bool:
    return shutil.which("Xvfb") is not None


@contextmanager
def _screen() -> Iterator[dict[str, str]]:
    """Yield the environment variable of a virtual screen."""
    read, write = os.pipe()
    command = ["Xvfb", "-displayfd", str(write), "-screen", "0", "1280x1024x24", "-nolisten", "tcp"]
    server = subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL)
    os.close(write)
    try:
        with os.fdopen(read) as pipe:
            yield {"DISPLAY": f":{pipe.readline().strip()}"}
    finally:
        server.terminate()
        server.wait()


@contextmanager
def _nothing() -> Iterator[dict[str, str]]:
    yield {}
