"""The pictures that a plain asset is taught by: each is drawn once, and kept in a file, not in memory."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from typing import IO, TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from msb.scenes import Camera
    from msb.scenes.colors import Color

Draw = Callable[["Camera"], NDArray[np.float32]]
"""From a camera to what it should see: (H, W, 3) float32 RGB in the asset's colour space."""
STEPS = 65535
"""Pictures are kept in 16 bits a channel: 50 times finer than what is measured of them."""


class Lessons:
    """Cameras and what each should see, over one background.

    A picture is drawn when it is first asked for, and kept in a temporary file that has no name, so that
    memory does not grow with the number of views.
    """

    def __init__(self, cameras: Sequence[Camera], background: Color, draw: Draw) -> None:
        self.cameras = tuple(cameras)
        self.background = background
        self._draw = draw
        self._places: dict[int, int] = {}
        self._file: IO[bytes] | None = None
        self._half: Lessons | None = None

    def __len__(self) -> int:
        return len(self.cameras)

    def image(self, number: int) -> NDArray[np.float32]:
        """Return what camera `number` should see, (H, W, 3) float32 in [0, 1]."""
        return self.stored(number) * np.float32(1 / STEPS)

    def stored(self, number: int) -> NDArray[np.uint16]:
        """Return the same as whole numbers of `STEPS`."""
        camera = self.cameras[number]
        if self._file is None:
            self._file = tempfile.TemporaryFile()  # noqa: SIM115 - closed by `close`
        if number not in self._places:
            image = np.clip(np.nan_to_num(self._draw(camera)), 0, 1)
            self._file.seek(0, 2)
            self._places[number] = self._file.tell()
            self._file.write(np.rint(image * STEPS).astype(np.uint16).tobytes())
            self._file.flush()
        self._file.seek(self._places[number])
        count = camera.height * camera.width * 3
        return np.frombuffer(self._file.read(2 * count), np.uint16).reshape(camera.height, camera.width, 3)

    def part(self, numbers: Sequence[int]) -> Lessons:
        """Return some of these lessons, whose pictures stay here."""
        return _Part(self, numbers)

    def within(self, pixels: int) -> Lessons:
        """Return these lessons, or coarser ones: their pictures halved until the largest has so many pixels.

        A pixel of a halved picture is the mean of four. Each size is made once, and closed with these.
        """
        largest = max(camera.width * camera.height for camera in self.cameras)
        if largest <= pixels:
            return self
        if self._half is None:
            self._half = self._halved()
        return self._half.within(pixels)

    def _halved(self) -> Lessons:
        """Return lessons of half as many pixels each way."""
        halves = [camera.resized(camera.width // 2, camera.height // 2) for camera in self.cameras]
        numbers = {id(camera): number for number, camera in enumerate(halves)}

        def halved(camera: Camera) -> NDArray[np.float32]:
            image = self.image(numbers[id(camera)])[: 2 * camera.height, : 2 * camera.width]
            means: NDArray[np.float32] = image.reshape(camera.height, 2, camera.width, 2, 3).mean(axis=(1, 3))
            return means

        return Lessons(halves, self.background, halved)

    def close(self) -> None:
        """Give the files back, of the coarser lessons as well."""
        if self._half is not None:
            self._half.close()
        if self._file is not None:
            self._file.close()

    def __del__(self) -> None:
        self.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _Part(Lessons):
    """Some of the lessons of a whole, which keeps their pictures."""

    def __init__(self, whole: Lessons, numbers: Sequence[int]) -> None:
        super().__init__([whole.cameras[number] for number in numbers], whole.background, whole._draw)
        self._whole, self._numbers = whole, numbers

    def stored(self, number: int) -> NDArray[np.uint16]:
        return self._whole.stored(self._numbers[number])
