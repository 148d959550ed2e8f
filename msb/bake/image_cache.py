"""A folder that caches native renderings. Later bakes of the same model reuse the cached renderings."""

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

# The suffix of cached images.
SUFFIX = ".look"
# Number of bytes of the SHA-256 hash that precedes the pixels in a file.
_HASH_BYTES = hashlib.sha256().digest_size


class ImageCache:
    """A cache folder with one file per image, named by a hash of the model, the renderer and the camera.

    A file contains the SHA-256 hash of the pixels, then the pixels row by row. A pixel is three uint16
    values.

    Parameters
    ----------
    folder : Path
        The folder is created when the first image is stored.
    asset : Asset
        The rendered model.
    renderer : tuple of str
        The renderer, the version of the renderer, and the settings.
    """

    def __init__(self, folder: Path, asset: Asset, renderer: tuple[str, ...]) -> None:
        self._folder = folder
        digest = hashlib.sha256(asset.manifest.to_bytes())
        for name in sorted(asset.buffers):
            digest.update(as_bytes(np.ascontiguousarray(asset.buffers[name])))
        self._identity = [digest.hexdigest(), *renderer]
        self._reused: set[str] = set()
        self._rendered: set[str] = set()
        self._damaged = 0

    def get(
        self,
        camera: Camera,
        background: tuple[float, float, float],
        render: Callable[[Camera], NDArray[np.uint16]],
    ) -> NDArray[np.uint16]:
        """Return the image (H, W, 3) of a camera from its cached file, or render and store the image.

        A damaged file is ignored, and its image is rendered again. Raises the errors of `render`, and
        OutputError.
        """
        key = self._make_key(camera, background)
        path = self._folder / f"{key}{SUFFIX}"
        shape = camera.height, camera.width, 3
        if is_file(path):
            image = _read_checked(path, shape)
            if image is not None:
                self._reused |= {key} - self._rendered
                return image
            self._damaged += 1
        image = render(camera)
        self._rendered.add(key)
        with new_file(path, size=_HASH_BYTES + image.nbytes) as file:
            file.write(hashlib.sha256(image.data).digest())
            file.write(image.data)
        return image

    def notes(self) -> list[str]:
        """Return a note with the numbers of reused and damaged images, or an empty list."""
        if not self._reused and not self._damaged:
            return []
        count = len(self._reused)
        text = f"{count} of {count + len(self._rendered)} images were taken from the cache"
        if self._damaged:
            text = f"{text}; {self._damaged} cached images are damaged and were rendered again"
        return [text]

    def _make_key(self, camera: Camera, background: tuple[float, float, float]) -> str:
        lens = camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, camera.unit
        parts = [
            *self._identity,
            *map(float, lens),
            camera.world_to_camera.tolist(),
            list(map(float, background)),
        ]
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _read_checked(path: Path, shape: tuple[int, int, int]) -> NDArray[np.uint16] | None:
    """Return the pixels of a cached file, or None if its size or its hash is wrong."""
    size = 2 * math.prod(shape)
    data = memoryview(read_file(path, _HASH_BYTES + size))
    if len(data) != _HASH_BYTES + size or hashlib.sha256(data[_HASH_BYTES:]).digest() != data[:_HASH_BYTES]:
        return None
    return np.frombuffer(data[_HASH_BYTES:], np.uint16).reshape(shape)
