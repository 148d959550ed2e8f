"""The standard-tier mesh of an asset: static colours and face selection.

The renderer, the engines, `msb convert` and the viewers use these functions to draw or write the opaque mesh.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from msb.asset.activation import sigmoid
from msb.asset.asset import Asset
from msb.asset.drawable import required_buffer
from msb.asset.sh import SH_C0
from msb.asset.texture import Textured, linear_to_srgb, sample, srgb_to_linear, textures_of

# Grey value in [0, 1] of a mesh without colours. The value is for faces that point towards the light.
GREY = 0.8
# Fraction of the light that comes from all directions.
AMBIENT = 0.35
# Direction (right, up, front) of the directional light. The light comes from above, and a little from the
# front and the right.
_LIGHT = (0.36, 0.8, 0.48)
# For each up axis, the indices of the front and right axes in a right-handed frame.
_AXES = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}
# Number of faces whose normals are computed at a time.
_AT_ONCE = 1 << 14


@dataclass(frozen=True)
class StaticColors:
    """Colours of the standard tier: values (n, 3 | 4), uint8, or float32 in [0, 1].

    The fourth channel is ignored.
    """

    values: NDArray[Any]
    domain: Literal["vertex", "face", "corner"]


def static_colors(buffers: Mapping[str, NDArray[Any]], domains: Mapping[str, str]) -> StaticColors | None:
    """Return the buffer `color`, or clamp(C0 f_dc + 0.5, 0, 1). Return None if both buffers are missing.

    Colours are clamped before they are interpolated (paper, "Standard deployment"). The argument `domains`
    maps buffers to their domains.
    """
    for name in ("color", "f_dc"):
        if name in buffers:
            values = baked_colors(buffers[name]) if name == "f_dc" else clamp_colors(buffers[name])
            return StaticColors(values, cast("Any", domains[name]))
    return None


def colors_of(asset: Asset) -> StaticColors | None:
    """Return the static colours of an asset, including its textures. Textures are sampled at the corners of
    the faces."""
    textured = textures_of(asset)
    if textured is None:
        return tint_of(asset)
    return corner_colors(textured, tint_of(asset), asset.buffers["indices"])


def tint_of(asset: Asset) -> StaticColors | None:
    """Return the `static_colors` of an asset, without its textures. Renderers multiply textures by these
    colours."""
    return static_colors(asset.buffers, {name: spec.domain for name, spec in asset.manifest.buffers.items()})


def corner_colors(textured: Textured, tint: StaticColors | None, indices: NDArray[Any]) -> StaticColors:
    """Return the sRGB colours (3F, 3) float32 of textures at the corners of the faces, multiplied by `tint`.

    Programs that cannot draw textures use the result. The argument `indices` contains the faces (F, 3).
    """
    # Sample each texture at the corners of its faces, in linear light (3F, 4).
    light = np.zeros((textured.uvs.size // 2, 4), np.float32)
    faces = len(textured.uvs)
    face_texture = np.zeros(faces, np.uint32) if textured.face_texture is None else textured.face_texture
    for number, image in enumerate(textured.images):
        rows = np.repeat(face_texture == number, 3)
        light[rows] = sample([image], textured.uvs.reshape(-1, 2)[rows], textured.sampler)
    if tint is not None:
        light *= corner_tint(tint, indices)
    return StaticColors(np.clip(linear_to_srgb(light[:, :3]), 0, 1), "corner")


def corner_tint(tint: StaticColors, indices: NDArray[Any]) -> NDArray[np.float32]:
    """Return the colours at the corners of the faces (F, 3), as linear light and alpha (3F, 4) float32."""
    values = tint.values if tint.values.dtype == np.float32 else tint.values / np.float32(255)
    light = np.ones((len(values), 4), np.float32)
    light[:, : values.shape[1]] = values
    light[:, :3] = srgb_to_linear(light[:, :3])
    if tint.domain == "corner":
        return light
    return np.repeat(light, 3, axis=0) if tint.domain == "face" else light[indices.reshape(-1)]


def drawn_colors(asset: Asset) -> StaticColors:
    """Return the colours of the drawn mesh: its `static_colors`, or grey with shading."""
    colors = colors_of(asset)
    if colors is not None:
        return colors
    grey = lit_grey(asset.buffers["positions"], asset.buffers["indices"], up_axis(asset))
    return StaticColors(grey, "face")


def lit_grey(vertices: NDArray[Any], faces: NDArray[Any], axis: str) -> NDArray[np.float32]:
    """Return the face colours (F, 3) of a mesh without colours: `GREY`, shaded by `daylight`."""
    shade = GREY * daylight(vertices, faces, axis)
    return np.repeat(shade.astype(np.float32)[:, None], 3, axis=1)


def daylight(vertices: NDArray[Any], faces: NDArray[Any], axis: str) -> NDArray[np.float64]:
    """Return the brightness (F,) of faces: a + (1 - a) |n . l|.

    n is the normal of the face, l is the direction of the light, and a is the ambient brightness. Both sides
    of a face have equal brightness, because the winding can be inconsistent. A face without a normal has the
    brightness a. The `axis`, such as "+y", points up.
    """
    facing, light = np.zeros(len(faces)), light_toward(axis)
    for here, _, normals in normals_of(vertices, faces):
        length = np.linalg.norm(normals, axis=1)
        np.divide(np.abs(normals @ light), length, out=facing[here], where=length > 0)
    return np.asarray(AMBIENT + (1 - AMBIENT) * facing)


def normals_of(
    vertices: NDArray[Any], faces: NDArray[Any]
) -> Iterator[tuple[slice, NDArray[np.float64], NDArray[np.float64]]]:
    """Yield chunks of faces. A chunk has a slice of face indices, the first corners (n, 3), and the normals
    (n, 3).

    The length of a normal is twice the area of its face. Each chunk fits into the CPU cache, which makes the
    loop faster.
    """
    for start in range(0, len(faces), _AT_ONCE):
        here = slice(start, start + _AT_ONCE)
        corners = np.asarray(vertices[faces[here]], np.float64)
        sides = corners[:, 1:] - corners[:, :1]
        yield here, corners[:, 0], np.cross(sides[:, 0], sides[:, 1])


def light_toward(axis: str) -> NDArray[np.float64]:
    """Return the unit vector (3,) towards the light of `daylight`, for the up axis `axis`."""
    front, right = _AXES[axis[1]]
    up = "xyz".index(axis[1])
    sign = -1.0 if axis[0] == "-" else 1.0
    light = np.zeros(3)
    light[[right, up, front]] = (_LIGHT[0], sign * _LIGHT[1], sign * _LIGHT[2])
    return np.asarray(light / np.linalg.norm(light))


def up_axis(asset: Asset) -> str:
    """Return the up axis of `asset`, such as "+y"."""
    return known_up(asset.manifest.coordinate_frame.up, asset.manifest.method)


def written_up(asset: Asset) -> str | None:
    """Return the up axis for files written from `asset`.

    Return None for a mesh file that does not state its up axis.
    """
    frame, method = asset.manifest.coordinate_frame, asset.manifest.method
    return frame.known_up if method == "mesh" else known_up(frame.up, method)


def known_up(stored: str, method: str | None) -> str:
    """Return the up axis `stored`, or a default if `stored` is "unknown".

    The default is +y for a mesh file (method None or "mesh"), as in glTF. The default for a trained scene is
    -y, as in COLMAP.
    """
    if stored != "unknown":
        return stored
    return "+y" if method in (None, "mesh") else "-y"


def baked_colors(f_dc: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return clamp(C0 f_dc + 0.5, 0, 1), the colour of the SH coefficients of degree 0."""
    return clamp_colors(np.float32(SH_C0) * f_dc + np.float32(0.5))


