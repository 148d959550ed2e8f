"""A soup that changes between drawings, on the standard tier, and what is summed there of its pictures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.bake.arrays import Floats, Mask, Singles
from msb.bake.lessons import Lessons
from msb.cl import Buffer, Device, sort_pairs
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.render.device_scope import in_turn
from msb.render.standard.renderer import StandardRenderer, view_record
from msb.render.standard.supersampling import box_mean
from msb.render.standard.triangles import RECORD_DEFINES

# Sums per face: six products of weights (aa, ab, ac, bb, bc, cc), then red, green, blue times a, b and c.
SUMS = 15
_GROUP = 64
_BLOCK = 2  # pixels along each side of the blocks that `Raster.error` compares
# Bytes of training images that stay on the device; beyond that each is sent when it is needed.
_KEPT = 1 << 28


class Seen(NamedTuple):
    """What drawings say of each face, summed over them."""

    # (F, 15), `SUMS`.
    sums: Singles
    # (F,) the most pixels that one view shows of it.
    most: NDArray[np.uint32]
    # (F, 3, 3) how the squared error rises as a corner moves, per unit of the scene.
    slopes: Singles


class Pupil(StandardRenderer):
    """Draws an asset as the lessons' cameras see it, beside what they should see."""

    def __init__(self, asset: Asset, lessons: Lessons, device: str | Device | None = None) -> None:
        super().__init__(asset, device=device)
        self._learn(lessons)

    def _learn(self, lessons: Lessons) -> None:
        self.lessons = lessons
        self.pixels = sum(camera.width * camera.height for camera in lessons.cameras)
        self._keeps = 6 * self.pixels <= _KEPT
        self._targets: dict[int, Buffer] = {}
        self._views: dict[int, Buffer] = {}

    def _pixels(self, number: int) -> int:
        camera = self.lessons.cameras[number]
        return camera.width * camera.height

    def _drawn(self, number: int) -> tuple[dict[str, Buffer], Buffer, int]:
        """Queue a drawing; return its planes, the camera's record, and the number of pixels."""
        camera = self.lessons.cameras[number].in_units()
        if number not in self._views:
            self._views[number] = self._device.upload(view_record(camera), "bake views")
        view = self._views[number]
        planes = self._run(camera, self.lessons.background, everything=True, view=view)
        return planes, view, self._pixels(number)

    def _target(self, number: int) -> Buffer:
        if number in self._targets:
            return self._targets[number]
        image = self.lessons.stored(number)
        if self._keeps:
            buffer = self._device.allocate(image.shape, image.dtype, "bake lessons")
            self._targets[number] = buffer
        else:
            buffer = self._scratch("lesson", image.shape, image.dtype)
        buffer.write(image)
        return buffer


