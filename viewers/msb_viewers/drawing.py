"""Create VTK actors from arrays: unlit surfaces, lines, markers, and images over the view.

Functions import VTK when called, so that importing this module does not load VTK.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import Sampler
from msb_viewers.palette import Color, unit

_SHAPES = {
    # GLSL expressions for the distance of p, a vec2 in [-1, 1]^2, from the centre of a marker. The marker
    # covers distances up to 1, and its dark rim begins just below 1.
    "disc": "length(p)",
    "diamond": "abs(p.x) + abs(p.y)",
    "square": "max(abs(p.x), abs(p.y)) * 1.05",
    "cross": "max(abs(abs(p.x) - abs(p.y)) * 2.2, max(abs(p.x), abs(p.y)))",
}
_MARKER = """//VTK::Light::Impl
  vec2 p = 2.0 * gl_PointCoord - 1.0;
  float reach = {distance};
  if (reach > 1.0) discard;
  float pixel = 2.0 * length(vec2(dFdx(gl_PointCoord.x), dFdy(gl_PointCoord.x)));
  if (pixel < 0.24 && reach > 1.0 - max(1.3 * pixel, 0.16)) gl_FragData[0] = vec4(0.0, 0.0, 0.0, 1.0);
"""
_RING = """//VTK::Light::Impl
  vec2 p = 2.0 * gl_PointCoord - 1.0;
  float reach = length(p);
  if (reach > 1.0 || reach < {inner}) discard;
"""
_TEXEL = """
  vec2 place = tcoordVCVSOutput;
  {place}
  vec4 texel = texture(actortexture, place);
  vec3 tint = gl_FragData[0].rgb;
  vec3 light = texel.rgb * mix(tint / 12.92, pow((tint + 0.055) / 1.055, vec3(2.4)), step(0.04045, tint));
  if (texel.a * gl_FragData[0].a < {cutoff}) discard;
  vec3 curve = 1.055 * pow(light, vec3(1.0 / 2.4)) - 0.055;
  gl_FragData[0] = vec4(mix(12.92 * light, curve, step(0.0031308, light)), 1.0);
