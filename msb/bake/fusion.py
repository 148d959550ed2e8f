"""What is solid of a soup: its depths, as cameras see them, vote on the cells of a grid (Curless and Levoy
1996), on the device."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from msb.bake.arrays import Floats, Mask, Singles
from msb.bake.space import EDGE
from msb.meshes.assets import asset_from_mesh
from msb.render.device_scope import in_turn
from msb.render.standard.renderer import StandardRenderer

if TYPE_CHECKING:
    from msb.bake.space import Space
    from msb.cl import Device
    from msb.meshes.mesh import Mesh
    from msb.scenes import Camera


# Cells in front of and behind a surface in which a view votes. Fewer behind, where views of the other
# side of a sheet vote the opposite.
REACH, BEHIND = 3.0, 1.5
# Cells by which the surface lies outside, so that sheets and stems become solids that cells resolve.
THICK = 1.0
# Minimum ratio of seeing to occluded views of a cell; below it, what they see is a hole in the soup.
DOUBT = 0.05
_DRAWS = 5  # steps that draw the surface in
_GROUP = 64
# The number of views that vote at a time, and of floats in the record of each.
_AT_ONCE, _RECORD = 8, 19
# The value of a cell that no view votes on.
UNKNOWN = 2.0
# Of so many pixels that show something one is a point of what is seen.
_EVERY = 7
_BLACK = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells in a space: the place of the lowest one's centre (3,), the size of a cell, and how many there
    are."""

    low: Floats
    cell: float
    shape: tuple[int, int, int]

    @classmethod
    def over(cls, space: Space, cells: int, margin: float = REACH) -> Grid:
        """Return a grid of so many cells along the longest side of what is seen, and a margin about an
        object."""
        size = space.high - space.low
        cell = float(size.max() / cells)
        rim = 0.0 if space.contracted else margin * cell
        nx, ny, nz = (int(n) + 1 for n in np.ceil((size + 2 * rim) / cell))
        return cls(space.low - rim, cell, (nx, ny, nz))


class Depths(StandardRenderer):
    """Draws a soup for its depths."""

    def __init__(self, soup: Mesh, device: str | Device | None = None) -> None:
        super().__init__(asset_from_mesh(soup), device=device)
        self._fuse = self._device.program("bake_fuse", {"RECORD": _RECORD, "UNKNOWN": UNKNOWN})

    def points(self, cameras: Sequence[Camera]) -> Floats:
        """Return places (n, 3) of the world that cameras see."""
        found = [np.zeros((0, 3))]
        for camera in cameras:
            depth = self.render(camera.in_units(), _BLACK).depth * camera.unit
            row, column = (each[::_EVERY] for each in np.nonzero(depth))
            z = depth[row, column].astype(np.float64)
            x, y = (column + 0.5 - camera.cx) / camera.fx * z, (row + 0.5 - camera.cy) / camera.fy * z
            local = np.stack([x, y, z, np.ones_like(z)], axis=1)
            found.append((local @ camera.camera_to_world.T)[:, :3])
        return np.concatenate(found)

    @in_turn
    def votes(self, cameras: Sequence[Camera], space: Space, grid: Grid) -> Singles:
        """Return how far each cell of `grid` lies before what cameras see, in `REACH` cells and at most 1.

        It is negative where the cell is solid, and `UNKNOWN` where no view has it in its picture or it lies
        beyond a scene."""
        count = int(np.prod(grid.shape))
        sums, votes = self._scratch("cells", grid.shape), self._scratch("votes", (2, *grid.shape), np.uint16)
        sums.fill(0)
        votes.fill(0)
        cells = self._scratch("grid", 4)
        cells.write(np.array([*grid.low, grid.cell], np.float32))
        stride = max(camera.width * camera.height for camera in cameras)
        depths = self._scratch("depths", (_AT_ONCE, stride))
        records = self._scratch("cameras", (_AT_ONCE, _RECORD))
        for first in range(0, len(cameras), _AT_ONCE):
            some = cameras[first : first + _AT_ONCE]
            for number, camera in enumerate(some):
                planes = self._run(camera.in_units(), _BLACK, everything=True)
                depths.copy(planes["depth"], start=number * stride)
            records.write(np.stack([_record(camera, space) for camera in some]))
            self._fuse.vote(
                count,
                _GROUP,
                records,
                np.int32(len(some)),
                cells,
                depths,
                np.int32(stride),
                *(np.int32(n) for n in grid.shape),
                np.float32(EDGE + REACH * grid.cell),
                np.float32(REACH * grid.cell),
                np.float32(BEHIND * grid.cell),
                np.int32(space.contracted),
                sums,
                votes,
            )
        self._fuse.count_votes(
            count,
            _GROUP,
            sums,
            votes,
            np.float32(DOUBT),
            np.float32(THICK / REACH),
            np.uint32(count),
        )
        values: Singles = sums.read()
        return values