def clamp_colors(colors: NDArray[Any]) -> NDArray[Any]:
    """Return float colours clamped to [0, 1], and byte colours unchanged.

    NaN is kept. `check_drawable` reports it.
    """
    return np.clip(colors, np.float32(0), np.float32(1)) if colors.dtype.kind == "f" else colors


def visible_faces(asset: Asset, ste_threshold: float | None) -> NDArray[np.bool_] | None:
    """Return the mask (F,) of faces with an opacity above the STE threshold (a setting of 2DTS).

    The result is None without a threshold, or if the asset has no opacity. Opacity and threshold are compared
    as float32, as in the official code (GaodeRender/triangle-splatting). The standard tier uses opacity only
    for this threshold. An opacity buffer that is not per face raises `TRIASSET_BUFFER`.
    """
    if ste_threshold is None or "opacity" not in asset.buffers:
        return None
    opacity = required_buffer(asset, "opacity", asset.manifest.face_count)
    return np.asarray(sigmoid(opacity) > np.float32(ste_threshold))


def select_faces(asset: Asset, ste_threshold: float | None) -> NDArray[np.uint32] | None:
    """Return the sorted indices (n,) of the `visible_faces`, or None if all faces are visible."""
    visible = visible_faces(asset, ste_threshold)
    return None if visible is None or visible.all() else np.flatnonzero(visible).astype(np.uint32)


def stored_threshold(asset: Asset) -> float | None:
    """Return the STE threshold in the settings of `asset`, or None."""
    stored = asset.manifest.settings.get("ste_threshold")
    return None if stored is None else cast("float | None", stored.value)
