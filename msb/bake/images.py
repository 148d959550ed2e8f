"""Cameras with their target images: training, validation and test images.

Each image is rendered or read once and then kept in a temporary file instead of memory.
"""

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

# A function that draws the image (H, W, 3) of a camera in the asset's colour space. The image has float RGB
# values, or integers up to `MAX_LEVEL`.
DrawImage = Callable[["Camera"], Singles | NDArray[np.uint16]]
# Images are stored as integers with 16 bits per channel. With 16 bits, the rounding error is 257 times
# smaller than with 8 bits and does not limit PSNR.
MAX_LEVEL = 65535
# If there are at least this many views, each image is halved on one pixel grid instead of two. Using one
# pixel grid instead of two saves a sixth of the pixels.
_MANY_VIEWS = 32


class ViewImages:
    """Cameras with their target images.

    An image is drawn on first use and kept in an anonymous temporary file. Memory therefore does not grow
    with the number of views.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        background: Color,
        draw: DrawImage,
        backgrounds: Sequence[Color] | None = None,
    ) -> None:
        self.cameras = tuple(cameras)
        self.backgrounds = (background,) * len(self.cameras) if backgrounds is None else tuple(backgrounds)
        """The background colour of each image."""
        self.background = background
        self.weights = (1.0,) * len(self.cameras)
        """The weight of a pixel of each image in the least-squares fit of colours."""
        self._draw = draw
        self._offsets: dict[int, int] = {}
        self._file: IO[bytes] | None = None
        self._halves: dict[tuple[int, int], ViewImages] = {}

    def __len__(self) -> int:
        return len(self.cameras)

    def image(self, number: int) -> Singles:
        """Return image `number` as (H, W, 3) float32 in [0, 1]."""
        return self.stored_image(number) * np.float32(1 / MAX_LEVEL)

    def stored_image(self, number: int) -> NDArray[np.uint16]:
        """Return image `number` as (H, W, 3) uint16. The value `MAX_LEVEL` means 1."""
        camera = self.cameras[number]
        if self._file is None:
            self._file = tempfile.TemporaryFile()  # noqa: SIM115 - closed by `close`
        if number not in self._offsets:
            image = quantize(self._draw(camera))
            self._file.seek(0, 2)
            self._offsets[number] = self._file.tell()
            self._file.write(image.data)
            self._file.flush()
            return image
        self._file.seek(self._offsets[number])
        count = camera.height * camera.width * 3
        return np.frombuffer(self._file.read(2 * count), np.uint16).reshape(camera.height, camera.width, 3)

    def select(self, numbers: Sequence[int]) -> ViewImages:
        """Return the images with the indices `numbers`. This object still owns the temporary files."""
        return _ImageSubset([(self, number) for number in numbers], [self.weights[k] for k in numbers])

    def with_coarser_levels(self, pixels: int) -> ViewImages:
        """Return these images and copies of half the size, a quarter of the size, and so on. The smallest
        copies have at most `pixels` pixels.

        An image can be halved on four pixel grids, which are shifted 0 or 1 pixels to the right and down.
        Each image is halved on two grids that together cover all rows and columns. If there are many views,
        each image is halved on one grid only. Successive views use different grids. Pixels of a halved image
        have a larger weight, so that all image sizes have equal total weight. Images of two pixels or less
        along a side are not halved.
        """
        level = [(self, number) for number in range(len(self))]
        chosen, weights = [*level], [1.0] * len(level)
        grids = 1 if len(self) >= _MANY_VIEWS else 2
        while level[0][0].max_pixels > pixels and level[0][0]._shortest_side > 2:
            # Choose the pixel grids for the view with the index `turn`. A grid is shifted by 0 or 1 pixels of
            # the larger image to the right and down.
            level = [
                (images._halve(right, right ^ turn % 2), number)
                for turn, (images, number) in enumerate(level)
                for right in ((0, 1) if grids == 2 else (turn // 2 % 2,))
            ]
            weights += [4 / grids * weights[-1]] * len(level)
            chosen += level
        return _ImageSubset(chosen, weights)

    @property
    def max_pixels(self) -> int:
        """The number of pixels of the largest image."""
        return max(camera.width * camera.height for camera in self.cameras)

    @property
    def _shortest_side(self) -> int:
        return min(min(camera.width, camera.height) for camera in self.cameras)

    def limited_to(self, pixels: int) -> ViewImages:
        """Return these images, halved until the largest has at most `pixels` pixels.

        A pixel of a halved image is the average of four pixels. Each image size is computed once. Closing
        these images also deletes the temporary files of their halved images.
        """
        if self.max_pixels <= pixels:
            return self
        return self._halve().limited_to(pixels)

    def _halve(self, right: int = 0, down: int = 0) -> ViewImages:
        """Return images of half the width and height, on a pixel grid shifted by (right, down) pixels."""
        if (right, down) in self._halves:
            return self._halves[right, down]
        cameras = [
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
        numbers = {id(camera): number for number, camera in enumerate(cameras)}

        def average(camera: Camera) -> NDArray[np.uint16]:
            # Add up 2 x 2 pixels as integers, and round to the nearest average.
            image = self.stored_image(numbers[id(camera)])[down:, right:]
            image = image[: 2 * camera.height, : 2 * camera.width]
            rows = np.add(image[::2], image[1::2], dtype=np.uint32)
            total = rows[:, ::2] + rows[:, 1::2]
            return ((total + 2) >> 2).astype(np.uint16)

        halves = self._halves[right, down] = ViewImages(cameras, self.background, average, self.backgrounds)
        return halves

    def close(self) -> None:
        """Delete the temporary files of these images and of their halved images."""
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


def quantize(image: Singles | NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return an image as uint16. The value `MAX_LEVEL` means 1. NaN becomes 0."""
    if image.dtype == np.uint16:
        return np.ascontiguousarray(image)
    scaled = image * np.float32(MAX_LEVEL)
    np.fmax(scaled, 0, out=scaled)
    np.fmin(scaled, MAX_LEVEL, out=scaled)
    np.rint(scaled, out=scaled)
    return scaled.astype(np.uint16)


class _ImageSubset(ViewImages):
    """A subset of the images of other image sets.

    An image is identified by its set and its index in the set.
    """

    def __init__(self, chosen: Sequence[tuple[ViewImages, int]], weights: Sequence[float]) -> None:
        first = chosen[0][0]
        cameras = [images.cameras[number] for images, number in chosen]
        backgrounds = [images.backgrounds[number] for images, number in chosen]
        super().__init__(cameras, first.background, first._draw, backgrounds)
        self.weights = tuple(weights)
        self._chosen = chosen

    def stored_image(self, number: int) -> NDArray[np.uint16]:
        images, there = self._chosen[number]
        return images.stored_image(there)