def seen_points(mesh: Mesh, cameras: Sequence[Camera], device: str | Device | None) -> Floats:
    """Return places (n, 3) of the world at which cameras, if there are any, see a mesh."""
    if not cameras:
        return np.zeros((0, 3))
    with closing(Depths(mesh, device)) as depths:
        return depths.points(cameras)


def solid(votes: Singles, space: Space, grid: Grid) -> Singles:
    """Return votes with what is unknown continued from its surroundings, in their place.

    What lies beyond a scene is solid: a shell around it, on which a sky appears."""
    _fill(votes, votes != UNKNOWN)
    if space.contracted:
        np.minimum(votes, _beyond(grid), out=votes)
    return votes


def drawn_in(points: Floats, values: Singles, grid: Grid) -> Floats:
    """Return points (V, 3) on the surface of what is solid half as far out as `THICK` puts them, where solid
    is thick; the two sides of a sheet, which would meet, stay.

    Half as far, since views from the side, which find all of a cell free, draw the mean inward."""
    from scipy.ndimage import map_coordinates

    def at(places: Floats) -> Floats:
        found: Floats = map_coordinates(values, places.T, np.float64, order=1, mode="nearest")
        return found

    places = (points - grid.low) / grid.cell
    inward = np.stack([at(places - step) - at(places + step) for step in np.eye(3)], axis=1)
    inward /= np.maximum(np.linalg.norm(inward, axis=1, keepdims=True), 1e-12)
    depth = THICK / REACH
    thick = at(places + (THICK + BEHIND) * inward) < -1.5 * depth
    move = THICK / _DRAWS * thick[:, None] * inward
    for _ in range(_DRAWS):
        here, there = at(places), at(places + move)
        share = np.clip((here + depth / 2) / np.maximum(here - there, 1e-12), 0, 1)
        places = places + share[:, None] * move
    return grid.low + grid.cell * places


def _fill(values: Singles, known: Mask) -> None:
    """Give cells (nx, ny, nz) that are not known values from those around them.

    Each is the mean of the smallest block of 2, 4, 8, ... cells a side that has known ones, and smoothed."""
    from scipy.ndimage import uniform_filter

    if known.all():
        return
    if not known.any():
        values[:] = 1
        return
    shape = tuple(-(-n // 2) for n in values.shape)
    sums, count = np.zeros((2, *shape), np.float32)
    for place in np.ndindex(2, 2, 2):
        part = tuple(slice(start, None, 2) for start in place)
        there = tuple(slice(n) for n in known[part].shape)
        sums[there] += np.where(known[part], values[part], 0)
        count[there] += known[part]
    sums /= np.maximum(count, 1)
    _fill(sums, count > 0)
    for axis in range(3):
        sums = sums.repeat(2, axis=axis)
    nx, ny, nz = values.shape
    np.copyto(values, uniform_filter(sums[:nx, :ny, :nz], 3, mode="nearest"), where=~known)


def _beyond(grid: Grid) -> Singles:
    """Return how far cells lie before the shell around a scene, in `REACH` cells; that is half as thick."""
    axes = [grid.low[k] + grid.cell * np.arange(grid.shape[k]) for k in range(3)]
    x, y, z = np.meshgrid(*(np.square(axis).astype(np.float32) for axis in axes), indexing="ij", sparse=True)
    reach = REACH * grid.cell
    found: Singles = (np.float32(EDGE - reach / 2) - np.sqrt(x + y + z)) / np.float32(reach)
    return found


def _record(camera: Camera, space: Space) -> Singles:
    """Return what the kernel needs of a camera, (_RECORD,), for places in the units of `space`."""
    pose = camera.world_to_camera[:3].copy()
    pose[:, 3] = (pose[:, :3] @ space.center + pose[:, 3]) / space.radius
    image = camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height
    return np.array([*pose.reshape(-1), *image, camera.unit / space.radius], np.float32)
