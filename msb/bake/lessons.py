"""The pictures that a plain asset is taught by: each is drawn once, and kept in a file, not in memory."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import IO, Self

import numpy as np
from numpy.typing import NDArray

from msb.bake.arrays import Singles
from msb.scenes import Camera
from msb.scenes.colors import Color

# From a camera to what it should see: (H, W, 3) RGB in the asset's colour space, or that in whole numbers of
# `STEPS`.
Draw = Callable[["Camera"], Singles | NDArray[np.uint16]]
STEPS = 65535  # images are stored with 16 bits a channel, 50 times finer than what is measured
_MANY = 32  # from this many views on, one half-pixel shift per image suffices


class Lessons:
    """Cameras and what each should see, over one background.

    A picture is drawn when it is first asked for, and kept in a temporary file that has no name, so that
    memory does not grow with the number of views.
    """

    def __init__(self, cameras: Sequence[Camera], background: Color, draw: Draw) -> None:
        self.cameras = tuple(cameras)
        self.background = background
        self.weights = (1.0,) * len(self.cameras)
        """How much a pixel of each picture counts where colours are fitted."""
        self._draw = draw
        self._places: dict[int, int] = {}
        self._file: IO[bytes] | None = None
        self._halves: dict[tuple[int, int], Lessons] = {}

    def __len__(self) -> int:
        return len(self.cameras)

    def image(self, number: int) -> Singles:
        """Return what camera `number` should see, (H, W, 3) float32 in [0, 1]."""
        return self.stored(number) * np.float32(1 / STEPS)

    def stored(self, number: int) -> NDArray[np.uint16]:
        """Return the same as whole numbers of `STEPS`."""
        camera = self.cameras[number]
        if self._file is None:
            self._file = tempfile.TemporaryFile()  # noqa: SIM115 - closed by `close`
        if number not in self._places:
            image = whole(self._draw(camera))
            self._file.seek(0, 2)
            self._places[number] = self._file.tell()
            self._file.write(image.data)
            self._file.flush()
            return image
        self._file.seek(self._places[number])
        count = camera.height * camera.width * 3
        return np.frombuffer(self._file.read(2 * count), np.uint16).reshape(camera.height, camera.width, 3)

    def part(self, numbers: Sequence[int]) -> Lessons:
        """Return some of these lessons, whose pictures stay here."""
        return _Chosen([(self, number) for number in numbers], [self.weights[number] for number in numbers])

    def with_halves(self, pixels: int) -> Lessons:
        """Return these lessons and coarser ones, down to those whose largest picture has so many pixels.

        Pixels of twice the side can lie on a picture's own in four ways, and views take turns: each picture
        is halved in two of them that together have a pixel in every row and column, or, where there are many
        views, in one. So that sizes count alike, pixels of halved pictures count so much more. Pictures of
        two pixels or less along a side are not halved.
        """
        level = [(self, number) for number in range(len(self))]
        chosen, weights = [*level], [1.0] * len(level)
        ways = 1 if len(self) >= _MANY else 2
        while level[0][0].largest > pixels and level[0][0]._narrowest > 2:
            level = [
                (one._halved(right, right ^ turn % 2), number)
                for turn, (one, number) in enumerate(level)
                for right in ((0, 1) if ways == 2 else (turn // 2 % 2,))
            ]
            weights += [4 / ways * weights[-1]] * len(level)
            chosen += level
        return _Chosen(chosen, weights)

    @property
    def largest(self) -> int:
        """The pixels of the largest picture."""
        return max(camera.width * camera.height for camera in self.cameras)

    @property
    def _narrowest(self) -> int:
        """The shortest side of a picture."""
        return min(min(camera.width, camera.height) for camera in self.cameras)

    def within(self, pixels: int) -> Lessons:
        """Return these lessons, or coarser ones: their pictures halved until the largest has so many pixels.

        A pixel of a halved picture is the mean of four. Each size is made once, and closed with these.
        """
        if self.largest <= pixels:
            return self
        return self._halved().within(pixels)

    def _halved(self, right: int = 0, down: int = 0) -> Lessons:
        """Return lessons of half as many pixels each way, of what is so many pixels to the right and down."""
        if (right, down) in self._halves:
            return self._halves[right, down]
        halves = [
            replace(
                camera,
                width=(camera.width - right) // 2,
                height=(camera.height - down) // 2,
                fx=camera.fx / 2,
                fy=camera.fy / 2,
                cx=(camera.cx - right) / 2,
                cy=(camera.cy - down) / 2,
            )
            for camera in self.cameras
        ]
        numbers = {id(camera): number for number, camera in enumerate(halves)}

        def halved(camera: Camera) -> NDArray[np.uint16]:
            image = self.stored(numbers[id(camera)])[down:, right:][: 2 * camera.height, : 2 * camera.width]
            rows = np.add(image[::2], image[1::2], dtype=np.uint32)
            total = rows[:, ::2] + rows[:, 1::2]
            return ((total + 2) >> 2).astype(np.uint16)

        made = self._halves[right, down] = Lessons(halves, self.background, halved)
        return made

    def close(self) -> None:
        """Give the files back, of the coarser lessons as well."""
        for halves in self._halves.values():
            halves.close()
        if self._file is not None:
            self._file.close()

    def __del__(self) -> None:
        self.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def whole(image: Singles | NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return a picture in whole numbers of `STEPS`, black where it has no numbers."""
    if image.dtype == np.uint16:
        return np.ascontiguousarray(image)
    scaled = image * np.float32(STEPS)
    np.fmax(scaled, 0, out=scaled)
    np.fmin(scaled, STEPS, out=scaled)
    np.rint(scaled, out=scaled)
    return scaled.astype(np.uint16)


class _Chosen(Lessons):
    """Lessons of others, by their number there, which keep the pictures."""

    def __init__(self, chosen: Sequence[tuple[Lessons, int]], weights: Sequence[float]) -> None:
        first = chosen[0][0]
        super().__init__([one.cameras[number] for one, number in chosen], first.background, first._draw)
        self.weights = tuple(weights)
        self._chosen = chosen

    def stored(self, number: int) -> NDArray[np.uint16]:
        one, there = self._chosen[number]
        return one.stored(there)
