"""An asset as the arrays that the WGSL reads, and the record of a camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.drawable import check_drawable
from msb.asset.settings import effective_settings
from msb.errors import Unsupported
from msb.registry import role
from msb.render.splat.model import Model, make_model, sh_buffers
from msb.render.splat.view import make_view
from msb.render.surface import Surface

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.scenes import Camera

    Color = tuple[float, float, float]

VIEW = np.dtype(
    [
        ("world_to_camera", np.float32, 12),
        ("full", np.float32, 16),
        ("center", np.float32, 3),
        ("zero", np.uint32),
        ("tan_fov", np.float32, 2),
        ("shift", np.float32, 2),
        ("width", np.uint32),
        ("height", np.uint32),
        ("columns", np.uint32),
        ("rows", np.uint32),
        ("background", np.float32, 3),
        ("degree", np.uint32),
    ]
)
"""`View` of view.wgsl, without a method's own members, which follow."""


@dataclass(frozen=True)
class Packed:
    """An asset, ready to be uploaded.

    Attributes
    ----------
    model : Model
    faces, vertices : int
    degree : int
        Of the spherical harmonics that are evaluated.
    rest_stride : int
        Floats of `f_rest` in a row, 0 where there are none.
    arrays : mapping of str to ndarray
        `positions`, `indices` (of meshes), `coverage`; of blended methods `f_dc`, `f_rest` (one row of a
        zero at degree 0).
    """

    model: Model
    faces: int
    vertices: int
    degree: int
    rest_stride: int
    arrays: Mapping[str, NDArray[Any]]

    def view_bytes(self, camera: Camera, background: Color) -> bytes:
        """Return the camera record: `VIEW`, the method's own members, and zeros to a multiple of 16 bytes."""
        model = self.model
        common = {"degree": self.degree}
        nowhere = np.zeros(3, np.float32)
        made = make_view(
            camera, model.near, model.far, model.scale, common, model.own, model.culling, nowhere
        )
        record = np.zeros((), VIEW)
        for name in VIEW.names or ():
            if name in (made.dtype.names or ()):
                record[name] = made[name]
        record["background"] = background
        if isinstance(model, Surface):
            record["full"] = model.projection(camera).ravel()
        data = record.tobytes() + made["own"].tobytes()
        return data + bytes(-len(data) % 16)


def pack(asset: Asset, settings: Mapping[str, Any] | None) -> Packed:
    """Return `asset` as the WGSL of its method reads it."""
    values = effective_settings(asset.manifest, settings)
    look: Any = role(asset.manifest.method, "look")
    if not hasattr(look, "splat_model") and not hasattr(look, "surface_model"):
        raise _unsupported(asset)
    check_drawable(asset)
    model = model_of(asset, values)
    if not (resources.files(model.package) / f"{model.program}.wgsl").is_file():
        raise _unsupported(asset)
    if isinstance(model, Surface):
        return _pack_surface(asset, model)
    faces, vertices = asset.manifest.face_count, len(model.positions)
    f_dc, f_rest = sh_buffers(asset, vertices if model.vertex_colors else faces)
    arrays = {
        "positions": model.positions,
        "coverage": model.coverage,
        "f_dc": f_dc,
        "f_rest": np.zeros((1, 1), np.float32) if f_rest is None else f_rest,
    }
    if model.vertex_colors:
        arrays["indices"] = np.asarray(asset.buffers["indices"], np.uint32)
    return Packed(
        model=model,
        faces=faces,
        vertices=vertices,
        degree=values.get("sh_degree", asset.manifest.sh_degree),
        rest_stride=0 if f_rest is None else f_rest.shape[1],
        arrays={name: np.ascontiguousarray(array) for name, array in arrays.items()},
    )


def model_of(asset: Asset, values: Mapping[str, Any]) -> Model:
    """Return what a pipeline draws of `asset` with all its settings; errors as `pack`."""
    look: Any = role(asset.manifest.method, "look")
    if hasattr(look, "surface_model"):
        surface: Surface = look.surface_model(asset, values)
        return surface
    return make_model(asset, values)


def _pack_surface(asset: Asset, surface: Surface) -> Packed:
    names = ("positions", "indices", "coverage")
    return Packed(
        model=surface,
        faces=asset.manifest.face_count,
        vertices=len(surface.positions),
        degree=0,
        rest_stride=0,
        arrays={name: np.ascontiguousarray(getattr(surface, name)) for name in names},
    )


def _unsupported(asset: Asset) -> Unsupported:
    text = f"{asset.manifest.method} on tier dedicated by renderer wgpu: its package brings no WGSL"
    return Unsupported("UNSUPPORTED_TIER", text, file=asset.path)