"""
_WRAP_CODE = {
    # GLSL code that wraps the texture coordinate {c}. The code is needed if the wrap modes of u and v differ,
    # because VTK has a single wrap mode for both coordinates.
    "repeat": "",
    "mirror": "place.{c} = clamp(1.0 - abs(mod(place.{c}, 2.0) - 1.0), {rim}, 1.0 - {rim}); ",
    "clamp": "place.{c} = clamp(place.{c}, {rim}, 1.0 - {rim}); ",
}
# For each wrap mode, the constant of VTK (`vtkTexture.ClampToEdge`, `Repeat`, `MirroredRepeat`).
_WRAPS = {"clamp": 0, "repeat": 1, "mirror": 2}
# Offset of markers and lines towards the camera, in steps of the depth buffer. If there were no offset, the
# surface would hide the markers and lines.
_POINT_OFFSET, _LINE_OFFSET = -16.0, -8.0


def silence_vtk() -> None:
    """Keep VTK from writing to standard error.

    Other code of this package detects and reports relevant errors.
    """
    from vtkmodules.vtkCommonCore import vtkLogger, vtkObject

    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    vtkObject.GlobalWarningDisplayOff()


def surface(
    points: NDArray[np.float32],
    faces: NDArray[Any],
    colors: NDArray[np.uint8] | None,
    domain: str,
    *,
    shade: float = 0.0,
    color: Color = (205, 205, 205),
) -> Any:
    """Return an actor of triangles (n, 3) with `colors` (V | n | 3n, 3) in sRGB bytes, or with a uniform
    `color`.

    The `domain` of the colours is vertex, face or corner. `shade` in [0, 1] is the loss of brightness for a
    face that is seen edge-on. The value 0 of `shade` means unlit.
    """
    if domain == "corner" and colors is not None:
        points = points[faces].reshape(-1, 3)
        faces = np.arange(faces.size, dtype=np.int32).reshape(-1, 3)
    actor = _actor(_poly(points, faces, "SetPolys"), color)
    if colors is not None:
        data, mapper = actor.GetMapper().GetInput(), actor.GetMapper()
        if domain == "face":
            data.GetCellData().SetScalars(_vtk(colors))
            mapper.SetScalarModeToUseCellData()
        else:
            data.GetPointData().SetScalars(_vtk(colors))
            mapper.SetScalarModeToUsePointData()
        mapper.SetScalarVisibility(True)
        mapper.SetColorModeToDirectScalars()
    appearance = actor.GetProperty()
    appearance.SetLighting(shade > 0)
    if shade > 0:
        appearance.SetAmbient(1 - shade)
        appearance.SetDiffuse(shade)
    return actor


def textured(
    points: NDArray[np.float32],
    faces: NDArray[Any],
    uvs: NDArray[np.float32],
    image: NDArray[np.uint8],
    sampler: Sampler,
    tint: NDArray[np.uint8] | None,
    cutoff: float,
) -> Any:
    """Return an unlit actor of triangles (n, 3) with the texture `image` (H, W, 3 | 4) at `uvs` (n, 3, 2).

    The texture is multiplied by corner colours `tint` (3n, 4), and is not drawn where alpha is below
    `cutoff`. Filtering and multiplication are in linear light, as on the standard tier (opaque rendering).
    The standard tier decodes tint colours at each corner, but this actor decodes tint colours at each pixel.
    """
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkRenderingCore import vtkTexture

    # Create the surface with texture coordinates and corner colours. If `tint` is missing, the corners are
    # white.
    white = np.full((faces.size, 4), 255, np.uint8) if tint is None else tint
    actor = surface(points, faces, white, "corner")
    actor.GetMapper().GetInput().GetPointData().SetTCoords(_vtk(uvs.reshape(-1, 2)))
    height, width, channels = image.shape
    data = vtkImageData()
    data.SetDimensions(width, height, 1)  # row 0 of a texture is v = 0 in VTK, too
    data.GetPointData().SetScalars(_vtk(image.reshape(-1, channels)))
    texture = vtkTexture()
    texture.SetInputData(data)
    texture.SetColorModeToDirectScalars()
    texture.SetUseSRGBColorSpace(True)
    texture.SetInterpolate(sampler.filter == "linear")
    texture.SetMipmap(sampler.mipmaps)
    texture.SetMaximumAnisotropicFiltering(1.0)
    # The shader handles different wrap modes of u and v.
    wraps = sampler.wrap_u, sampler.wrap_v
    texture.SetWrap(_WRAPS[wraps[0]] if wraps[0] == wraps[1] else vtkTexture.Repeat)
    wrap_code = ""
    if wraps[0] != wraps[1]:
        sides = zip("xy", wraps, (width, height), strict=True)
        wrap_code = "".join(_WRAP_CODE[wrap].format(c=axis, rim=0.5 / size) for axis, wrap, size in sides)
    actor.SetTexture(texture)
    actor.ForceOpaqueOn()  # alpha is only used for the cutoff, not for blending
    code = _TEXEL.format(place=wrap_code, cutoff=f"{cutoff:.9f}")
    actor.GetShaderProperty().AddFragmentShaderReplacement("//VTK::TCoord::Impl", True, code, False)
    return actor


def segments(ends: NDArray[np.float32], color: Color, width: float, *, dashed: bool = False) -> Any:
    """Return an actor of unlit lines between pairs of points (n, 2, 3); `width` is in pixels."""
    if dashed:
        ends = dashes(ends)
    points = np.ascontiguousarray(ends.reshape(-1, 3))
    actor = _actor(_poly(points, np.arange(len(points), dtype=np.int32).reshape(-1, 2), "SetLines"), color)
    actor.GetProperty().SetLighting(False)
    actor.GetProperty().SetLineWidth(width)
    actor.GetMapper().SetRelativeCoincidentTopologyLineOffsetParameters(-1.0, _LINE_OFFSET)
    return actor


def dashes(ends: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return three dashes (3n, 2, 3) for each segment (n, 2, 3)."""
    a, b = ends[:, None, 0], ends[:, None, 1]
    start, stop = (np.array(t, np.float32)[None, :, None] for t in ((0.0, 0.4, 0.8), (0.2, 0.6, 1.0)))
    return np.stack([a + start * (b - a), a + stop * (b - a)], axis=2).reshape(-1, 2, 3)


