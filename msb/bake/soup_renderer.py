"""Standard-tier renderers that draw a soup and compare the images with target images on the device."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.bake.arrays import Floats, Mask, Singles
from msb.bake.images import ViewImages
from msb.base.origin import NO_ORIGIN
from msb.cl import Buffer, Device, sort_pairs
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.render.device_scope import in_turn
from msb.render.standard.renderer import StandardRenderer, view_record
from msb.render.standard.supersampling import box_mean
from msb.render.standard.triangles import RECORD_DEFINES

# The sums of a face are products of the weights a, b and c of its corners: aa, ab, ac, bb, bc, cc, and red,
# green and blue times a, b and c.
SUMS_PER_FACE = 15
# Work-items of a work-group, for all kernels of this module. All devices support work-groups of this size.
_GROUP = 64
# `measure_error` compares the averages of pixel blocks with this side length. The error of single pixels
# depends mainly on the subpixel positions of edges.
_BLOCK = 2
# Number of bytes of target images that stay on the device. Target images that exceed this size are sent to
# the device one by one when they are needed.
_MAX_RESIDENT_BYTES = 1 << 28


class FaceSums(NamedTuple):
    """Sums over the pixels that show each of F faces, accumulated over some views."""

    # (F, 15), see `SUMS_PER_FACE`.
    sums: Singles
    # (F,) the largest number of pixels of each face in a single view.
    max_pixels: NDArray[np.uint32]
    # (F, 3, 3) the derivatives of the squared error with respect to the corner positions, per unit of the
    # scene.
    gradients: Singles


class SupervisedRenderer(StandardRenderer):
    """Draws an asset from the cameras of target images, and keeps the images on the device."""

    def __init__(self, asset: Asset, images: ViewImages, device: str | Device | None = None) -> None:
        super().__init__(asset, device=device)
        self._set_images(images)

    def _set_images(self, images: ViewImages) -> None:
        self.images = images
        self.pixels = sum(camera.width * camera.height for camera in images.cameras)
        self._is_resident = 6 * self.pixels <= _MAX_RESIDENT_BYTES
        self._targets: dict[int, Buffer] = {}
        self._views: dict[int, Buffer] = {}

    def _count_pixels(self, number: int) -> int:
        camera = self.images.cameras[number]
        return camera.width * camera.height

    def _draw_view(self, number: int) -> tuple[dict[str, Buffer], Buffer, int]:
        """Queue a rendering. Return the renderer's buffers, the camera's kernel values, and the number of
        pixels."""
        camera = self.images.cameras[number].in_units()
        if number not in self._views:
            self._views[number] = self._device.upload(view_record(camera), "bake views")
        view = self._views[number]
        planes = self._run(camera, self.images.backgrounds[number], everything=True, view=view)
        return planes, view, self._count_pixels(number)

    def _load_target(self, number: int) -> Buffer:
        """Return the target image of a view on the device."""
        if number in self._targets:
            return self._targets[number]
        image = self.images.stored_image(number)
        if self._is_resident:
            buffer = self._device.allocate(image.shape, image.dtype, "bake images")
            self._targets[number] = buffer
        else:
            buffer = self._scratch("target image", image.shape, image.dtype)
        buffer.write(image)
        return buffer


class SoupRenderer(SupervisedRenderer):
    """Draws a soup of F faces and compares it with target images.

    Parameters
    ----------
    corners : (F, 3, 3) float32
    colors : (F, 3, 3) float32
        RGB of each corner.
    images : ViewImages
    device : str or Device, optional
    """

    moves = True

    def __init__(
        self, corners: Singles, colors: Singles, images: ViewImages, device: str | Device | None = None
    ) -> None:
        count = len(corners)
        soup = Mesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), colors.reshape(-1, 3))
        super().__init__(asset_from_mesh(soup, origin=NO_ORIGIN), images, device)
        self._count = count
        wide = self._device.record.int64_atomics
        self._total_type = np.int64 if wide else np.int32
        self._kernels = self._device.program("bake", {**RECORD_DEFINES, "WIDE": wide})

    def with_images(self, images: ViewImages) -> SoupRenderer:
        """Return a renderer of the same faces for other images.

        Both renderers share the faces. Updates of one renderer also change the other renderer, and closing
        one renderer closes both.
        """
        other = copy(self)
        other._set_images(images)
        return other

    @in_turn
    def update(self, corners: Singles, colors: Singles, selected: Mask) -> None:
        """Set the corners and colours of the faces. Hidden faces collapse to a point without pixels."""
        placed = np.where(selected[:, None, None], corners, corners[:, :1])
        self._triangles.sources["positions"].write(np.ascontiguousarray(placed.reshape(-1, 3), np.float32))
        self._triangles.sources["colors"].write(np.ascontiguousarray(colors.reshape(-1, 3), np.float32))
        self._triangles.fill()

    @in_turn
    def sum_faces(self, numbers: Iterable[int], *, gradients: bool = True) -> FaceSums:
        """Return the sums over the pixels of each face in these views.

        The gradients are 0 unless `gradients` is true. The pixels of a face are added view by view in a fixed
        order, so that results are reproducible.
        """
        count = self._count
        outputs = [
            self._scratch(f"sum of {name}", shape)
            for name, shape in (("products", (count, SUMS_PER_FACE)), ("gradients", (count, 3, 3)))
        ]
        most = self._scratch("most", count, np.uint32)
        for buffer in (*outputs, most):
            buffer.fill(0)
        for number in numbers:
            # Draw the view, sort its pixels by face, and process the pixels of each face in one work-item.
            planes, view, pixels = self._draw_view(number)
            faces, places = self._sort_pixels(planes, pixels)
            camera = self.images.cameras[number]
            drawn = planes["image"], planes["depth"], planes["face_id"]
            size = np.int32(camera.width), np.int32(camera.height)
            lists = self._triangles.sources["positions"], view, faces, places
            settings = (
                np.float32(self.images.weights[number]),
                np.int32(gradients),
                np.uint32(count),
                np.uint32(pixels),
            )
            target = self._load_target(number)
            self._kernels.sums(pixels, _GROUP, *lists, target, *drawn, *size, *outputs, most, *settings)
        return FaceSums(outputs[0].read(), most.read(), outputs[1].read())

    def _sort_pixels(self, planes: dict[str, Buffer], pixels: int) -> tuple[Buffer, Buffer]:
        """Queue a stable sort of the pixels by their face. Return the sorted faces and the sorted pixels."""
        keys = self._scratch("owners", pixels, np.uint32)
        counts = np.uint32(self._count), np.uint32(pixels)
        self._kernels.owners(pixels, _GROUP, planes["face_id"], keys, *counts)
        return sort_pairs(self._device, keys, bits=self._count.bit_length(), name="bake owners")

    @in_turn
    def remember(self, numbers: Sequence[int]) -> None:
        """Draw these views and store the face and the squared error of each pixel for `measure_changes`."""
        self._numbers = numbers
        pixels = [self._count_pixels(number) for number in numbers]
        self._starts = np.concatenate([[0], np.cumsum(pixels)])
        total = int(self._starts[-1])
        self._old = self._scratch("old faces", total, np.int32), self._scratch("old errors", total)
        for place, number in enumerate(numbers):
            planes, _, count = self._draw_view(number)
            drawn = planes["image"], planes["face_id"], self._load_target(number)
            start = np.uint32(self._starts[place])
            self._kernels.remember(count, _GROUP, *drawn, *self._old, start, np.uint32(count))

    @in_turn
    def measure_changes(self, owner: NDArray[np.int32], proposals: int) -> Floats:
        """Return the increase of the squared error that each proposal causes in each stored view.

        `owner` (F,) is the index of each face's proposal, or -1. A change of a pixel is assigned to two
        proposals: the proposal of its face before the change, and the proposal of its face after the change.
        If the two proposals differ, half of the change is assigned to each proposal. The result (views,
        proposals) is a sum of squared colour differences in [0, 1] over channels and pixels.
        """
        views = len(self._numbers)
        owners = self._scratch("owner", self._count, np.int32)
        owners.write(owner)
        totals = self._scratch("totals", (views, proposals), self._total_type)
        totals.fill(0)
        # Add up integers, so that the order of additions has no influence. The unit of these integers is as
        # small as possible without an overflow.
        bits = 62 if self._total_type is np.int64 else 30
        largest = 6.0 * float(np.diff(self._starts).max())
        unit = np.float32(2.0 ** min(32, bits - int(np.ceil(np.log2(largest)))))
        for place, number in enumerate(self._numbers):
            planes, _, count = self._draw_view(number)
            drawn = planes["image"], planes["face_id"], self._load_target(number)
            start, row = np.uint32(self._starts[place]), np.uint32(place * proposals)
            places = start, row, np.uint32(count)
            self._kernels.judge(count, _GROUP, *drawn, *self._old, owners, totals, unit, *places)
        return totals.read() / np.float64(unit)

    @in_turn
    def measure_error(self) -> float:
        """Return the mean squared error over all views. Pixels are first averaged over blocks (`_BLOCK`)."""
        total, count = 0.0, 0
        for number, camera in enumerate(self.images.cameras):
            planes, _, _ = self._draw_view(number)
            change = planes["image"].read() - self.images.image(number)
            side = min(_BLOCK, camera.height, camera.width)
            blocks = box_mean(change[: camera.height // side * side, : camera.width // side * side], side)
            total += float(np.square(blocks, dtype=np.float64).sum())
            count += blocks.size
        return total / count

    def pixels_per_face(self, faces: int) -> float:
        """Return the average number of pixels of a view per face, for this number of `faces`."""
        return self.pixels / max(1, len(self.images)) / max(1, faces)
