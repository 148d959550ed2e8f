"""The common parts of the engines: options, the mesh to draw, and the resulting frame."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from io import BytesIO
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.drawable import check_drawable
from msb.asset.look import StaticColors, drawn_colors, select_faces, tint_of
from msb.asset.settings import effective_settings
from msb.asset.texture import Textured, textures_of
from msb.errors import UsageError, shorten
from msb.meshes import Mesh, write_mesh
from msb.meshes.formats import Style
from msb.render.backend import DrawTime
from msb.render.frame import Frame
from msb.render.standard.supersampling import box_filter, check_supersample, enlarge
from msb.scenes import Camera
from msb.scenes.colors import Color

# Distance of the near plane, in scene units. The standard tier has no far plane.
NEAR = 0.01
# Stage name of a frame whose time is measured with the wall clock.
WALL_CLOCK = "draw (wall clock)"
# Stage name of a frame whose time is measured by the device.
DRAW = "draw"

# Maps each use of device memory to its group in memory reports.
_GROUPS = {
    **dict.fromkeys(("positions", "indices"), "geometry"),
    **dict.fromkeys(("vertex colors", "texture coordinates", "tints"), "appearance"),
    **dict.fromkeys(("image", "depth", "face ids"), "targets"),
}


class Engine(ABC):
    """A renderer that draws the standard-tier mesh of an asset with another engine.

    Renderers with other engines have the same options as our renderer of the standard tier. `device` is
    "cpu", "gpu", or None to let the engine choose. The OpenCL device names and MSB_DEVICE do not apply to
    other engines.
    """

    name: ClassVar[str]
    tiers: ClassVar[tuple[str, ...]] = ("standard",)
    version: str
    # The `platform`, `name` and `kind` ("cpu" or "gpu") of the device, for reports.
    device_info: Mapping[str, str]

    def __init__(
        self,
        asset: Asset,
        *,
        device: Any = None,
        settings: Mapping[str, Any] | None = None,
        supersample: int = 1,
    ) -> None:
        self._kind = device_kind(device, self.name)
        self._samples = check_supersample(supersample)
        missing = self.missing()
        if missing is not None:
            raise UsageError("ENGINE_MISSING", f"renderer {self.name}: {missing}")
        self._mesh = engine_mesh(asset, settings)

    @classmethod
    @abstractmethod
    def missing(cls) -> str | None:
        """Return the name of a missing package for this engine, or None, without starting the engine."""

    @classmethod
    @abstractmethod
    def installed(cls) -> str:
        """Return the version of the installed engine, or "". The engine itself is not started."""

    @abstractmethod
    def _frame(self, camera: Camera, background: Color) -> Frame:
        """Return one frame with one sample per pixel."""

    @abstractmethod
    def _draw(self, camera: Camera, background: Color) -> DrawTime:
        """Draw a frame and wait until it is complete, but read nothing back."""

    @abstractmethod
    def memory(self) -> Mapping[str, int]:
        """Return the bytes of device memory for each use."""

    def memory_groups(self) -> Mapping[str, str]:
        """Return the report group of each memory use."""
        return _GROUPS

    @abstractmethod
    def close(self) -> None:
        """Release everything. A second call of `close` does nothing."""

    def render(self, camera: Camera, background: Color) -> Frame:
        """Draw the asset from `camera` over `background` (RGB, in the asset's colour space)."""
        frame = self._frame(enlarge(camera, self._samples), background)
        if self._samples == 1:
            return frame
        return replace(box_filter(frame, self._samples), timings=frame.timings)

    def draw(self, camera: Camera, background: Color) -> DrawTime:
        """Draw a frame and wait until it is complete, but read nothing back."""
        return self._draw(enlarge(camera, self._samples), background)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def device_kind(device: Any, name: str) -> str | None:
    """Return "cpu", "gpu" or None (the engine chooses) for the option `device` of the renderer `name`."""
    if device is None or device in ("cpu", "gpu"):
        return device  # type: ignore[no-any-return]
    text = f'device "{shorten(str(device), 40)}" is an OpenCL device; renderer {name} accepts cpu or gpu only'
    raise UsageError("DEVICE_SELECTOR", text)


def opaque_frame(
    image: NDArray[np.float32],
    hit: NDArray[np.bool_],
    depth: NDArray[np.float32],
    background: Color,
    face_id: NDArray[np.int32] | None,
    timings: Mapping[str, float],
) -> Frame:
    """Return a frame with `background` and depth 0 in the pixels without a face.

    `image` is (H, W, 3), `depth` and `face_id` are (H, W), and `hit` (H, W) marks the pixels with a face.
    """
    return Frame(
        image=np.where(hit[..., None], image, np.array(background, np.float32)),
        alpha=hit.astype(np.float32),
        depth=np.where(hit, depth, np.float32(0)),
        face_id=face_id,
        timings=dict(timings),
    )


@dataclass(frozen=True)
class EngineMesh:
    """The triangles and colours of the standard tier in the form that engines need."""

    positions: NDArray[np.float32]
    indices: NDArray[np.uint32]
    # Vertex colours (V, 3), uint8, or float32 in [0, 1]. With textures, vertex colours (V, 4) have an alpha
    # channel and are multiplied with the texture in linear light.
    colors: NDArray[Any]
    # Index of each face in the asset; None if the indices are 0, 1, 2, ...
    numbers: NDArray[np.uint32] | None
    textured: Textured | None = None

    def to_bytes(self, suffix: str) -> bytes:
        """Return the same mesh file as `msb convert` writes for the asset, in the format of `suffix`.

        Without textures, vertex colours are stored as sRGB.
        """
        mesh = Mesh(self.positions, self.indices.astype(np.int64), self.colors)
        if (skin := self.textured) is not None:
            mesh = replace(
                mesh,
                corner_uvs=skin.uvs.reshape(-1, 2),
                textures=skin.images,
                face_textures=skin.face_texture,
                sampler=skin.sampler,
            )
        file = BytesIO()
        write_mesh(mesh, file, suffix=suffix, style=Style("srgb" if skin is None else None))
        return file.getvalue()

    def depth_range(self, world_to_camera: NDArray[np.float64]) -> tuple[float, float]:
        """Return lower and upper bounds of the vertices' depths, from the corners of the bounding box."""
        low, high = self.positions.min(axis=0), self.positions.max(axis=0)
        corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
        depths = corners.astype(np.float64) @ world_to_camera[2, :3] + world_to_camera[2, 3]
        return float(depths.min()), float(depths.max())


def engine_mesh(asset: Asset, settings: Mapping[str, Any] | None) -> EngineMesh:
    """Return the standard-tier mesh of `asset` for an engine.

    With face or corner colours, faces do not share vertices. If no face is selected, the mesh has one face of
    zero area, because the file formats of the engines require a face.
    """
    values = effective_settings(asset.manifest, settings)
    if (skin := textures_of(asset)) is not None:
        return _textured_mesh(asset, skin)
    check_drawable(asset, ("positions", "color", "f_dc"))
    positions = np.asarray(asset.buffers["positions"], np.float32)
    indices = np.asarray(asset.buffers["indices"], np.uint32)
    static = drawn_colors(asset)
    colors = static.values[:, :3]
    numbers = select_faces(asset, values.get("ste_threshold"))
    if numbers is not None and not len(numbers):
        return EngineMesh(positions[:1], np.zeros((1, 3), np.uint32), np.zeros((1, 3), np.uint8), None)
    selected = slice(None) if numbers is None else numbers
    if static.domain == "vertex":
        return EngineMesh(positions, indices[selected], np.ascontiguousarray(colors), numbers)
    # Colours (F, 3, 3) of the corners; every corner becomes a separate vertex.
    colors = colors.reshape(-1, 3, 3) if static.domain == "corner" else np.repeat(colors[:, None], 3, axis=1)
    corners = positions[indices[selected]].reshape(-1, 3)
    faces = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    return EngineMesh(corners, faces, np.ascontiguousarray(colors[selected].reshape(-1, 3)), numbers)


def _textured_mesh(asset: Asset, skin: Textured) -> EngineMesh:
    """Return the mesh of an asset with textures.

    An asset without vertex colours gets white vertex colours.
    """
    check_drawable(asset, ("positions", "color"))
    positions, indices, tint = asset.buffers["positions"], asset.buffers["indices"], tint_of(asset)
    if tint is None:
        tint = StaticColors(np.full((len(positions), 3), 255, np.uint8), "vertex")
    if tint.domain == "vertex":
        return EngineMesh(positions, indices, np.ascontiguousarray(tint.values), None, skin)
    corners = indices.reshape(-1)
    faces = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    values = np.repeat(tint.values, 3, axis=0) if tint.domain == "face" else tint.values
    return EngineMesh(positions[corners], faces, np.ascontiguousarray(values), None, skin)