def markers(points: NDArray[np.float32], color: Color, shape: str, size: float) -> Any:
    """Return an actor of flat markers at `points` (n, 3) with a dark rim; `size` is in pixels."""
    points = np.ascontiguousarray(points)
    actor = _actor(_poly(points, np.arange(len(points), dtype=np.int32)[:, None], "SetVerts"), color)
    actor.GetProperty().SetLighting(False)
    actor.GetProperty().SetPointSize(size)
    actor.GetMapper().SetRelativeCoincidentTopologyPointOffsetParameter(_POINT_OFFSET)
    if shape == "ring":
        code = _RING.format(inner=0.78 if size > 20 else 0.5)
    else:
        code = _MARKER.format(distance=_SHAPES[shape])
    actor.GetShaderProperty().AddFragmentShaderReplacement("//VTK::Light::Impl", True, code, False)
    return actor


def clip(actors: Iterable[Any], box: NDArray[Any] | None) -> None:
    """Draw only the part inside a box (3, 2), which has a low and a high end per axis.

    None draws everything.
    """
    from vtkmodules.vtkCommonDataModel import vtkPlane

    planes = []
    for axis in range(3) if box is not None else ():
        for side, sign in ((0, 1.0), (1, -1.0)):
            plane = vtkPlane()
            origin, normal = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
            origin[axis], normal[axis] = float(box[axis, side]), sign  # type: ignore[index]
            plane.SetOrigin(*origin)
            plane.SetNormal(*normal)
            planes.append(plane)
    for actor in actors:
        mapper = actor.GetMapper()
        mapper.RemoveAllClippingPlanes()
        for plane in planes:
            mapper.AddClippingPlane(plane)


class Overlay:
    """An RGBA image over a renderer, drawn pixel by pixel."""

    def __init__(self) -> None:
        from vtkmodules.vtkRenderingCore import vtkActor2D, vtkImageMapper

        self._mapper = vtkImageMapper()
        self._mapper.SetColorWindow(255.0)
        self._mapper.SetColorLevel(127.5)
        self.actor = vtkActor2D()
        self.actor.SetMapper(self._mapper)
        self.actor.SetVisibility(False)
        self.size = (0, 0)

    def set(self, image: NDArray[np.uint8]) -> None:
        """Show `image` (H, W, 4). Row 0 is at the top."""
        from vtkmodules.vtkCommonDataModel import vtkImageData

        height, width = image.shape[:2]
        data = vtkImageData()
        data.SetDimensions(width, height, 1)
        data.GetPointData().SetScalars(_vtk(np.ascontiguousarray(image[::-1]).reshape(-1, 4)))
        self._mapper.SetInputData(data)
        self.size = (width, height)
        self.actor.SetVisibility(True)

    def place(self, left: int, bottom: int) -> None:
        """Put the lower left corner of the image at a pixel of the window."""
        self.actor.SetDisplayPosition(left, bottom)

    def hide(self) -> None:
        """Hide the image."""
        self.actor.SetVisibility(False)


def _actor(data: Any, color: Color) -> Any:
    """Return an actor of poly data in a uniform colour."""
    from vtkmodules.vtkRenderingCore import vtkActor, vtkMapper, vtkPolyDataMapper

    vtkMapper.SetResolveCoincidentTopologyToPolygonOffset()
    mapper = vtkPolyDataMapper()
    mapper.SetInputData(data)
    mapper.SetScalarVisibility(False)
    actor = vtkActor()
    actor.SetMapper(mapper)
    actor.GetProperty().SetColor(*unit(color))
    actor.GetProperty().SetInterpolationToFlat()
    return actor


def _poly(points: NDArray[np.float32], cells: NDArray[Any], setter: str) -> Any:
    """Return poly data with points (V, 3) and cells (n, k). VTK shares the arrays if their types match."""
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData

    holder = vtkPoints()
    holder.SetData(_vtk(points))
    array = vtkCellArray()
    width = cells.shape[1]
    kind = np.int32 if len(points) < 2**31 else np.int64
    flat = np.ascontiguousarray(cells, kind).reshape(-1)
    starts = np.arange(0, len(flat) + 1, width, dtype=kind)
    array.SetData(_vtk(starts), _vtk(flat))
    data = vtkPolyData()
    data.SetPoints(holder)
    getattr(data, setter)(array)
    return data


def _vtk(array: NDArray[Any]) -> Any:
    from vtkmodules.util.numpy_support import numpy_to_vtk

    # Without a copy. The VTK array holds a reference to the NumPy array.
    return numpy_to_vtk(np.ascontiguousarray(array), deep=False)