class Raster(Pupil):
    """Draws a soup as the lessons' cameras see it, and compares it with their pictures.

    Parameters
    ----------
    corners : (F, 3, 3) float32
    colors : (F, 3, 3) float32
        RGB of each corner.
    lessons : Lessons
    device : str or Device, optional
    """

    moves = True

    def __init__(
        self,
        corners: Singles,
        colors: Singles,
        lessons: Lessons,
        device: str | Device | None = None,
    ) -> None:
        count = len(corners)
        soup = Mesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), colors.reshape(-1, 3))
        super().__init__(asset_from_mesh(soup), lessons, device)
        self._count = count
        wide = self._device.record.int64_atomics
        self._total = np.int64 if wide else np.int32
        self._own = self._device.program("bake", {**RECORD_DEFINES, "WIDE": wide})

    def beside(self, lessons: Lessons) -> Raster:
        """Return one of other lessons that draws the same faces: what is put on one is on both, and they are
        closed together."""
        other = copy(self)
        other._learn(lessons)
        return other

    @in_turn
    def change(self, corners: Singles, colors: Singles, keep: Mask) -> None:
        """Give the faces these corners and colours; those that are not kept have no area, and so no pixel."""
        placed = np.where(keep[:, None, None], corners, corners[:, :1])
        self._triangles.sources["positions"].write(np.ascontiguousarray(placed.reshape(-1, 3), np.float32))
        self._triangles.sources["colors"].write(np.ascontiguousarray(colors.reshape(-1, 3), np.float32))
        self._triangles.fill()

    @in_turn
    def seen(self, numbers: Iterable[int], *, slopes: bool = True) -> Seen:
        """Return what the drawings of these views, held against the lessons' pictures, say of each face;
        without `slopes` those are 0.

        The sums of a face are taken along its pixels in their order, and view by view: the same bits each
        time."""
        count = self._count
        found = [
            self._scratch(f"sum of {name}", shape)
            for name, shape in (("products", (count, SUMS)), ("slopes", (count, 3, 3)))
        ]
        most = self._scratch("most", count, np.uint32)
        for buffer in (*found, most):
            buffer.fill(0)
        for number in numbers:
            planes, view, pixels = self._drawn(number)
            faces, places = self._sorted(planes, pixels)
            camera = self.lessons.cameras[number]
            drawn = planes["image"], planes["depth"], planes["face_id"]
            size = np.int32(camera.width), np.int32(camera.height)
            lists = self._triangles.sources["positions"], view, faces, places
            how = (
                np.float32(self.lessons.weights[number]),
                np.int32(slopes),
                np.uint32(count),
                np.uint32(pixels),
            )
            self._own.sums(pixels, _GROUP, *lists, self._target(number), *drawn, *size, *found, most, *how)
        return Seen(found[0].read(), most.read(), found[1].read())

    def _sorted(self, planes: dict[str, Buffer], pixels: int) -> tuple[Buffer, Buffer]:
        """Queue the faces that pixels show, sorted, and the pixels of each in their order."""
        keys = self._scratch("owners", pixels, np.uint32)
        self._own.owners(pixels, _GROUP, planes["face_id"], keys, np.uint32(self._count), np.uint32(pixels))
        return sort_pairs(self._device, keys, bits=self._count.bit_length(), name="bake owners")

    @in_turn
    def remember(self, numbers: Sequence[int]) -> None:
        """Draw these views and keep which face each pixel shows, and its error, for `judge`."""
        self._numbers = numbers
        pixels = [self._pixels(number) for number in numbers]
        self._starts = np.concatenate([[0], np.cumsum(pixels)])
        total = int(self._starts[-1])
        self._old = self._scratch("old faces", total, np.int32), self._scratch("old errors", total)
        for place, number in enumerate(numbers):
            planes, _, count = self._drawn(number)
            start = np.uint32(self._starts[place])
            target = self._target(number)
            self._own.remember(
                count, _GROUP, planes["image"], planes["face_id"], target, *self._old, start, np.uint32(count)
            )

    @in_turn
    def judge(self, owner: NDArray[np.int32], proposals: int) -> Floats:
        """Return by how much the squared error of each remembered view rises by each proposal.

        `owner` (F,) is the proposal that a face belongs to, or -1. A pixel counts for the proposal whose face
        it shows or showed; where these are two, each gets a half. Returns (views, proposals), in squares of
        colours from 0 to 1, summed over channels and pixels.
        """
        views = len(self._numbers)
        mine = self._scratch("owner", self._count, np.int32)
        mine.write(owner)
        totals = self._scratch("totals", (views, proposals), self._total)
        totals.fill(0)
        # Integers, since their sums do not depend on the order; so fine that the largest sum just fits.
        bits = 62 if self._total is np.int64 else 30
        largest = 6.0 * float(np.diff(self._starts).max())
        unit = np.float32(2.0 ** min(32, bits - int(np.ceil(np.log2(largest)))))
        for place, number in enumerate(self._numbers):
            planes, _, count = self._drawn(number)
            start, row = np.uint32(self._starts[place]), np.uint32(place * proposals)
            target = self._target(number)
            self._own.judge(
                count,
                _GROUP,
                planes["image"],
                planes["face_id"],
                target,
                *self._old,
                mine,
                totals,
                unit,
                start,
                row,
                np.uint32(count),
            )
        return totals.read() / np.float64(unit)

    @in_turn
    def error(self) -> float:
        """Return the mean squared error over all views, pixels and channels, of means of four pixels.

        Of single pixels most of it is at edges, where it says how edges happen to lie between samples.
        """
        total, count = 0.0, 0
        for number, camera in enumerate(self.lessons.cameras):
            planes, _, _ = self._drawn(number)
            off = planes["image"].read() - self.lessons.image(number)
            side = min(_BLOCK, camera.height, camera.width)
            blocks = box_mean(off[: camera.height // side * side, : camera.width // side * side], side)
            total += float(np.square(blocks, dtype=np.float64).sum())
            count += blocks.size
        return total / count

    def pixels_a_face(self, faces: int) -> float:
        """Return how many pixels of a view there are for each of so many faces."""
        return self.pixels / max(1, len(self.lessons)) / max(1, faces)
