"""The standard tier: an opaque, unlit mesh with a z-buffer, in OpenCL on a CPU or GPU."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.drawable import check_drawable
from msb.asset.settings import effective_settings
from msb.base.version import __version__
from msb.cl import Buffer, Device
from msb.render.backend import DrawTime
from msb.render.device_scope import DeviceScope, OnDevice, in_turn
from msb.render.frame import Frame
from msb.render.standard.supersampling import box_filter, box_mean, check_supersample, enlarge
from msb.render.standard.triangles import BLOCK, CLUSTER, GROUP, SUBPIXEL_BITS, make_triangles
from msb.scenes import Camera

# Steps per pixel of the grid to which corners are snapped.
_UNITS = 1 << SUBPIXEL_BITS
# Widths and heights of tiles in pixels, largest first. zbuffer_cpu.cl stores coarse depths for at most 256 x
# 128 pixels.
_TILES = ((256, 128), (256, 64), (128, 64), (64, 32))
# Minimum number of tiles per processor, to balance the load.
_TILES_PER_PROCESSOR = 8
# Columns and rows of padding around a tile, and the capacity of its list of clusters.
_PAD, _PAD_ROWS, _LIST = 8, 4, 8192
# Number of coarse depths of a tile.
_COARSE = 64
_GROUP_SIZE = 64
# Floats of a camera record in zbuffer_math.cl.
VIEW_WORDS = 51
# Work-groups draw the triangles that are too large for one work-item. The numbers are the minimum number of
# work-groups, the work-groups per compute unit, and the work-groups that share a huge triangle.
_GROUPS, _GROUPS_A_UNIT, _ROWS = 256, 32, 16


class StandardRenderer(OnDevice):
    """Renders any asset with static colours as an opaque mesh; docs/standard.md has the rules.

    Each pixel has one sample at its centre. Faces are two-sided. Faces are clipped at a near plane of 0.01
    scene units, and there is no far plane. Colours are interpolated with perspective correction. If two faces
    share an edge, exactly one of them covers each sample. At equal depths the face with the lowest number is
    visible.

    Among the asset's settings, only `ste_threshold`, which hides faces, has an effect. With `supersample`
    from 2 to 16, each pixel is the mean of `supersample` x `supersample` samples.
    """

    name = "msb-standard"
    version = __version__
    # Whether positions and colours of the triangles may be changed between frames.
    moves = False

    def __init__(
        self,
        asset: Asset,
        *,
        device: str | Device | None = None,
        settings: Mapping[str, Any] | None = None,
        supersample: int = 1,
    ) -> None:
        self._supersample = check_supersample(supersample)
        values = effective_settings(asset.manifest, settings)
        check_drawable(asset, ("positions", "color", "f_dc"))
        self._scope = DeviceScope(device, "standard")
        self._device, self._scratch = self._scope.device, self._scope.scratch
        with self._scope.setting_up():
            self._triangles = make_triangles(self._device, asset, values, moving=self.moves)
            self._scope.kept |= self._triangles.buffers
            defines: dict[str, Any] = dict(self._triangles.defines)
            if self._device.style == "cpu":
                blocks = CLUSTER // BLOCK
                defines |= {
                    "CLUSTER": blocks,
                    "GROUP": GROUP,
                    "LIST": _LIST,
                    "PAD": _PAD,
                    "PAD_ROWS": _PAD_ROWS,
                }
            else:
                defines["KEYS"] = self._device.record.int64_atomics
            self._program = self._device.program(f"zbuffer_{self._device.style}", defines)

    @in_turn
    def render(
        self, camera: Camera, background: tuple[float, float, float], out: Frame | None = None
    ) -> Frame:
        """Draw the asset from `camera` over `background` (RGB in the asset's colour space).

        With supersampling, image and alpha are means over the samples of a pixel. Depth and face belong to
        the nearest sample. Without supersampling, `out` may be a frame of this size that is no longer needed.
        The function overwrites the arrays of `out`. Passing `out` saves time, because the first access to new
        memory takes longer than the copy.
        """
        reused = {} if out is None or self._supersample > 1 else vars(out)
        with self._device.timing() as timing:
            planes = self._run(camera, background, everything=True)
            with self._device.stage("read"):
                arrays: dict[str, Any] = {name: it.read(reused.get(name)) for name, it in planes.items()}
        frame = Frame(**arrays)
        if self._supersample > 1:
            frame = box_filter(frame, self._supersample)
        return replace(frame, timings=timing.milliseconds())

    @in_turn
    def render_image(
        self,
        camera: Camera,
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        out: NDArray[np.float32] | None = None,
    ) -> NDArray[np.float32]:
        """Return only the image (H, W, 3) of the frame. Without supersampling, the image is written into
        `out`, if given."""
        image = self._run(camera, background, everything=False)["image"]
        if self._supersample > 1:
            return box_mean(image.read(), self._supersample)
        return image.read(out)

    @in_turn
    def draw(self, camera: Camera, background: tuple[float, float, float]) -> DrawTime:
        """Draw a frame and wait, without reading anything back."""
        with self._device.timing() as timing:
            self._run(camera, background, everything=True)
        return DrawTime(timing.milliseconds(), timing.span(), timing.since_queued())

    def _run(
        self,
        camera: Camera,
        background: tuple[float, float, float],
        *,
        everything: bool,
        view: Buffer | None = None,
    ) -> dict[str, Buffer]:
        """Queue all commands of a frame; return a buffer for each field of `Frame`.

        Pass the camera record as `view` if it is already on the device, to avoid a wait for queued commands.
        If `everything` is false, only the image is computed.
        """
        scale = self._supersample
        width, height = camera.width * scale, camera.height * scale
        if view is None:
            record = view_record(enlarge(camera, scale))
            view = self._scratch("view", record.shape)
            view.write(record)
        size = (height, width) if everything else (1, 1)
        planes = {
            "image": self._scratch("image", (height, width, 3), group="targets"),
            "depth": self._scratch("depth", size, group="targets"),
            "alpha": self._scratch("alpha", size, group="targets"),
            "face_id": self._scratch("face ids", size, np.int32, group="targets"),
        }
        output = *planes.values(), np.int32(everything), np.array((*background, 1), np.float32)
        run = self._run_cpu if self._device.style == "cpu" else self._run_gpu
        run(view, np.int32(width), np.int32(height), output)
        return planes

    def _run_cpu(self, view: Buffer, width: np.int32, height: np.int32, output: tuple[Any, ...]) -> None:
        """Queue the culling, and the drawing tile by tile."""
        mesh, device = self._triangles, self._device
        groups = max(1, -(-mesh.clusters // GROUP))
        rects = self._scratch("rectangles", (4, mesh.stride), np.int32)
        nearest = self._scratch("nearest", mesh.stride)
        group_rects = self._scratch("group rectangles", (groups, 4), np.int32)
        counter = self._scratch("next tile", 1, np.int32)
        count, stride = np.int32(mesh.clusters), np.int32(mesh.stride)
        # Compute screen rectangles and minimum depths of the clusters, and rectangles of groups of clusters.
        culled = rects, nearest, group_rects
        with device.stage("cull"):
            if mesh.clusters:
                self._program.clusters(
                    groups, 1, mesh.boxes, view, *culled, counter, count, stride, width, height
                )
            else:
                counter.fill(0)
        # Each processor takes tiles until all tiles are drawn. `scratch` holds the processor's colours,
        # depths and lists.
        processors = device.record.compute_units
        tile_width, tile_height = _tile_size(int(width), int(height), processors)
        words = 2 * (tile_width + _PAD) * (tile_height + _PAD_ROWS) + _COARSE + 2 * _LIST
        scratch = self._scratch("tiles", (processors, words))
        with device.stage("draw"):
            self._program.tiles(
                processors,
                1,
                mesh.records,
                mesh.colors,
                view,
                *culled,
                count,
                stride,
                np.int32(mesh.slots // BLOCK),
                width,
                height,
                np.int32(tile_width),
                np.int32(tile_height),
                counter,
                scratch,
                np.int32(words),
                *output,
                *mesh.textures,
            )

    def _run_gpu(self, view: Buffer, width: np.int32, height: np.int32, output: tuple[Any, ...]) -> None:
        """Queue a depth pass over all triangles and the shading of the pixels."""
        mesh, device, program = self._triangles, self._device, self._program
        count = int(width) * int(height)
        pixels = self._scratch("pixels", (count, 2), np.uint32, group="targets")
        listed = self._scratch("listed", max(1, mesh.slots), np.uint32)
        counter = self._scratch("list lengths", 2, np.int32)
        with device.stage("clear"):
            program.clear(count, _GROUP_SIZE, pixels, counter, np.uint32(count))
        # One work-item draws each small triangle. Larger triangles go to a list, which work-groups draw.
        # Without 64-bit atomics a second pass finds the face at the nearest depth.
        group, groups = (_GROUP_SIZE, 1), _GROUPS_A_UNIT * device.record.compute_units
        corners = (mesh.colors, *mesh.textures) if mesh.textures else ()
        for number in range(1 if device.record.int64_atomics else 2):
            target = mesh.records, view, pixels, listed, counter, np.uint32(mesh.slots), width, height
            with device.stage("draw"):
                program.triangles(mesh.slots, _GROUP_SIZE, *target, np.int32(number), *corners)
            with device.stage("draw large"):
                for many, rows in enumerate((1, _ROWS)):
                    size = max(_GROUPS, groups // rows) * _GROUP_SIZE, rows
                    listing = np.int32(number), np.int32(many), *corners
                    program.listed_triangles(size, group, *target, *listing)
        with device.stage("shade"):
            program.shade(
                (int(width), int(height)),
                group,
                mesh.records,
                mesh.colors,
                view,
                pixels,
                width,
                height,
                *output,
                *mesh.textures,
            )


def _tile_size(width: int, height: int, processors: int) -> tuple[int, int]:
    """Return the largest size of tiles with which each processor has several tiles, to balance the load."""
    for size in _TILES:
        if -(-width // size[0]) * -(-height // size[1]) >= _TILES_PER_PROCESSOR * processors:
            return size
    return _TILES[-1]


def view_record(camera: Camera) -> NDArray[np.float32]:
    """Return the camera record of zbuffer_math.cl, (VIEW_WORDS,) float32, computed in float64.

    The camera's centre is split into its nearest float32 and a remainder. A camera far from the origin
    therefore loses no precision. The kernels subtract the float32 part before they rotate a point. The host
    rotates the remainder, and the kernels add the rotated remainder to the point.
    """
    rotation = camera.world_to_camera[:3, :3]
    # the transpose would be inexact, because rotations are orthonormal only to 1e-4
    inverse = camera.camera_to_world[:3, :3]
    rounded = camera.center.astype(np.float32).astype(np.float64)
    rest = camera.center - rounded
    scale = np.array([camera.fx * _UNITS, camera.fy * _UNITS])
    rows = rotation * np.append(scale, 1.0)[:, None]
    # The ray of pixel (u, v) in world space is (u - cx, v - cy, 1) times this matrix.
    ray = inverse.T / np.array([camera.fx, camera.fy, 1.0])[:, None]
    principal = np.array([camera.cx, camera.cy])
    with np.errstate(over="ignore"):
        # Compute the rounding errors of the float32 values, which the kernels need in double precision.
        low, ray_low = (part - part.astype(np.float32) for part in (rows, ray))
    parts = (rows, rounded, -rows @ rest, principal * _UNITS + 0.5, scale, rest, ray, principal, low, ray_low)
    with np.errstate(over="ignore"):  # values overflow for cameras 1e39 units away, which show nothing
        return np.concatenate([part.reshape(-1) for part in parts]).astype(np.float32)
