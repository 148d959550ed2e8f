"""The common parts of the engines: options, the mesh they are given, how a frame is put together."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from io import BytesIO
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.drawable import check_drawable
from msb.asset.look import StaticColors, drawn_colors, shown_faces, tint_of
from msb.asset.settings import effective_settings
from msb.asset.texture import Textured, textures_of
from msb.errors import UsageError, shorten
from msb.meshes import Mesh, write_mesh
from msb.meshes.formats import Style
from msb.render.backend import Drawn
from msb.render.frame import Frame
from msb.render.standard.supersampling import box_filter, checked_supersample, enlarged
from msb.scenes import Camera
from msb.scenes.colors import Color

# The depth of the near plane of the standard tier; there is no far plane.
NEAR = 0.01
# The stage of an engine that cannot say how long its device took: how long we waited for it.
WALL_CLOCK = "draw (wall clock)"
# The stage of an engine whose device keeps time.
DRAW = "draw"

_GROUPS = {
    **dict.fromkeys(("positions", "indices"), "geometry"),
    **dict.fromkeys(("vertex colors", "texture coordinates", "tints"), "appearance"),
    **dict.fromkeys(("image", "depth", "face ids"), "targets"),
}


class Engine(ABC):
    """A foreign engine as a renderer: draws the standard-tier mesh of an asset, with that tier's options.

    `device` "cpu" or "gpu" says where the engine computes, which is its own choice if not given; an engine
    ignores OpenCL devices and MSB_DEVICE.
    """

    name: ClassVar[str]
    tiers: ClassVar[tuple[str, ...]] = ("standard",)
    version: str
    # The `platform` and `name` of what draws, for reports.
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
        self._samples = checked_supersample(supersample)
        missing = self.missing()
        if missing is not None:
            raise UsageError("ENGINE_MISSING", f"renderer {self.name}: {missing}")
        self._mesh = engine_mesh(asset, settings)

    @classmethod
    @abstractmethod
    def missing(cls) -> str | None:
        """Return what has to be installed before this can draw, or None; no engine is started to find out."""

    @classmethod
    @abstractmethod
    def installed(cls) -> str:
        """Return the version that would draw, "" where none would; no engine is started to find out."""

    @abstractmethod
    def _frame(self, camera: Camera, background: Color) -> Frame:
        """Return one frame, one sample a pixel."""

    @abstractmethod
    def _draw(self, camera: Camera, background: Color) -> Drawn:
        """Draw and wait, reading nothing back."""

    @abstractmethod
    def memory(self) -> Mapping[str, int]:
        """Return use -> bytes."""

    def memory_groups(self) -> Mapping[str, str]:
        """Return use -> group, for the uses that engines have in common."""
        return _GROUPS

    @abstractmethod
    def close(self) -> None:
        """Release everything. A second call does nothing."""

    def render(self, camera: Camera, background: Color) -> Frame:
        """Draw the asset from `camera` over `background` (RGB, in the asset's colour space)."""
        frame = self._frame(enlarged(camera, self._samples), background)
        if self._samples == 1:
            return frame
        return replace(box_filter(frame, self._samples), timings=frame.timings)

    def draw(self, camera: Camera, background: Color) -> Drawn:
        """Draw and wait, reading nothing back."""
        return self._draw(enlarged(camera, self._samples), background)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def device_kind(device: Any, name: str) -> str | None:
    """Return "cpu", "gpu" or None (the engine's own choice)."""
    if device is None or device in ("cpu", "gpu"):
        return device  # type: ignore[no-any-return]
    shown = shorten(str(device), 40)
    text = f'device "{shown}" is one of OpenCL; renderer {name} takes cpu or gpu, or chooses itself'
    raise UsageError("DEVICE_SELECTOR", text)


def opaque_frame(
    image: NDArray[np.float32],
    hit: NDArray[np.bool_],
    depth: NDArray[np.float32],
    background: Color,
    face_id: NDArray[np.int32] | None,
    timings: Mapping[str, float],
) -> Frame:
    """Return a frame in our terms: `background` and depth 0 wherever `hit` (H, W) is false."""
    return Frame(
        image=np.where(hit[..., None], image, np.array(background, np.float32)),
        alpha=hit.astype(np.float32),
        depth=np.where(hit, depth, np.float32(0)),
        face_id=face_id,
        timings=dict(timings),
    )


@dataclass(frozen=True)
class EngineMesh:
    """The triangles and colours that our own standard tier draws, as an engine is given them."""

    positions: NDArray[np.float32]
    indices: NDArray[np.uint32]
    # Of vertices, (V, 3) uint8, or float32 in [0, 1]; a fourth channel is left out, as in our renderer.
    # Beside textures it is there, as alpha, and colours are multiplied with them in linear light.
    colors: NDArray[Any]
    # The asset's numbers of the faces; None if they are 0, 1, 2, ...
    numbers: NDArray[np.uint32] | None
    # The textures of these faces, if there are any.
    textured: Textured | None = None

    def encoded(self, suffix: str) -> bytes:
        """Return the file that `msb convert` writes of the asset, in the format of `suffix`; colours of
        vertices as sRGB, if there are no textures.
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
        """Return bounds of the vertices' depths, from the corners of their box."""
        low, high = self.positions.min(axis=0), self.positions.max(axis=0)
        corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
        depths = corners.astype(np.float64) @ world_to_camera[2, :3] + world_to_camera[2, 3]
        return float(depths.min()), float(depths.max())


def engine_mesh(asset: Asset, settings: Mapping[str, Any] | None) -> EngineMesh:
    """Return what an engine draws of `asset`.

    If colours belong to faces or corners, every face gets vertices of its own. If no face is shown, the mesh
    has one face without area, because no format for engines has a mesh without faces.
    """
    values = effective_settings(asset.manifest, settings)
    if (skin := textures_of(asset)) is not None:
        return _textured_mesh(asset, skin)
    check_drawable(asset, ("positions", "color", "f_dc"))
    positions = np.asarray(asset.buffers["positions"], np.float32)
    indices = np.asarray(asset.buffers["indices"], np.uint32)
    static = drawn_colors(asset)
    colors = static.values[:, :3]
    numbers = shown_faces(asset, values.get("ste_threshold"))
    if numbers is not None and not len(numbers):
        return EngineMesh(positions[:1], np.zeros((1, 3), np.uint32), np.zeros((1, 3), np.uint8), None)
    shown = slice(None) if numbers is None else numbers
    if static.domain == "vertex":
        return EngineMesh(positions, indices[shown], np.ascontiguousarray(colors), numbers)
    colors = colors.reshape(-1, 3, 3) if static.domain == "corner" else np.repeat(colors[:, None], 3, axis=1)
    corners = positions[indices[shown]].reshape(-1, 3)
    own = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    return EngineMesh(corners, own, np.ascontiguousarray(colors[shown].reshape(-1, 3)), numbers)


def _textured_mesh(asset: Asset, skin: Textured) -> EngineMesh:
    """Return what an engine draws of an asset with textures; white where it has no colours."""
    check_drawable(asset, ("positions", "color"))
    positions, indices, tint = asset.buffers["positions"], asset.buffers["indices"], tint_of(asset)
    if tint is None:
        tint = StaticColors(np.full((len(positions), 3), 255, np.uint8), "vertex")
    if tint.domain == "vertex":
        return EngineMesh(positions, indices, np.ascontiguousarray(tint.values), None, skin)
    corners = indices.reshape(-1)
    own = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    values = np.repeat(tint.values, 3, axis=0) if tint.domain == "face" else tint.values
    return EngineMesh(positions[corners], own, np.ascontiguousarray(values), None, skin)
