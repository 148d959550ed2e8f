"""Pictures that a model's own renderer drew, in a folder, so that another bake need not draw them again."""

import hashlib
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.build import as_bytes
from msb.base.atomic import new_file
from msb.base.files import is_file, read_file
from msb.scenes import Camera

SUFFIX = ".look"
_HEAD = hashlib.sha256().digest_size


class Pictures:
    """A folder of pictures, each under a hash of all that decides it: in its file a SHA-256 of what follows
    stands before rows of pixels of three uint16.

    Parameters
    ----------
    folder : Path
        It need not exist.
    asset : Asset
        What is drawn.
    by : sequence of str
        What draws it, and how.
    """

    def __init__(self, folder: Path, asset: Asset, by: tuple[str, ...]) -> None:
        self._folder = folder
        digest = hashlib.sha256(asset.manifest.to_bytes())
        for name in sorted(asset.buffers):
            digest.update(as_bytes(np.ascontiguousarray(asset.buffers[name])))
        self._about = [digest.hexdigest(), *by]
        self._found: set[str] = set()
        self._made: set[str] = set()
        self._damaged = 0

    def picture(
        self,
        camera: Camera,
        background: tuple[float, float, float],
        draw: Callable[[Camera], NDArray[np.uint16]],
    ) -> NDArray[np.uint16]:
        """Return what `camera` sees, (H, W, 3), from its file, else drawn, and written there.

        A file that is damaged counts as none. Raises what `draw` does, and OutputError.
        """
        key = self._key(camera, background)
        path = self._folder / f"{key}{SUFFIX}"
        shape = camera.height, camera.width, 3
        if is_file(path):
            image = _checked(path, shape)
            if image is not None:
                self._found |= {key} - self._made
                return image
            self._damaged += 1
        image = draw(camera)
        self._made.add(key)
        with new_file(path, size=_HEAD + image.nbytes) as file:
            file.write(hashlib.sha256(image.data).digest())
            file.write(image.data)
        return image

    def notes(self) -> list[str]:
        """Return what should be known of where pictures came from."""
        if not self._found and not self._damaged:
            return []
        count = len(self._found)
        said = f"{count} of {count + len(self._made)} pictures were drawn by a bake before"
        return [f"{said}; {self._damaged} of the cache are damaged: drawn again" if self._damaged else said]

    def _key(self, camera: Camera, background: tuple[float, float, float]) -> str:
        lens = camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, camera.unit
        about = [
            *self._about,
            *map(float, lens),
            camera.world_to_camera.tolist(),
            list(map(float, background)),
        ]
        return hashlib.sha256(json.dumps(about).encode()).hexdigest()


def _checked(path: Path, shape: tuple[int, int, int]) -> NDArray[np.uint16] | None:
    """Return the pixels of a file, None if they are not those that were written."""
    size = 2 * math.prod(shape)
    data = memoryview(read_file(path, _HEAD + size))
    if len(data) != _HEAD + size or hashlib.sha256(data[_HEAD:]).digest() != data[:_HEAD]:
        return None
    return np.frombuffer(data[_HEAD:], np.uint16).reshape(shape)
