"""Native rendering of DiffSoup in OpenCL: a z-buffer with binary opacity, feature lattices and their decoder.

Rules: kenji-tojo/diffsoup at c74e35d: src/cuda/rasterize.cu, multires.cu, encoding.cu;
python/diffsoup/rasterize.py; viewer/src/viewer.cpp (for `viewer`). docs/diffsoup.md describes the image
formation.
"""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.settings import check_modes, effective_settings
from msb.base.version import __version__
from msb.cl import Buffer, Device, Program
from msb.cl.kernel_text import Define
from msb.methods.diffsoup import FEATURES
from msb.methods.diffsoup.native_model import diffsoup_matrices, diffsoup_model, pixel_centers, surface_model
from msb.registry import Order, Sampling
from msb.render.backend import DrawTime
from msb.render.device_scope import DeviceScope, OnDevice, in_turn
from msb.render.frame import Frame, parse_outputs
from msb.scenes import Camera

__all__ = ["Pipeline", "surface_model"]

# Number of spherical harmonics of the view direction that the decoder reads (degree 2).
HARMONICS = 9
# Number of pixels or triangles that a CPU work-item processes at once (SIMD lanes).
_LANES = 8
# Work-items per work-group of the projection kernel.
_PROJECT_GROUP = 64
# Work-items that draw one triangle in GPU style; most triangles cover a few hundred pixels.
_RASTER_GROUP = 32
# Work-items per work-group of the shading kernel.
_SHADE_GROUP = 64
# Largest number of pixel rows of a band in CPU style. The planes of a band (20 bytes per pixel) then fit
# into a core's cache.
_BAND_ROWS = 16
# Minimum number of bands per compute unit, to balance the load.
_BANDS_A_UNIT = 4


class _Raster(NamedTuple):
    """The size of the image, and the length of its rows on the device in pixels."""

    width: int
    height: int
    pitch: int


class _Queued(NamedTuple):
    """The buffers that a frame leaves on the device, and the matrices used for drawing it."""

    outputs: tuple[Buffer, ...]
    raws: dict[str, Buffer]
    visible: Buffer
    fragments: Buffer
    corners: Buffer
    mvp: NDArray[np.float32]
    inverse: NDArray[np.float32]
    flip: bool


