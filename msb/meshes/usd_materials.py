"""Reads the materials of a USD stage. This module runs usd-core in a child process."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

Vector = tuple[float, ...]
# A 2 x 3 matrix that is multiplied with (u, v, 1), the homogeneous texture coordinates. The coordinate v
# points upwards.
Matrix = tuple[Vector, Vector]

_WRAPS = {"clamp": "clamp", "black": "clamp", "mirror": "mirror"}
# The diffuse colour of UsdPreviewSurface if a material sets none.
_DEFAULT_COLOR = (0.18, 0.18, 0.18)
_BLACK, _ONES, _ZEROS = (0.0, 0.0, 0.0), (1.0,) * 4, (0.0,) * 4
# Longest chain of UsdTransform2d nodes that the reader follows. Malicious files may connect UsdTransform2d
# nodes in a circle.
_MAX_TRANSFORMS = 16
# Maps inputs of UsdPreviewSurface to names for messages. These inputs cannot be read if a shader computes
# their values.
_OTHER_MAPS = {
    "normal": "normal maps",
    "occlusion": "occlusion maps",
    "metallic": "metallic-roughness maps",
    "roughness": "metallic-roughness maps",
}


@dataclass(frozen=True)
class ImageUse:
    """An image file, and the conversions of its texels before rendering.

    In linear light, a texel is multiplied with `scale` (RGBA), and `bias` (RGBA) is added. The field `is_raw`
    is set if the texels are stored in linear light. The field `has_alpha` is set if alpha is compared with
    the cut-off.
    """

    file: str
    is_raw: bool = False
    has_alpha: bool = False
    scale: Vector = _ONES
    bias: Vector = _ZEROS


@dataclass(frozen=True)
class Material:
    """The colour of a USD material.

    If an image exists, the colour comes from the image. Without an image, the colour is the uniform colour.
    Without a uniform colour, the colour is the primvar.

    Attributes
    ----------
    image : ImageUse, optional
    varname, transform : str, Matrix or None
        The primvar with the image's texture coordinates, and the transform of the coordinates. None means the
        identity.
    wraps : tuple of str
        The wrap modes of the image along u and v.
    cutoff : float, optional
        The alpha cut-off.
    color : tuple of float, optional
        The colour (RGB, linear light). The uniform colour is multiplied with the image, and replaces a
        missing primvar.
    primvar : str, optional
        The primvar with the colours of the mesh.
    """

    image: ImageUse | None = None
    varname: str = "st"
    transform: Matrix | None = None
    wraps: tuple[str, str] = ("repeat", "repeat")
    cutoff: float | None = None
    color: Vector | None = None
    primvar: str | None = None


# The material for meshes without a material.
UNBOUND = Material(primvar="displayColor")


class _Source(NamedTuple):
    """The source of an input is a shader and the name of its output, or a value, or nothing."""

    shader: Any = None
    output: str = ""
    value: Any = None


class MaterialReader:
    """Reader for the materials of USD prims.

    The reader reads each material once, and adds the names of unread data to `left_out`.
    """

    def __init__(self, time: Any, left_out: dict[str, None]) -> None:
        self._time, self._left_out = time, left_out
        self._materials: dict[str, Material] = {}

    def find(self, prim: Any) -> Material:
        """Return the preview material of a prim. Without a preview material, return the material for full
        rendering."""
        from pxr import Tf, UsdShade

        binding = UsdShade.MaterialBindingAPI(prim)
        for purpose in (UsdShade.Tokens.preview, UsdShade.Tokens.full):
            try:
                material = binding.ComputeBoundMaterial(purpose)[0]
            except Tf.ErrorException:
                self._left_out["invalid material bindings"] = None
                continue
            if material:
                path = str(material.GetPath())
                if path not in self._materials:
                    self._materials[path] = self._read_surface(material)
                return self._materials[path]
        return UNBOUND

    def _read_surface(self, material: Any) -> Material:
        """Return the colour of a USD material.

        The emission replaces the colour if the diffuse colour is black (an unlit material).
        """
        surface = material.ComputeSurfaceSource()[0]
        if not surface or surface.GetShaderId() != "UsdPreviewSurface":
            self._left_out["materials other than UsdPreviewSurface"] = None
            return UNBOUND
        color, emission = self._follow(surface, "diffuseColor"), self._follow(surface, "emissiveColor")
        if emission.shader is not None or _color(emission.value, _BLACK) != _BLACK:
            if color.shader is None and _color(color.value, _DEFAULT_COLOR) == _BLACK:
                color = emission
            else:
                self._left_out["emission"] = None
        for name, title in _OTHER_MAPS.items():
            if self._follow(surface, name).shader is not None:
                self._left_out[title] = None
        name = "" if color.shader is None else str(color.shader.GetShaderId())
        if name == "UsdUVTexture":
            return self._read_texture(surface, color.shader)
        self._read_cutoff(surface, None)
        if name.startswith("UsdPrimvarReader_"):
            fallback = self._follow(color.shader, "fallback").value
            varname = str(self._follow(color.shader, "varname").value or "displayColor")
            return Material(color=None if fallback is None else _color(fallback, _BLACK), primvar=varname)
        if color.shader is not None:
            self._left_out["colours that other shaders compute"] = None
            return UNBOUND
        return Material(color=_color(color.value, _DEFAULT_COLOR))

    def _read_texture(self, surface: Any, reader: Any) -> Material:
        """Return the material for a texture reader that is connected to `surface`."""
        file = self._read_path(reader)
        if not file or "<UDIM>" in file:
            self._left_out["textures in several images (UDIM)" if file else "textures without an image"] = (
                None
            )
            return UNBOUND
        cutoff = self._read_cutoff(surface, reader)
        # A scale from 0 to 1 without bias is a colour that is multiplied with the image. Scales and biases
        # with other values change the texels of the image.
        scale = _vector(self._follow(reader, "scale").value, _ONES)
        bias = _vector(self._follow(reader, "bias").value, _ZEROS)
        color = None
        if bias[:3] == _BLACK and all(0 <= value <= 1 for value in scale[:3]):
            color, scale = scale[:3] if scale[:3] != _ONES[:3] else None, (1.0, 1.0, 1.0, scale[3])
        if cutoff is None:
            scale, bias = (*scale[:3], 1.0), (*bias[:3], 0.0)
        is_raw = str(self._follow(reader, "sourceColorSpace").value) == "raw"
        varname, transform = self._read_coordinates(reader)
        u, v = (_WRAPS.get(str(self._follow(reader, name).value), "repeat") for name in ("wrapS", "wrapT"))
        image = ImageUse(file, is_raw, cutoff is not None, scale, bias)
        return Material(image, varname, transform, (u, v), cutoff, color)

    def _read_coordinates(self, reader: Any) -> tuple[str, Matrix | None]:
        """Return the primvar with the coordinates of a texture reader, and the transform of the
        coordinates."""
        transform = np.eye(3)
        shader = self._follow(reader, "st").shader
        for _ in range(_MAX_TRANSFORMS):
            if shader is None or shader.GetShaderId() != "UsdTransform2d":
                break
            transform = transform @ self._read_transform(shader)
            shader = self._follow(shader, "in").shader
        varname = self._follow(shader, "varname").value if shader is not None else None
        if np.array_equal(transform, np.eye(3)):
            return str(varname or "st"), None
        first, second = (tuple(row) for row in transform[:2].tolist())
        return str(varname or "st"), (first, second)

    def _read_transform(self, shader: Any) -> Any:
        """Return the matrix (3, 3) of a UsdTransform2d: scale, rotate counter-clockwise, translate."""
        angle = np.radians(_number(self._follow(shader, "rotation").value, 0.0))
        across, up = _vector(self._follow(shader, "scale").value, (1.0, 1.0))
        x, y = _vector(self._follow(shader, "translation").value, (0.0, 0.0))
        cos, sin = np.cos(angle), np.sin(angle)
        return np.array([[cos * across, -sin * up, x], [sin * across, cos * up, y], [0, 0, 1]])

    def _read_cutoff(self, surface: Any, reader: Any) -> float | None:
        """Return the alpha cut-off of a surface. The texture reader `reader` provides the colour.

        Return None if the surface is opaque. Holes are cut only by the alpha channel of the colour image.
        """
        opacity = self._follow(surface, "opacity")
        threshold = _number(self._follow(surface, "opacityThreshold").value, 0.0)
        if opacity.shader is None:
            # A surface is opaque if its uniform opacity reaches the cut-off.
            if _number(opacity.value, 1.0) < (threshold if threshold > 0 else 1.0):
                self._left_out["opacity of materials"] = None
            return None
        is_alpha = reader is not None and opacity.output == "a"
        if not is_alpha or self._read_path(opacity.shader) != self._read_path(reader):
            self._left_out["opacity maps"] = None
        elif threshold > 0:
            return min(threshold, 1.0)
        else:
            self._left_out["alpha blending"] = None
        return None

    def _read_path(self, reader: Any) -> str:
        """Return the path of the image of a texture reader. The path is empty without an image."""
        file = self._follow(reader, "file").value
        return str(getattr(file, "path", file) or "")

    def _follow(self, shader: Any, name: str) -> _Source:
        """Find the source of the input `name` of a shader.

        Connections through interfaces of materials and node graphs are followed.
        """
        from pxr import UsdShade

        given = shader.GetInput(name)
        for attribute in given.GetValueProducingAttributes() if given else ():
            base, kind = UsdShade.Utils.GetBaseNameAndType(attribute.GetName())
            if kind == UsdShade.AttributeType.Output:
                shader = UsdShade.Shader(attribute.GetPrim())
                return _Source(shader, str(base)) if shader else _Source()
            return _Source(value=attribute.Get(self._time))
        return _Source()


def _color(value: Any, default: Vector) -> Vector:
    """Return `value` if it consists of three numbers, else `default`.

    The numbers may be outside [0, 1] or NaN.
    """
    numbers = list_numbers(value)
    return numbers if len(numbers) == len(default) else default


def _vector(value: Any, default: Vector) -> Vector:
    """Return `value` as finite numbers.

    If `value` is missing, not finite or of another length, return `default`.
    """
    numbers = list_numbers(value)
    return numbers if len(numbers) == len(default) and np.isfinite(numbers).all() else default


def _number(value: Any, default: float) -> float:
    """Return `value` as a finite number. If `value` is missing or not a finite number, return `default`."""
    return _vector(value, (default,))[0]


def list_numbers(value: Any) -> Vector:
    """Return the numbers in `value`, or an empty list if `value` is not numeric."""
    try:
        return tuple(np.array([] if value is None else value, np.float64).reshape(-1).tolist())
    except (TypeError, ValueError):
        return ()


def unite_textures(materials: list[Material], left_out: dict[str, None]) -> tuple[tuple[str, str], Any]:
    """Return the wrap modes and the alpha cut-off of a mesh with these textured materials.

    All materials of a mesh share one sampler. The first material sets the wrap modes. The alpha cut-off is
    the smallest alpha cut-off of all materials.
    """
    cutoffs = {material.cutoff for material in materials if material.cutoff is not None}
    if len({material.wraps for material in materials}) > 1:
        left_out["further samplers"] = None
    if len(cutoffs) > 1:
        left_out["further alpha cut-offs"] = None
    return materials[0].wraps if materials else ("repeat", "repeat"), min(cutoffs, default=None)
