"""The OpenCL pipeline of the splatting methods: project, sort by depth, list by tile, blend front to back.

docs/dedicated.md describes the stages and their cost. `msb.render.splat.model` describes the differences
between methods.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.drawable import check_drawable
from msb.asset.settings import check_modes, effective_settings
from msb.base.version import __version__
from msb.cl import Buffer, Device, Program
from msb.cl.kernel_text import Define
from msb.cl.programs import Kernel
from msb.registry import Order, Sampling
from msb.render.backend import SETTLED_AT, DrawTime
from msb.render.device_scope import DeviceScope, OnDevice, in_turn
from msb.render.frame import Frame, parse_outputs
from msb.render.splat.bins import LANES, SETTLED, WORK_GROUP, DepthSort, Projected, TileLists, bin_faces
from msb.render.splat.model import ENGINE_NEAR, make_model, sh_buffers
from msb.render.splat.order import FACE_GROUP, Arrays, keep_model, order_model
from msb.render.splat.view import TILE, make_view, method_members
from msb.scenes import Camera

# Number of faces that a work-item projects. On a CPU, more faces amortise the buffers of a work-item, but
# work-items must outnumber threads by far.
_CHUNK = {"cpu": 4096, "gpu": 1}
# Memory for a band of raster rows in bytes. For a CPU, the number is the size of a compute unit's cache. For
# a GPU, the number is the total memory. Only one band of samples exists at a time, because 4 x 4 samples of
# an 8K frame take 10 GB.
_BAND_BYTES = {"cpu": 2 << 20, "gpu": 256 << 20}
# Maximum number of band records that stay on the device from frame to frame.
_MOST_RECORDS = 1024
# Values of `tile_rule`; splat_common.cl explains them.
_TILE_RULES = {"TILES_REACHED": 0, "TILES_BOTH": 1, "TILES_OFFICIAL": 2}
# Constants that Python and the kernels share.
_CONSTANTS: dict[str, Define] = {
    "ENGINE_NEAR": ENGINE_NEAR,
    "FACE_GROUP": FACE_GROUP,
    "MOST_SETTLED": SETTLED,
    "TILE": TILE,
    **_TILE_RULES,
}
_PLANES = ("red", "green", "blue", "transmittance", "depth")
_EXTRA_PLANES = (*_PLANES, "nx", "ny", "nz", "depth_median", "face_id")
_SPREAD_PLANES = ("red", "green", "blue", "share")


class _Listed(NamedTuple):
    """The `View` record of a camera, the projected faces, and the lists of faces of all tiles."""

    view: Buffer
    projected: Projected
    lists: TileLists
    columns: int
    rows: int


class _Band(NamedTuple):
    """Planes of samples for a band: some rows of tiles, which contain whole rows of pixels."""

    samples: Buffer
    first_tile_row: int
    tile_rows: int
    first_row: int
    rows: int


class SplattingPipeline(OnDevice):
    """Renders an asset of a splatting method like the official renderer of the method.

    Parameters
    ----------
    outputs : "auto", "all" or iterable of str
        The optional parts of a frame: "normal", "depth_median", "face_id" (None if the method does not define
        them) and "raw". Requesting fewer parts is faster. "auto" requests all parts, but raw buffers only
        with one sample per pixel, because 4 x 4 samples take 16 times the memory.
    order : {"tile", "global", "none"}
        "tile" is the official order. "global" sorts by depth, and draws a primitive wherever it extends,
        not only in its official tiles. "none" draws in the stored order, like an engine without sorting.
    sampling : {"official", "engine"}
        "engine" generates fragments like graphics hardware; see docs/dedicated.md.
    early_stop, exact_tiles : bool
        Optimisations. `early_stop` ends the blending of a pixel that cannot change any more. `exact_tiles`
        lists a face only in the official tiles that it reaches. The options `early_stop` and `exact_tiles` do
        not change any pixel. The benchmark measures the time that these options save.
    """

    name = "msb-dedicated"
    version = __version__

    def __init__(
        self,
        asset: Asset,
        *,
        device: str | Device | None = None,
        settings: Mapping[str, Any] | None = None,
        outputs: str | Iterable[str] = "auto",
        order: Order = "tile",
        sampling: Sampling = "official",
        early_stop: bool = True,
        exact_tiles: bool = True,
    ) -> None:
        values = effective_settings(asset.manifest, settings)
        check_modes(order, sampling)
        check_drawable(asset)
        self._model = model = make_model(asset, values)
        self._outputs = parse_outputs(outputs) & {*model.outputs, "raw"}
        if outputs == "auto" and model.scale > 1:
            self._outputs -= {"raw"}
        self._count = asset.manifest.face_count
        engine = sampling == "engine"
        self.record_words = model.engine_words if engine else model.face_words
        self._culling = model.engine_culling if engine else model.culling
        rows = asset.manifest.vertex_count if model.vertex_colors else self._count
        f_dc, f_rest = sh_buffers(asset, rows)
        tile_rule = "TILES_BOTH" if exact_tiles else "TILES_OFFICIAL"
        self._fields = {
            "degree": values.get("sh_degree", asset.manifest.sh_degree),
            "rest_stride": 0 if f_rest is None else f_rest.shape[1],
            "tile_rule": _TILE_RULES[tile_rule if order == "tile" else "TILES_REACHED"],
        }
        # The official background depth is the distance of the farthest stored corner.
        self._stored_positions = asset.buffers["positions"]
        axes = model.positions.T  # reducing along the first axis takes NumPy 20 times as long
        self._extent = np.array([max(axis.max(), -axis.min()) for axis in axes], np.float32)

        soup = not model.vertex_colors  # a soup has one row of three corners per face
        self._frames = 0
        self._band_records: dict[tuple[int, ...], Buffer] = {}
        self._scope = DeviceScope(device, "splat")
        self._device, self._static = self._scope.device, self._scope.kept
        self._scratch = self._scope.scratch
        self._chunk = _CHUNK[self._device.style]
        with self._scope.setting_up():
            self._defines: dict[str, Define] = {
                **_CONSTANTS,
                **model.defines,
                **method_members(model.method_values),
                "LANES": LANES[self._device.style],
                "ENGINE": engine,
                "FACE_WORDS": self.record_words,
                "COVERAGE": model.coverage.shape[1],
            }
            # The stages before blending do not depend on the blended quantities, so their program is
            # compiled once.
            self._program = self._build_program()
            self._early_stop = early_stop
            self._blend_program = self._build_program(EXTRAS=bool(self._outputs), EARLY_STOP=early_stop)
            arrays = {
                "positions": model.positions.reshape(self._count, 9) if soup else model.positions,
                "indices": None if soup else asset.buffers["indices"],
                "coverage": model.coverage,
                "f_dc": f_dc,
                "f_rest": f_rest,
            }
            keep_model(self._scope, self._program, self._count, arrays)
            self._unordered: Arrays | None = arrays
            self._sort = DepthSort(self._device, self._program, order)

    def _build_program(self, **blending: Define) -> Program:
        """Return the method's program. `blending` replaces some definitions of an ordinary frame."""
        chosen = {**self._defines, "EXTRAS": True, "EARLY_STOP": True, **blending}
        return self._device.program(self._model.program, chosen, self._model.package)

    @in_turn
    def render(self, camera: Camera, background: tuple[float, float, float]) -> Frame:
        """Draw the asset from `camera` over `background` (RGB in the asset's colour space)."""
        self._order_faces()
        with self._device.timing() as timing:
            self._run(camera, background)
            with self._device.stage("read"):
                frame = self._read(camera, background)
        return replace(frame, timings=timing.milliseconds())

    @in_turn
    def draw(self, camera: Camera, background: tuple[float, float, float]) -> DrawTime:
        """Draw like `render` and wait until the frame is complete. Only the two counts of the tile lists
        are read back."""
        self._order_faces()
        with self._device.timing() as timing:
            self._run(camera, background)
        return DrawTime(timing.milliseconds(), timing.span(), timing.since_queued())

    def _order_faces(self, at_frame: int = SETTLED_AT) -> None:
        """Sort the faces on the device before frame number `at_frame`.

        Sorting takes as long as it saves in about a hundred frames. A caller that renders three frames will
        probably render many.
        """
        self._frames += 1
        if self._unordered is not None and self._frames >= at_frame:
            ordered = order_model(self._scope, self._program, self._count, self._unordered)
            self._sort.by_rows = not ordered
            self._unordered = None

    def _run(self, camera: Camera, background: tuple[float, float, float]) -> None:
        """Queue all stages from the projection to the pixels of the frame."""
        device, seen = self._device, self._list(camera)
        planes = _EXTRA_PLANES if self._outputs else _PLANES
        width, height = camera.width, camera.height
        pixels: dict[str, Buffer] = {
            "image": self._scratch("image", (height, width, 3), group="targets"),
            "alpha": self._scratch("alpha", (height, width), group="targets"),
            "depth": self._scratch("depth", (height, width), group="targets"),
        }
        if self._outputs:
            pixels["normal"] = self._scratch("normal", (height, width, 3), group="targets")
            pixels["depth_median"] = self._scratch("median", (height, width), group="targets")
            pixels["face_id"] = self._scratch("face id", (height, width), np.int32, group="targets")
        for band in self._bands(camera, seen, len(planes), whole="raw" in self._outputs):
            with device.stage("blend"):
                self._blend(self._blend_program.blend, seen, band)
            with device.stage("resolve"):
                self._resolve(band, pixels, width, background)
        self._pixels, self._samples, self._visible = pixels, band.samples, seen.projected.visible
        self.counts = {"listed": seen.lists.listed, "pairs": seen.lists.pairs}

    @in_turn
    def shares(self, camera: Camera, picture: NDArray[np.float32] | None = None) -> NDArray[np.float64]:
        """Return the contribution of each face to the image of `camera`, and to the colours of `picture`.

        Parameters
        ----------
        camera : Camera
        picture : (H, W, 3) float32, optional
            Finite colours.

        Returns
        -------
        (F, 4) float64, or (F, 1) without a picture
            The last column is the sum of the face's weights (alpha times transmittance) over all pixels. The
            first three columns are the weighted sums of the picture's red, green and blue. The weight in a
            pixel is the mean over its samples. The weights of all faces add up to the alpha of the frame.
        """
        device, seen = self._device, self._list(camera)
        share = self._build_program(EXTRAS=False, EARLY_STOP=self._early_stop, SHARES=True).share
        colors = self._scratch("picture", (camera.height, camera.width, 3))
        if picture is None:
            colors.fill(0)
        else:
            colors.write(np.ascontiguousarray(picture, np.float32))
        pairs = seen.lists.pairs
        sums = self._scratch("share sums", (max(pairs, 1), 4))
        sums.fill(0)
        # For each band, copy the picture's pixels to the samples. Add up the weighted colours of each list
        # entry.
        for band in self._bands(camera, seen, len(_SPREAD_PLANES)):
            _, height, width = band.samples.shape
            record = self._band_record(band, camera.width)
            spread = device.program("splat_resolve").spread
            spread((width, height), (WORK_GROUP, 1), colors, record, band.samples)
            self._blend(share, seen, band, sums)
        numbers = self._scratch("share numbers", max(pairs, 1), np.uint32)
        arguments = seen.lists.list, seen.projected.faces, numbers, np.uint32(pairs)
        self._program.numbers_of(pairs, WORK_GROUP, *arguments)
        # The entries of a list are added in list order and in double precision. List entries without weight
        # (hidden faces) are skipped.
        with numbers.mapped() as named, sums.mapped() as summed:
            adding = np.flatnonzero(summed[:pairs, 3])
            faces, columns = named[adding].astype(np.intp), summed[adding, 3 if picture is None else 0 :].T
        return np.stack([np.bincount(faces, column, minlength=self._count) for column in columns], axis=1)

    def _list(self, camera: Camera) -> _Listed:
        """Project the faces and list them by tile. The call waits for the two counts of the lists."""
        model, device = self._model, self._device
        record = make_view(
            camera,
            model.near,
            model.far,
            model.scale,
            self._fields,
            model.method_values,
            self._culling,
            self._extent,
        )
        with device.stage("project"):
            view = self._scratch("view", record.nbytes, np.uint8)
            view.write(np.frombuffer(record.tobytes(), np.uint8))
            projected = self._project(view)
        columns, rows = int(record["columns"]), int(record["rows"])
        lists = bin_faces(device, projected, self._chunk, columns, rows, self._sort)
        return _Listed(view, projected, lists, columns, rows)

    def _project(self, view: Buffer) -> Projected:
        """Queue the projection of all faces. If colours are per vertex, queue the evaluation of these
        colours first."""
        count, static, device = self._count, self._static, self._device
        chunk, chunks = self._chunk, -(-count // self._chunk)
        projected = Projected(
            faces=self._scratch("faces", (count, self.record_words), np.uint32),
            keys=self._scratch("keys", count, np.uint32),
            tiles=self._scratch("tiles", (count, 4), np.uint16),
            listed=self._scratch("listed", chunks, np.uint32),
            visible=self._scratch("visible", count, np.uint8),
        )
        first_color = static["f_dc"]
        if self._model.vertex_colors:
            vertices = len(self._model.positions)
            first_color = self._scratch("vertex colors", (vertices, 3))
            arguments = view, static["positions"], static["f_dc"], static["f_rest"], first_color
            items = -(-vertices // LANES[device.style])
            self._program.shade_vertices(items, WORK_GROUP, *arguments, np.uint32(vertices))
        names = ["bounds", "numbers", "positions", "indices", "coverage"]
        values = [count, static["bounds"].shape[1]]
        cpu = device.style == "cpu"
        if cpu:
            names.insert(0, "groups")
            values[1:1] = chunk, static["groups"].shape[1]
        sizes = map(np.uint32, values)
        sources = (*(static[name] for name in names), first_color, static["f_rest"])
        self._program.project(chunks, 1 if cpu else WORK_GROUP, view, *sources, *projected, *sizes)
        return projected

    def _bands(self, camera: Camera, seen: _Listed, planes: int, *, whole: bool = False) -> Iterator[_Band]:
        """Yield bands of samples, which all use the same memory. If `whole` is true, yield one band with the
        whole raster."""
        columns, rows, scale = seen.columns, seen.rows, self._model.scale
        # A band consists of complete tile rows and complete pixel rows.
        step = math.lcm(TILE, scale) // TILE
        room = _BAND_BYTES[self._device.style]
        if self._device.style == "cpu":
            room *= self._device.record.compute_units
        fit = room // (planes * 4 * columns * TILE * TILE)
        at_once = rows if whole else min(max(fit // step, 1), -(-rows // step)) * step
        samples = self._scratch("planes", (planes, at_once * TILE, columns * TILE))
        for first in range(0, rows, at_once):
            here = min(at_once, rows - first)
            first_row = first * TILE // scale
            last_row = min((first + here) * TILE // scale, camera.height)
            part = samples.view((planes, here * TILE, columns * TILE), samples.dtype)
            yield _Band(part, first, here, first_row, last_row - first_row)

    def _blend(self, kernel: Kernel, seen: _Listed, band: _Band, *more: Buffer) -> None:
        """Queue the kernel `blend` or `share` for a band. The kernel `share` also gets the buffer of its
        sums."""
        lists = seen.view, seen.lists.starts, seen.lists.list, seen.projected.faces
        first, here = band.first_tile_row, band.tile_rows
        arguments = *lists, band.samples, np.uint32(first), np.uint32(here), *more
        if self._device.style == "cpu":
            kernel(seen.columns * here, 1, *arguments)
        else:
            kernel((seen.columns * TILE, here * TILE), (TILE, TILE), *arguments)

    def _band_record(self, band: _Band, width: int) -> Buffer:
        """Return the `Band` record of splat_resolve.cl for a band with rows of `width` pixels."""
        model, (_, plane_rows, stride) = self._model, band.samples.shape
        values = width, band.rows, model.scale, *model.pixel_samples, stride, plane_rows, band.first_row
        if values not in self._band_records:  # reuse records, because an upload waits for all queued commands
            if len(self._band_records) >= _MOST_RECORDS:
                self._band_records.clear()
            self._band_records[values] = self._device.upload(np.array(values, np.uint32), "splat bands")
        return self._band_records[values]

    def _resolve(
        self,
        band: _Band,
        pixels: Mapping[str, Buffer],
        width: int,
        background: tuple[float, float, float],
    ) -> None:
        """Queue the computation of pixels from the samples of a band."""
        program, record = self._device.program("splat_resolve"), self._band_record(band, width)
        size, group = (width, band.rows), (WORK_GROUP, 1)
        targets = pixels["image"], pixels["alpha"], pixels["depth"]
        program.resolve(size, group, band.samples, record, *targets, *map(np.float32, background))
        if self._outputs:
            extras = pixels["normal"], pixels["depth_median"], pixels["face_id"]
            program.resolve_extras(size, group, band.samples, record, *extras)

    def _read(self, camera: Camera, background: tuple[float, float, float]) -> Frame:
        """Read back the requested parts of a frame."""
        pixels = self._pixels
        chosen = self._outputs & set(self._model.outputs)
        optional: dict[str, Any] = {name: pixels[name].read() for name in sorted(chosen)}
        return Frame(
            image=pixels["image"].read(),
            alpha=pixels["alpha"].read(),
            depth=pixels["depth"].read(),
            visible=self._read_visible(),
            raw=self._read_raw(camera, background) if "raw" in self._outputs else {},
            **optional,
        )

    def _read_visible(self) -> NDArray[np.bool_]:
        """Return which faces pass the official culling, in the order of the asset."""
        visible = self._scratch("visible by number", self._count, np.uint8)
        arguments = self._visible, self._static["numbers"], visible, np.uint32(self._count)
        self._program.visible_by_number(self._count, WORK_GROUP, *arguments)
        return visible.read().view(np.bool_)

    def _read_raw(self, camera: Camera, background: tuple[float, float, float]) -> dict[str, NDArray[Any]]:
        """Return the official kernel's buffers, from the planes of the whole raster."""
        height, width = self._model.scale * camera.height, self._model.scale * camera.width
        planes = dict(zip(_EXTRA_PLANES, self._samples.read()[:, :height, :width], strict=True))
        through, depth = planes["transmittance"], planes["depth"]
        color = np.stack([planes[name] for name in _PLANES[:3]], axis=-1)
        values = {
            "image": color + through[..., None] * np.array(background, np.float32),
            "transmittance": through,
            "alpha": 1 - through,
            "depth": depth,
            "depth_over_background": depth + through * self._background_depth(camera),
            "depth_median": planes["depth_median"],
            "normal": np.stack([planes[name] for name in ("nx", "ny", "nz")], axis=-1),
            "face_id": planes["face_id"].view(np.int32),
        }
        return {name: np.ascontiguousarray(values[plane]) for name, plane in self._model.raw.items()}

    def _background_depth(self, camera: Camera) -> np.float32:
        """Return the largest distance from the camera to a stored corner."""
        away = self._stored_positions - camera.center
        return np.float32(np.sqrt(np.square(away).sum(axis=1).max()))
