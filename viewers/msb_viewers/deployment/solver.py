"""The reference in a child process, because NumPy would hold up the window and cannot be interrupted."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import tempfile
import time
from collections.abc import Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msb.errors import MsbError
from msb_viewers.deployment.shots import REFERENCE, Shot

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.scenes import Camera

_PREVIEW = 160
"""The longer side of the preview, in pixels."""


class ReferenceSolver:
    """Computes the reference of one camera at a time, first a small preview, then all of it.

    An asset without a file is written to a temporary one, which the child maps.
    """

    def __init__(self, asset: Asset, settings: Mapping[str, Any]) -> None:
        self._asset, self._settings = asset, dict(settings)
        self._process: Any = None
        self._link: Connection | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._waiting = 0
        self._size = ""
        self._since = 0.0

    def start(self, camera: Camera, background: tuple[float, float, float]) -> None:
        """Compute the picture of a camera, instead of what is computed now."""
        self.cancel()
        if self._process is None:
            self._launch()
        preview = camera.scaled(min(_PREVIEW / max(camera.width, camera.height), 1.0))
        cameras = [preview, camera] if preview.width < camera.width else [camera]
        assert self._link is not None
        for each in cameras:
            self._link.send((each, background))
        self._waiting = len(cameras)
        self._size = f"{camera.width} x {camera.height}"
        self._since = time.monotonic()

    def collect(self) -> Shot | None:
        """Return a picture that has become ready: first the preview, then the whole picture; or why not."""
        if not self._waiting or self._link is None:
            return None
        try:
            if not self._link.poll():
                return None
            shot: Shot = self._link.recv()
        except (EOFError, OSError):
            self._end()
            return Shot(
                REFERENCE, why="the process that computes it has ended; it may have run out of memory"
            )
        self._waiting -= 1
        return shot

    @property
    def busy(self) -> str | None:
        """What is being computed and for how long, in words; None if nothing is."""
        if not self._waiting:
            return None
        return f"computing {self._size} in NumPy: {time.monotonic() - self._since:.0f} s"

    def cancel(self) -> None:
        """Stop computing; an idle child process is kept."""
        if self._waiting:
            self._end()

    def close(self) -> None:
        """End the child and remove its file. Twice is harmless."""
        self._end()
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def _launch(self) -> None:
        # Not a fork: the window's threads and the device's would be copied half.
        context = multiprocessing.get_context("spawn")
        self._link, theirs = context.Pipe()
        arguments = (theirs, str(self._asset_file()), self._settings)
        self._process = context.Process(target=_serve, args=arguments, daemon=True, name="msb-reference")
        self._process.start()
        theirs.close()

    def _asset_file(self) -> Path:
        from msb.asset import is_asset, write_asset

        if self._asset.path is not None and is_asset(Path(self._asset.path)):
            return Path(self._asset.path)
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="msb-view-", ignore_cleanup_errors=True)
            write_asset(self._asset, Path(self._folder.name) / "shown.triasset")
        return Path(self._folder.name) / "shown.triasset"

    def _end(self) -> None:
        self._waiting = 0
        if self._process is not None:
            self._process.terminate()
            self._process.join()
            self._process = None
        if self._link is not None:
            self._link.close()
            self._link = None


def _serve(link: Connection, path: str, settings: dict[str, Any]) -> None:
    """Answer each task with a shot until the other end is closed."""
    from msb.asset import load
    from msb.render import Renderer
    from msb.render.images import to_bytes

    with contextlib.suppress(OSError, AttributeError):
        os.nice(5)  # the window comes first
    with (
        contextlib.suppress(EOFError, OSError, KeyboardInterrupt),
        Renderer(load(path), REFERENCE, settings=settings) as renderer,
    ):
        while True:
            camera, background = link.recv()
            try:
                frame = renderer.render(camera, background)
                spent = sum(frame.timings.values())
                link.send(Shot(REFERENCE, to_bytes(frame.image), "", spent, None, "NumPy"))
            except MsbError as error:
                link.send(Shot(REFERENCE, why=str(error)))
            except MemoryError:
                link.send(Shot(REFERENCE, why="there is too little memory for a picture of this size"))
