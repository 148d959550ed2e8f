"""Depth maps vote on which cells of a grid are solid (Curless and Levoy 1996). The votes are computed on the
device."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from msb.bake.arrays import Floats, Mask, Singles
from msb.bake.space import EDGE
from msb.base.origin import NO_ORIGIN
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.render import Renderer
from msb.render.device_scope import in_turn
from msb.render.standard.renderer import StandardRenderer

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.bake.space import Space
    from msb.cl import Buffer, Device
    from msb.scenes import Camera

# Distances in cells. A cell has the largest vote, 1, if its distance in front of a surface is at least
# `REACH`. A view does not vote on cells that are farther than `BEHIND` behind the visible surface. `BEHIND`
# is smaller than `REACH`, because two views from opposite sides of a thin sheet give opposite votes. If both
# distances were equal, the two votes would cancel, and thin leaves would vanish from the solid.
REACH, BEHIND = 3.0, 1.5
# The surface is moved outwards by this number of cells, so that thin sheets and stems become solids that the
# grid can resolve. `pull_in` moves the surface back where the solid is thick.
THICKNESS = 1.0
# Number of views that see a cell, divided by the number of views that do not see the cell. A cell with a
# smaller ratio counts as solid. The few views that see the cell probably look through a hole in the soup.
MIN_SEEN_RATIO = 0.05
# Number of steps of `pull_in`. Each step interpolates the grid once.
_PULL_STEPS = 5
# Work-items of a work-group.
_GROUP = 64
# The first number is the number of views per run of the kernel. The second number is the number of floats per
# view in the kernel's input.
_VIEWS_PER_RUN, _RECORD = 8, 19
# Value of a cell without any vote.
UNKNOWN = 2.0
# Every 7th covered pixel gives one visible point. The step 7 has no common factor with usual image widths.
# Therefore the points do not line up in columns.
_PIXELS_PER_POINT = 7
_BLACK = (0.0, 0.0, 0.0)
# A pixel has a depth if Gaussians cover at least this share of the pixel.
MIN_ALPHA = 0.5


@dataclass(frozen=True, eq=False)
class Grid:
    """A regular grid of cells in a box, in the coordinates of a space.

    Attributes
    ----------
    low : (3,) float64
        The centre of the lowest cell.
    cell : float
        The size of a cell.
    shape : (int, int, int)
        The number of cells along each axis.
    """

    low: Floats
    cell: float
    shape: tuple[int, int, int]

    @classmethod
    def covering(cls, space: Space, cells: int, margin: float = REACH) -> Grid:
        """Return a grid with `cells` cells along the longest side.

        Around an object, the grid has `margin` more cells on each side.
        """
        size = space.high - space.low
        cell = float(size.max() / cells)
        rim = 0.0 if space.contracted else margin * cell
        nx, ny, nz = (int(n) + 1 for n in np.ceil((size + 2 * rim) / cell))
        return cls(space.low - rim, cell, (nx, ny, nz))


class DepthRenderer(StandardRenderer):
    """Draws depth maps of a mesh and lets the depth maps vote on grid cells."""

    def __init__(self, mesh: Mesh, device: str | Device | None = None) -> None:
        super().__init__(asset_from_mesh(mesh, origin=NO_ORIGIN), device=device)
        self._fuse = self._device.program("bake_fuse", {"RECORD": _RECORD, "UNKNOWN": UNKNOWN})

    def read_depth(self, camera: Camera) -> Singles:
        """Return the depth map (H, W) of a camera, in units of `camera.unit`.

        Empty pixels have the depth 0.
        """
        return self.render(camera.in_units(), _BLACK).depth

    def draw_depth(self, camera: Camera) -> Buffer:
        """Queue the rendering of a depth map. Return its buffer."""
        return self._run(camera.in_units(), _BLACK, everything=True)["depth"]

    def sample_visible_points(self, cameras: Sequence[Camera]) -> Floats:
        """Return world points (n, 3) that the cameras see, one per `_PIXELS_PER_POINT` covered pixels."""
        points = [np.zeros((0, 3))]
        for camera in cameras:
            depth = self.read_depth(camera) * camera.unit
            row, column = (index[::_PIXELS_PER_POINT] for index in np.nonzero(depth))
            # Convert pixel centres and depths to camera coordinates (n, 4), then to world coordinates.
            z = depth[row, column].astype(np.float64)
            x, y = (column + 0.5 - camera.cx) / camera.fx * z, (row + 0.5 - camera.cy) / camera.fy * z
            local = np.stack([x, y, z, np.ones_like(z)], axis=1)
            points.append((local @ camera.camera_to_world.T)[:, :3])
        return np.concatenate(points)

    @in_turn
    def vote(self, cameras: Sequence[Camera], space: Space, grid: Grid) -> Singles:
        """Return the votes (nx, ny, nz) of the cells.

        A vote is the average distance by which a cell is in front of the visible surface. Votes are in units
        of `REACH` cells, and at most 1. A vote is negative if the cell is solid. A cell has the vote
        `UNKNOWN` if no view contains the cell or if the cell is beyond the edge of a scene.
        """
        count = int(np.prod(grid.shape))
        sums, votes = self._scratch("cells", grid.shape), self._scratch("votes", (2, *grid.shape), np.uint16)
        sums.fill(0)
        votes.fill(0)
        cells = self._scratch("grid", 4)
        cells.write(np.array([*grid.low, grid.cell], np.float32))
        stride = max(camera.width * camera.height for camera in cameras)
        depths = self._scratch("depths", (_VIEWS_PER_RUN, stride))
        records = self._scratch("cameras", (_VIEWS_PER_RUN, _RECORD))
        # Render the depth maps of some views, then add their votes to all cells.
        for first in range(0, len(cameras), _VIEWS_PER_RUN):
            batch = cameras[first : first + _VIEWS_PER_RUN]
            for number, camera in enumerate(batch):
                depths.copy(self.draw_depth(camera), start=number * stride)
            records.write(np.stack([_make_record(camera, space) for camera in batch]))
            self._fuse.vote(
                count,
                _GROUP,
                records,
                np.int32(len(batch)),
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
        # Average the votes of each cell and subtract the thickness.
        settings = np.float32(MIN_SEEN_RATIO), np.float32(THICKNESS / REACH), np.uint32(count)
        self._fuse.count_votes(count, _GROUP, sums, votes, *settings)
        values: Singles = sums.read()
        return values


class NativeDepthRenderer(DepthRenderer):
    """Lets the depth maps of Gaussians, instead of a mesh, vote on grid cells.

    Along the ray of a pixel, the transmittance falls below one half at one of the Gaussians. The depth of
    this Gaussian is the depth of the pixel. The depth of a Gaussian is measured at its highest density along
    the ray. Pixels that the Gaussians cover by less than half are empty.
    """

    def __init__(self, model: Asset, device: str | Device | None = None) -> None:
        super().__init__(Mesh(np.eye(3, dtype=np.float32), np.array([[0, 1, 2]])), device)
        self._native = Renderer(model, "dedicated", self._device, outputs=("depth_median",))

    def read_depth(self, camera: Camera) -> Singles:
        frame = self._native.render(camera.in_units(), _BLACK)
        assert frame.depth_median is not None
        return np.where(frame.alpha >= MIN_ALPHA, frame.depth_median, 0).astype(np.float32)

    def draw_depth(self, camera: Camera) -> Buffer:
        buffer = self._scratch("native depth", (camera.height, camera.width))
        buffer.write(self.read_depth(camera))
        return buffer

    def close(self) -> None:
        self._native.close()
        super().close()


def find_visible_points(mesh: Mesh, cameras: Sequence[Camera], device: str | Device | None) -> Floats:
    """Return world points (n, 3) of a mesh that the cameras see. The result is empty without cameras."""
    if not cameras:
        return np.zeros((0, 3))
    with closing(DepthRenderer(mesh, device)) as renderer:
        return renderer.sample_visible_points(cameras)


def complete_votes(votes: Singles, space: Space, grid: Grid) -> Singles:
    """Fill unknown cells in place from the cells around them, and return the votes.

    The space beyond the edge of a scene becomes solid. The solid shell around the scene shows the sky.
    """
    _fill_unknown(votes, votes != UNKNOWN)
    if space.contracted:
        np.minimum(votes, _make_shell_votes(grid), out=votes)
    return votes


def pull_in(points: Floats, values: Singles, grid: Grid) -> Floats:
    """Return surface points (V, 3) moved inwards by half of `THICKNESS` where the solid is thick.

    The sides of a thin sheet are not moved, because the two sides would meet. Views from the side already
    move the surface inwards, so half of `THICKNESS` is enough.
    """
    from scipy.ndimage import map_coordinates

    def interpolate(places: Floats) -> Floats:
        result: Floats = map_coordinates(values, places.T, np.float64, order=1, mode="nearest")
        return result

    # Inward directions (V, 3) from central differences of the votes, in units of cells.
    places = (points - grid.low) / grid.cell
    inward = np.stack([interpolate(places - step) - interpolate(places + step) for step in np.eye(3)], axis=1)
    inward /= np.maximum(np.linalg.norm(inward, axis=1, keepdims=True), 1e-12)
    # The solid is thick if the vote drops further a few cells inside the surface.
    depth = THICKNESS / REACH
    is_thick = interpolate(places + (THICKNESS + BEHIND) * inward) < -1.5 * depth
    move = THICKNESS / _PULL_STEPS * is_thick[:, None] * inward
    # Move the points in small steps along `move` until the interpolated vote is -depth / 2.
    for _ in range(_PULL_STEPS):
        here, there = interpolate(places), interpolate(places + move)
        share = np.clip((here + depth / 2) / np.maximum(here - there, 1e-12), 0, 1)
        places = places + share[:, None] * move
    return grid.low + grid.cell * places


def _fill_unknown(values: Singles, known: Mask) -> None:
    """Fill the unknown cells of votes (nx, ny, nz) in place.

    Each unknown cell lies in blocks with sides of 2, 4, 8, ... cells. Use the smallest block with known
    cells, and copy its smoothed average to the unknown cell.
    """
    from scipy.ndimage import uniform_filter

    if known.all():
        return
    if not known.any():
        values[:] = 1
        return
    # Averages of the known cells in blocks of 2 x 2 x 2 cells.
    shape = tuple(-(-n // 2) for n in values.shape)
    sums, count = np.zeros((2, *shape), np.float32)
    for place in np.ndindex(2, 2, 2):
        part = tuple(slice(start, None, 2) for start in place)
        there = tuple(slice(n) for n in known[part].shape)
        sums[there] += np.where(known[part], values[part], 0)
        count[there] += known[part]
    sums /= np.maximum(count, 1)
    # Fill the blocks recursively. Copy the block averages, smoothed over 3 cells, to the unknown cells.
    _fill_unknown(sums, count > 0)
    for axis in range(3):
        sums = sums.repeat(2, axis=axis)
    nx, ny, nz = values.shape
    np.copyto(values, uniform_filter(sums[:nx, :ny, :nz], 3, mode="nearest"), where=~known)


def _make_shell_votes(grid: Grid) -> Singles:
    """Return votes (nx, ny, nz) for the solid shell around a scene.

    The shell begins `REACH` / 2 cells inside the radius `EDGE`.
    """
    axes = [grid.low[k] + grid.cell * np.arange(grid.shape[k]) for k in range(3)]
    x, y, z = np.meshgrid(*(np.square(axis).astype(np.float32) for axis in axes), indexing="ij", sparse=True)
    reach = REACH * grid.cell
    votes: Singles = (np.float32(EDGE - reach / 2) - np.sqrt(x + y + z)) / np.float32(reach)
    return votes


def _make_record(camera: Camera, space: Space) -> Singles:
    """Return the values (_RECORD,) of a camera for the kernel. The unit of length is `space.radius`."""
    pose = camera.world_to_camera[:3].copy()
    pose[:, 3] = (pose[:, :3] @ space.center + pose[:, 3]) / space.radius
    image = camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height
    return np.array([*pose.reshape(-1), *image, camera.unit / space.radius], np.float32)