class Pipeline(OnDevice):
    """Renders DiffSoup models by the rules of the official evaluation. The model stays on the device.

    Parameters
    ----------
    asset : Asset
        An asset with lattices of numbers, or of bytes from the official web export; a byte v means v / 255.
    device : str or Device, optional
        A device selector (see `msb.cl.shared_device`), or an open device, which the renderer does not close.
    settings : mapping, optional
        Overrides of the asset's `layout`, `z_near` and `z_far`.
    outputs : "auto", "all" or iterable of str
        With "raw" the frame also contains the official kernels' buffers, which takes 25 % more time.
    order : {"tile", "global", "none"}
        This option has no effect, because the image of a z-buffer does not depend on the order of triangles.
    sampling : {"official", "engine"}
        With "engine", a triangle that crosses the camera plane is clipped as in graphics hardware. With
        "official", the triangle is dropped. Both sampling modes follow graphics hardware in all other rules.
    viewer : bool
        Whether to imitate the official viewers, which truncate lattices to bytes, and round interpolated
        features to bytes. The official viewers also clip triangles, which `sampling` "engine" imitates.
    """

    name = "msb-dedicated"
    version = __version__

    def __init__(
        self,
        asset: Asset,
        *,
        device: Device | str | None = None,
        settings: Mapping[str, Any] | None = None,
        outputs: str | Iterable[str] = "auto",
        order: Order = "tile",
        sampling: Sampling = "official",
        viewer: bool = False,
    ) -> None:
        check_modes(order, sampling)
        self._settings = effective_settings(asset.manifest, settings)
        model = diffsoup_model(asset, quantise=viewer)
        self._viewer, self._raw = viewer, "raw" in parse_outputs(outputs)
        self._faces, self._side = len(model.indices), np.int32(2**model.level)
        self._padded = -(-self._faces // _LANES) * _LANES
        self._scope = DeviceScope(device, "diffsoup")
        self._device, self._static = self._scope.device, self._scope.kept
        self._scratch = self._scope.scratch
        # CPU style: draw bands of rows, without atomics. GPU style: one atomic operation per fragment, in
        # two passes if atomics have only 32 bits.
        self._bands = self._device.style == "cpu"
        self._passes = 1 if self._device.record.int64_atomics else 2
        with self._scope.setting_up():
            self._scope.keep("positions", model.positions)
            self._scope.keep("indices", model.indices)
            self._scope.keep("opaque faces", model.opaque)
            self._scope.keep("lattice features", model.features, "appearance")
            self._scope.keep("lattice opacity", model.opacity, "appearance")
            self._scope.keep("decoder", model.decoder, "appearance")
            texel, scale = ("uchar", 255) if model.features.dtype == np.uint8 else ("float", 1)
            engine = sampling == "engine"
            defines: dict[str, Define] = {"TEXEL": texel, "TEXEL_SCALE": scale, "ENGINE": engine}
            if not self._bands:
                defines |= {"GROUP": _RASTER_GROUP, "KEYS": self._passes == 1}
            name = "diffsoup_cpu" if self._bands else "diffsoup_gpu"
            self._program: Program = self._device.program(name, defines, __package__)

    @in_turn
    def render(self, camera: Camera, background: tuple[float, float, float]) -> Frame:
        """Return the frame of `camera`; pixels without a triangle have exactly the colour `background`.

        The official background is black in the "colmap" layout, and white in the "synthetic" layout.

        Parameters
        ----------
        camera : Camera
            The camera has OpenCV axes in both layouts. In the layout "colmap", cy is used with the official
            sign (docs/diffsoup.md).
        background : (float, float, float)
            RGB in the asset's colour space.

        Returns
        -------
        Frame
            `alpha` is 1 or 0, and `depth` is the camera-space z of the visible triangle. `visible` contains
            the faces that are visible in at least one pixel. `timings` has the stages clear, project, raster,
            decode and read. The arrays in `raw` have the row order of the raster, where row 0 is NDC y = -1.
            `mvp` and `mvp_inv` are (4, 4) float32. `tri_id` is (H, W) int32, and -1 in empty pixels. The
            output "raw" adds float32 arrays that are 0 in empty pixels: `bary01` (H, W, 2), `depth` (H, W) in
            NDC, `features` (H, W, 7) and `sh` (H, W, 9). The output "raw" also adds `clip_corners` (F, 3, 4)
            float32, and `num_fragments`, the number of fragments between the planes before the opacity test.
        """
        device = self._device
        with device.timing() as timing:
            queued = self._queue(camera, background)
            with device.stage("read"):
                image, depth, face_id = (buffer.read() for buffer in queued.outputs)
                seen = queued.visible.read()
                kept = {name: buffer.read() for name, buffer in queued.raws.items()} if self._raw else {}
                if self._raw:
                    kept["clip_corners"] = queued.corners.read()
                    kept["num_fragments"] = queued.fragments.read().sum(dtype=np.uint64)
        raw = {
            "mvp": queued.mvp,
            "mvp_inv": queued.inverse,
            "tri_id": face_id[::-1] if queued.flip else face_id,
        }
        return Frame(
            image=image,
            alpha=(face_id >= 0).astype(np.float32),
            depth=depth,
            face_id=face_id,
            visible=seen.view(np.bool_),
            raw={**raw, **kept},
            timings=timing.milliseconds(),
        )

    @in_turn
    def draw(self, camera: Camera, background: tuple[float, float, float]) -> DrawTime:
        """Draw as `render` does, without reading anything back, and wait until the frame is finished."""
        with self._device.timing() as timing:
            self._queue(camera, background)
        return DrawTime(timing.milliseconds(), timing.span(), timing.since_queued())

    def _queue(self, camera: Camera, background: tuple[float, float, float]) -> _Queued:
        """Queue all commands of a frame, except reading results back."""
        layout = self._settings["layout"]
        near, far = self._settings["z_near"], self._settings["z_far"]
        mvp, inverse = diffsoup_matrices(camera, layout, near, far)
        raster = _Raster(camera.width, camera.height, camera.width)
        if self._bands:
            raster = raster._replace(pitch=-(-camera.width // _LANES) * _LANES)
        device, flip = self._device, layout == "synthetic"
        with device.stage("project"):
            scene = self._project(raster, np.concatenate([mvp.ravel(), inverse.ravel(), background]))
        planes, fragments = (self._draw_bands if self._bands else self._draw_groups)(raster, scene)
        with device.stage("clear"):
            visible = self._scratch("visible", self._faces, np.uint8)
            visible.fill(0)
        with device.stage("decode"):
            outputs, raws = self._shade(raster, scene, planes, visible, flip)
        return _Queued(outputs, raws, visible, fragments, scene["corners"], mvp, inverse, flip)

    def _project(self, raster: _Raster, frame: Any) -> dict[str, Buffer]:
        """Queue the projection of all triangles; return the buffers that are needed to draw the frame."""
        scene = {
            "frame": self._scratch("frame", len(frame)),
            "corners": self._scratch("corners", (self._faces, 3, 4)),
            "first rows": self._scratch("first rows", self._padded, np.uint16),
            "last rows": self._scratch("last rows", self._padded, np.uint16),
            "columns": self._scratch("columns", (self._padded, 2), np.uint16),
            "ndc x": self._scratch("ndc x", raster.pitch),
            "ndc y": self._scratch("ndc y", raster.height),
        }
        scene["frame"].write(frame.astype(np.float32))
        scene["ndc x"].write(pixel_centers(raster.width, raster.pitch))
        scene["ndc y"].write(pixel_centers(raster.height, raster.height))
        self._program.project(
            self._padded,
            _PROJECT_GROUP,
            self._static["positions"],
            self._static["indices"],
            *(scene[name] for name in ("frame", "corners", "first rows", "last rows", "columns")),
            *map(np.uint32, (self._faces, self._padded, raster.width, raster.height)),
        )
        return scene

    def _draw_bands(self, raster: _Raster, scene: dict[str, Buffer]) -> tuple[tuple[Buffer, ...], Buffer]:
        """Queue the drawing in bands of rows (CPU style); return the z-buffer planes and the fragment
        counts."""
        units = self._device.record.compute_units
        rows = max(1, min(_BAND_ROWS, raster.height // (_BANDS_A_UNIT * units)))
        bands = -(-raster.height // rows)
        shape = (raster.height, raster.pitch)
        face = self._scratch("plane face", shape, np.int32)
        ndc, b0, b1, w = (self._scratch(f"plane {name}", shape) for name in ("ndc", "b0", "b1", "w"))
        fragments = self._scratch("fragments", bands, np.uint64)
        with self._device.stage("clear"):
            face.fill(-1)
            ndc.fill(np.inf)
        with self._device.stage("raster"):
            self._program.raster(
                bands,
                1,
                *self._triangles(scene),
                *(face, ndc, b0, b1, w),
                fragments,
                *map(np.uint32, (self._padded, *raster, rows)),
                self._side,
            )
        return (face, ndc, b0, b1, w), fragments

    def _draw_groups(self, raster: _Raster, scene: dict[str, Buffer]) -> tuple[tuple[Buffer, ...], Buffer]:
        """Queue the drawing by work-groups (GPU style); return the z-buffer keys and the fragment counts."""
        keys = self._scratch("keys", (raster.height, raster.width, 2), np.uint32, group="targets")
        fragments = self._scratch("fragments", self._faces, np.uint32)
        with self._device.stage("clear"):
            keys.fill(np.iinfo(np.uint32).max)
            fragments.fill(0)
        with self._device.stage("raster"):
            for number in range(self._passes):
                self._program.raster(
                    self._faces * _RASTER_GROUP,
                    _RASTER_GROUP,
                    *self._triangles(scene),
                    keys,
                    fragments,
                    np.uint32(raster.width),
                    self._side,
                    np.int32(number),
                )
        return (keys, scene["corners"]), fragments

    def _triangles(self, scene: dict[str, Buffer]) -> tuple[Buffer, ...]:
        """Return the arguments that describe the triangles for both `raster` kernels."""
        frame = (scene[name] for name in ("corners", "first rows", "last rows", "columns"))
        static = self._static["lattice opacity"], self._static["opaque faces"]
        return (*frame, *static, scene["ndc x"], scene["ndc y"])

    def _shade(
        self,
        raster: _Raster,
        scene: dict[str, Buffer],
        planes: tuple[Buffer, ...],
        visible: Buffer,
        flip: bool,
    ) -> tuple[tuple[Buffer, ...], dict[str, Buffer]]:
        """Queue interpolation and decoding of the visible features; return the outputs and the raw
        buffers."""
        shape = (raster.height, raster.width)
        outputs = (
            self._scratch("image", (*shape, 3), group="targets"),
            self._scratch("depth", shape, group="targets"),
            self._scratch("face id", shape, np.int32, group="targets"),
        )
        kept = shape if self._raw else (1, 1)
        raws = {
            "bary01": self._scratch("bary01", (*kept, 2), group="targets"),
            "depth": self._scratch("ndc depth", kept, group="targets"),
            "features": self._scratch("features seen", (*kept, FEATURES)),
            "sh": self._scratch("harmonics", (*kept, HARMONICS)),
        }
        sizes: tuple[int, ...] = raster[:2]
        launch: tuple[int, int] = raster.width * raster.height, _SHADE_GROUP
        if self._bands:
            sizes, launch = tuple(raster), (raster.height, 1)
        self._program.shade(
            *launch,
            *planes,
            self._static["lattice features"],
            self._static["decoder"],
            scene["frame"],
            scene["ndc x"],
            scene["ndc y"],
            *outputs,
            visible,
            *raws.values(),
            *map(np.uint32, (*sizes, flip, self._viewer, self._raw)),
            self._side,
        )
        return outputs, raws
