"""Conversion of an asset to the arrays that the WGSL reads, and of a camera to its uniform buffer."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.drawable import check_drawable
from msb.asset.settings import effective_settings
from msb.errors import Unsupported
from msb.registry import role
from msb.render.backend import check_supported
from msb.render.splat.model import CLIPPED, SplatModel, make_model, sh_buffers
from msb.render.splat.view import make_view
from msb.render.surface import Surface
from msb.scenes import Camera
from msb.scenes.colors import Color

# The common members of the struct `View` in view.wgsl. The members of the method follow directly in the
# buffer.
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


@dataclass(frozen=True)
class Packed:
    """The arrays and definitions of an asset for the shaders.

    Attributes
    ----------
    model : Model or Surface
        The model of the native rendering.
    faces, vertices : int
        The numbers of faces and of vertices.
    arrays : mapping of str to ndarray
        `positions`, `coverage`, and for indexed meshes `indices`. Blended methods also have the spherical
        harmonics `f_dc` and `f_rest` (a single zero at degree 0).
    surface : Surface, optional
        The same object as `model` if the model is drawn with a z-buffer, else None.
    degree : int
        Degree of the spherical harmonics.
    rest_stride : int
        Number of floats in a row of `f_rest`; 0 at degree 0.
    scale : int
        Samples per pixel along each axis.
    pixel_samples : (int, int)
        Indices of the first and the last sample along each axis, both inclusive. The average of these samples
        is the pixel.
    defines : mapping
        Definitions for the preprocessor of the WGSL.
    """

    model: SplatModel | Surface
    faces: int
    vertices: int
    arrays: Mapping[str, NDArray[Any]]
    surface: Surface | None = None
    degree: int = 0
    rest_stride: int = 0
    scale: int = 1
    pixel_samples: tuple[int, int] = (0, 0)
    defines: Mapping[str, bool] = field(default_factory=dict)

    @property
    def soup(self) -> bool:
        """Whether the model is a triangle soup: faces share no vertices, and colours belong to faces."""
        return "indices" not in self.arrays

    def view_bytes(self, camera: Camera, background: Color) -> bytes:
        """Return the uniform buffer of a camera: `VIEW`, then the method's members, padded to 16 bytes."""
        model, common = self.model, {"degree": self.degree}
        origin = np.zeros(3, np.float32)  # the centre of the model is only used for culling
        view = make_view(
            camera, model.near, model.far, self.scale, common, model.method_values, CLIPPED, origin
        )
        record = np.zeros((), VIEW)
        for name in VIEW.names or ():
            if name in (view.dtype.names or ()):
                record[name] = view[name]
        record["background"] = background
        if self.surface is not None:
            record["full"] = self.surface.projection(camera).ravel()
        data = record.tobytes() + view["own"].tobytes()
        return data + bytes(-len(data) % 16)


def pack(asset: Asset, settings: Mapping[str, Any] | None) -> Packed:
    """Return the data of `asset` for the WGSL of its method.

    Raises
    ------
    Unsupported
        UNSUPPORTED_TIER: the method has no native renderer or no WGSL.
    """
    check_supported(asset, "dedicated")
    values = effective_settings(asset.manifest, settings)
    native: Any = role(asset.manifest.method, "native")
    if not hasattr(native, "splat_model") and not hasattr(native, "surface_model"):
        raise _unsupported(asset)
    check_drawable(asset)
    packed = _pack_surface(asset, values) if hasattr(native, "surface_model") else _pack_splats(asset, values)
    if not (resources.files(packed.model.package) / f"{packed.model.program}.wgsl").is_file():
        raise _unsupported(asset)
    return packed


def make_native_model(asset: Asset, values: Mapping[str, Any]) -> SplatModel | Surface:
    """Return the model of the native rendering.

    The mapping `values` contains the settings. The function raises the same errors as `pack`.
    """
    native: Any = role(asset.manifest.method, "native")
    return (
        native.surface_model(asset, values) if hasattr(native, "surface_model") else make_model(asset, values)
    )


def _pack_splats(asset: Asset, values: Mapping[str, Any]) -> Packed:
    """Return the arrays of a method that blends its faces."""
    model = make_model(asset, values)
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
        arrays={name: np.ascontiguousarray(array) for name, array in arrays.items()},
        degree=values.get("sh_degree", asset.manifest.sh_degree),
        rest_stride=0 if f_rest is None else f_rest.shape[1],
        scale=model.scale,
        pixel_samples=model.pixel_samples,
        defines=model.defines,
    )


def _pack_surface(asset: Asset, values: Mapping[str, Any]) -> Packed:
    """Return the arrays of a method that draws an opaque surface with a z-buffer."""
    native: Any = role(asset.manifest.method, "native")
    surface: Surface = native.surface_model(asset, values)
    names = ("positions", "indices", "coverage")
    arrays = {name: np.ascontiguousarray(getattr(surface, name)) for name in names}
    return Packed(surface, asset.manifest.face_count, len(surface.positions), arrays, surface)


def _unsupported(asset: Asset) -> Unsupported:
    text = f"renderer wgpu cannot draw {asset.manifest.method} on tier dedicated: the package has no WGSL"
    return Unsupported("UNSUPPORTED_TIER", text, file=asset.opened_from)
